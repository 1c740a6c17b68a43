"""Which software it is: a version that is computed from what is there, so that it cannot lie.

`0.2.0+c1557f39128` is the release and a digest of the code. The same code has the same version
wherever it lies, and a line that somebody changes changes it. No file keeps it up to date and git
is not asked: a plain copy and a zip know it as well as a checkout. An installation's metadata has
the release alone, as package indexes want it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from madrob_console.common.errors import MadrobError

if TYPE_CHECKING:
    import zipfile

RELEASE = "0.2.0"
"""Set by hand, read by the build too; its changes stand in CHANGELOG.md."""

DISTRIBUTION = "madrob-console"

CODE = ("madrob_console", "recorder", "scoring")

_Place: TypeAlias = "Path | zipfile.Path"


@cache
def software_version() -> str:
    """The version of the running code, in the format of PEP 440."""
    try:
        return source_version({name: _package(name) for name in CODE})
    except OSError as error:
        raise MadrobError(
            f"the program cannot read its own code ({error}), so that no result could say which "
            f"version made it: install {DISTRIBUTION} again"
        ) from None


def source_version(packages: Mapping[str, _Place]) -> str:
    """The version of code by the places of its packages."""
    digest = hashlib.sha256()
    for name, place in packages.items():
        for path, data in _files(name, place):
            digest.update(f"{path}\0{len(data)}\0".encode())
            digest.update(data)
    return f"{RELEASE}+c{digest.hexdigest()[:10]}"


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


def _files(path: str, place: _Place) -> Iterator[tuple[str, bytes]]:
    """The files by their paths in the tree, but for what Python and editors make."""
    if place.is_file():
        yield path, place.read_bytes()
    elif place.is_dir():
        inside: dict[str, _Place] = {each.name: each for each in place.iterdir()}
        for name in sorted(inside):
            if not name.startswith((".", "__pycache__")):
                yield from _files(f"{path}/{name}", inside[name])
