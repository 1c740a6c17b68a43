"""The runs behind the paths that somebody names: bags, run folders, published files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import parse_folder_name
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
    """The runs at a path, at any depth, in the order of their names.

    Run folders, also those that somebody renamed, and folders of published files; else the path
    itself, which may be a bag, or nothing that can be read: reading it says so. In a folder with a
    bag, the bag is the run. Links and hidden folders in it are not followed.
    """
    return list(_runs_below(path)) or [RunPath(path)]


def all_runs_at(paths: Iterable[Path]) -> list[RunPath]:
    """The runs at some paths, in their order; what lies at two of them once."""
    found: dict[tuple[str, str], RunPath] = {}
    for path in paths:
        for run in runs_at(path):
            found.setdefault((os.path.realpath(run.path), run.prefix), run)
    return list(found.values())


def _runs_below(top: Path) -> Iterator[RunPath]:
    folders = [top]
    while folders:
        path = folders.pop()
        try:
            names = os.listdir(path)  # noqa: PTH208  ten thousand Paths take too long
        except NotADirectoryError:
            continue
        except OSError:  # reading it says why; the path that was named is looked at by `runs_at`
            if path is not top:
                yield RunPath(path)
            continue
        if _is_bag(names):
            yield RunPath(path)
        elif prefixes := run_prefixes(names):
            yield from (RunPath(path, prefix) for prefix in prefixes)
        elif path is not top and parse_folder_name(path.name) is not None:
            yield RunPath(path)  # its recording is missing
        else:
            below = (path / name for name in sorted(names, reverse=True) if name[0] != ".")
            folders += [folder for folder in below if not folder.is_symlink()]


def _is_bag(names: Iterable[str]) -> bool:
    return any(name == "metadata.yaml" or name.endswith((".mcap", ".db3")) for name in names)
