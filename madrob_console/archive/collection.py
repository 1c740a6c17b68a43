"""The runs of any number of results folders and testbeds as one list, each once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from madrob_console.archive.folders import PRACTICE_FOLDER, parse_folder_name
from madrob_console.archive.history import History, RunSummary, twins_told
from madrob_console.archive.run_paths import RunPath, all_runs_at
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe


@dataclass(frozen=True, slots=True)
class Collection:
    """The runs at some paths.

    Attributes:
        root: from where their folders are seen: the results folder where there is only one, and
            else from where the paths are.
        runs: oldest first; those that are there twice know it.
        unlisted: runs that no list has, because their folders are not called like runs.
    """

    root: Path
    runs: tuple[RunSummary, ...]
    unlisted: tuple[Path, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What of it is not as somebody may think, in words."""
        twins = [run.why_twin for run in self.runs if run.twin]
        named = (f"{path}: is not called like a run and left out" for path in self.unlisted)
        return (*twins, *named)


def collected(paths: Sequence[Path], testbed: str | None = None) -> Collection:
    """The runs at some paths, at any depth.

    Args:
        paths: results folders, folders of those, run folders.
        testbed: only those of the testbed of this name; None = of all.

    Raises:
        MadrobError: a path cannot be read, or there is no such testbed.
    """
    of_root: dict[Path, set[str]] = {}
    unlisted = []
    for path in paths:
        if not path.exists():
            raise MadrobError(f"{path}: no such folder; name a folder with runs")
    for run in all_runs_at(paths):
        if run.path in paths and not _is_listed(run):
            of_root.setdefault(run.path, set())  # without runs; reading it says if it cannot be
        if _is_listed(run):
            root, name = _place(run.path)
            of_root.setdefault(root, set()).add(name)
        elif run.path not in paths or run.path.is_file():
            unlisted.append(run.path)
    alone = len(of_root) == 1 and list(paths) == list(of_root)
    runs = [
        run if alone else replace(run, folder=str(root / run.folder), twin="")
        for root, names in of_root.items()
        if root.is_dir()
        for run in History(root).refresh()
        if run.folder in names
    ]
    found = runs if testbed is None else of_testbed(runs, testbed)
    ordered = sorted(found, key=lambda run: (run.started, run.folder))
    return Collection(paths[0] if alone else Path(), twins_told(ordered), tuple(unlisted))


def collected_in(results: Path, testbed: str | None = None) -> Collection:
    """The runs of one results folder, those that the console shows.

    Args:
        results: the results folder.
        testbed: as for `collected`.

    Raises:
        MadrobError: it cannot be read, or there is no such testbed.
    """
    runs = History(results).refresh()
    return Collection(results, runs if testbed is None else tuple(of_testbed(runs, testbed)))


def of_testbed(runs: Iterable[RunSummary], name: str) -> list[RunSummary]:
    """The runs of the testbed of a name.

    Raises:
        MadrobError: there is none.
    """
    every = list(runs)
    demand_testbed(name, {run.testbed for run in every})
    return [run for run in every if run.testbed == name]


def demand_testbed(name: str, testbeds: Iterable[str]) -> None:
    """There are runs of the testbed of a name.

    Raises:
        MadrobError: there are none.
    """
    names = sorted(testbeds)
    if name not in names:
        known = ", ".join(f"'{terminal_safe(one)}'" for one in names) or "none"
        raise MadrobError(
            f"--testbed-name '{terminal_safe(name)}': no such runs; there are {known}"
        )


def _is_listed(run: RunPath) -> bool:
    return not run.path.is_file() and parse_folder_name(run.path.name) is not None


def _place(run: Path) -> tuple[Path, str]:
    """The results folder of a run folder, and its name as seen from there."""
    within = run.parent
    if within.name == PRACTICE_FOLDER:
        return within.parent, f"{PRACTICE_FOLDER}/{run.name}"
    return within, run.name
