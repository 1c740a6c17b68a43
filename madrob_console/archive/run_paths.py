"""The runs behind the paths that somebody names: bags, run folders, published files."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import run_folder_names
from madrob_console.errors import MadrobError
from scoring.eurobench.run_names import run_prefixes


@dataclass(frozen=True, slots=True)
class RunPath:
    """One run on disk.

    Attributes:
        path: its bag, or the folder that holds its files.
        prefix: how the names of its published files begin; empty for a recorded run.
    """

    path: Path
    prefix: str = ""

    @property
    def name(self) -> str:
        """What it is called, its folder included; the runs of one folder differ in it."""
        return str(self.path / self.prefix)

    @property
    def own_name(self) -> str:
        """How files made of it are called: like its folder, or its bag where that is a file."""
        whole = Path(os.path.abspath(self.path))  # noqa: PTH100  `..` has a name, too
        return self.prefix or (whole.name if whole.is_dir() else whole.stem)


def runs_at(path: Path) -> list[RunPath]:
    """The runs at a path, in order.

    Those of a results folder, run folders that somebody renamed among them, or of a folder of
    published files; else the path itself, which may be a bag, or nothing that can be read: reading
    it says so. In a folder with a bag, the bag is the run.
    """
    try:
        names = os.listdir(path)  # noqa: PTH208  ten thousand Paths take too long
    except OSError:  # a file, or nothing
        return [RunPath(path)]
    if _is_bag(names):
        return [RunPath(path)]
    if prefixes := run_prefixes(names):
        return [RunPath(path, prefix) for prefix in prefixes]
    try:
        folders = sorted(run_folder_names(path))
    except MadrobError:
        folders = []
    folders += sorted(name for name in set(names).difference(folders) if _holds_bag(path / name))
    return [run for name in folders for run in runs_at(path / name)] or [RunPath(path)]


def _is_bag(names: Iterable[str]) -> bool:
    return any(name == "metadata.yaml" or name.endswith((".mcap", ".db3")) for name in names)


def _holds_bag(path: Path) -> bool:
    """Whether it is a folder with a recording; no link."""
    try:
        return not path.is_symlink() and _is_bag(os.listdir(path))  # noqa: PTH208
    except OSError:  # a file, or nothing that may be read
        return False
