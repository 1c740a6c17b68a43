"""Each public class and each module has a name of its own, so that a name says what is meant."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("madrob_console", "recorder", "scoring")
ONE_A_PACKAGE = {"errors"}
"""Modules that every package has, for the same thing."""


def _sources() -> Iterator[Path]:
    for package in PACKAGES:
        yield from (path.relative_to(ROOT) for path in sorted((ROOT / package).rglob("*.py")))


def _public_types(source: Path) -> Iterator[str]:
    """The classes of a module, and what it names like one."""
    for node in ast.parse((ROOT / source).read_text()).body:
        match node:
            case ast.ClassDef(name=name) | ast.Assign(targets=[ast.Name(id=name)]):
                if name[0].isupper() and not name.isupper():
                    yield name


def _doubles(found: dict[str, list[Path]]) -> dict[str, list[Path]]:
    return {name: places for name, places in found.items() if len(places) > 1}


def test_no_public_class_name_stands_for_two_things() -> None:
    found: dict[str, list[Path]] = defaultdict(list)
    for source in _sources():
        for name in _public_types(source):
            found[name].append(source)
    assert len(found) > 200
    assert _doubles(found) == {}


def test_no_module_name_stands_for_two_things() -> None:
    found: dict[str, list[Path]] = defaultdict(list)
    for source in _sources():
        name = source.parent.name if source.stem == "__init__" else source.stem
        if name not in ONE_A_PACKAGE and name != "__main__":
            found[name].append(source)
    assert len(found) > 150
    assert _doubles(found) == {}
