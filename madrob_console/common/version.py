"""Which software it is: a version that is computed from what is there, so that it cannot lie.

`0.1.0+c1557f39128.tabad1842fe` is the release, a digest of the code that scores, and a digest of
the rest of the source tree (papers, tests, build). Two commits never share a version, the same
code has the same one wherever it lies, and a line that somebody changes changes it. No file keeps
it up to date and git is not asked: a plain copy and a zip know it as well as a checkout.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, cast

from madrob_console.common.errors import MadrobError

if TYPE_CHECKING:
    import zipfile

RELEASE = "0.1.0"
"""Set by hand; its changes stand in CHANGELOG.md."""

DISTRIBUTION = "madrob-console"

CODE = ("madrob_console", "recorder", "scoring")

REST = (".ci", ".github", ".gitignore", ".readme", "README.md", "pyproject.toml", "tests")
"""The other contents of a source tree."""

_Place: TypeAlias = "Path | zipfile.Path"


@cache
def software_version() -> str:
    """The version of the running code, in the format of PEP 440.

    The second digest is missing where only the packages lie, without a known source tree.
    """
    try:
        packages = {name: _package(name) for name in CODE}
        tree = cast("_Place", packages[CODE[0]].parent)
        code = _code_version(packages)
        return f"{code}.{_rest(tree)}" if _is_source(tree) else _installed(tree, code) or code
    except OSError as error:
        raise MadrobError(
            f"the program cannot read its own code ({error}), so that no result could say which "
            f"version made it: install {DISTRIBUTION} again"
        ) from None


def source_version(tree: Path) -> str:
    """The version of a source tree, for the build of an installation from it."""
    return f"{_code_version({name: tree / name for name in CODE})}.{_rest(tree)}"


def _code_version(packages: Mapping[str, _Place]) -> str:
    return f"{RELEASE}+c{_digest(packages)}"


def _rest(tree: _Place) -> str:
    return f"t{_digest({name: tree / name for name in REST})}"


def _package(name: str) -> _Place:
    spec = find_spec(name)
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError(f"there is no package {name}")
    folder = Path(spec.submodule_search_locations[0])
    archive: str | None = getattr(spec.loader, "archive", None)
    if archive is None:
        return folder
    import zipfile

    return zipfile.Path(archive, f"{folder.relative_to(archive).as_posix()}/")


def _is_source(tree: _Place) -> bool:
    project = tree / "pyproject.toml"
    return project.is_file() and f'name = "{DISTRIBUTION}"'.encode() in project.read_bytes()


def _installed(folder: _Place, version: str) -> str | None:
    """Version recorded in the installation, from its source tree; None = other code."""
    from importlib.metadata import distributions

    found = distributions(name=DISTRIBUTION, path=[str(folder).rstrip("/")])
    return next((one.version for one in found if one.version.startswith(f"{version}.")), None)


def _digest(places: Mapping[str, _Place]) -> str:
    digest = hashlib.sha256()
    for name, place in places.items():
        for path, data in _files(name, place):
            digest.update(f"{path}\0{len(data)}\0".encode())
            digest.update(data)
    return digest.hexdigest()[:10]


def _files(path: str, place: _Place) -> Iterator[tuple[str, bytes]]:
    """The files by their paths in the tree, but for what Python and editors make."""
    if place.is_file():
        yield path, place.read_bytes()
    elif place.is_dir():
        inside: dict[str, _Place] = {each.name: each for each in place.iterdir()}
        for name in sorted(inside):
            if not name.startswith((".", "__pycache__")):
                yield from _files(f"{path}/{name}", inside[name])
