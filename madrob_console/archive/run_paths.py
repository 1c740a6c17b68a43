"""The runs behind the paths that a person names, and which place of a run counts.

A path leads to bags, run folders or published files (protocol section 2).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

from madrob_console.archive.folders import PRACTICE_FOLDER, parse_folder_name
from madrob_console.common.errors import MadrobError
from scoring.run_info import run_prefixes


@dataclass(frozen=True, slots=True)
class RunPath:
    """A bag or run folder; `prefix` begins the names of published files, else it is empty."""

    path: Path
    prefix: str = ""

    @property
    def name(self) -> str:
        """Unique among the runs of one folder."""
        return str(self.path / self.prefix)

    @property
    def own_name(self) -> str:
        """The name for files made of it: its folder's, or its bag's where that is a file."""
        whole = Path(os.path.abspath(self.path))  # noqa: PTH100  `..` has a name, too
        return self.prefix or (whole.name if whole.is_dir() else whole.stem)

    def demand_recording(self) -> None:
        """Refuse published files, which can be scored and nothing else."""
        if self.prefix:
            raise MadrobError(f"{self.name}: files without a recording: give the run's bag")

    @property
    def place(self) -> tuple[Path, str]:
        """The results folder of a run folder, and the run's folder as seen from there."""
        within, name = with_name(self.path.parent), self.path.name
        return (
            (within.parent, f"{PRACTICE_FOLDER}/{name}")
            if within.name == PRACTICE_FOLDER
            else (within, name)
        )


def runs_at(path: Path) -> list[RunPath]:
    """The runs at a path, at any depth, in the order of their names.

    These are run folders, renamed ones too, and folders of published files; else the path itself,
    which may be unreadable. In a folder with a bag, the bag is the run. Links and hidden folders
    are not followed.
    """
    return list(all_runs_at([path]))


def all_runs_at(paths: Iterable[Path]) -> list[RunPath]:
    """Without the duplicates of overlapping paths, in their order."""
    return _listed_runs(paths, by_name=False)


def listed_at(paths: Iterable[Path]) -> list[RunPath]:
    """As `all_runs_at`, for lists: a folder called like a run is one, whatever it holds."""
    return _listed_runs(map(with_name, paths), by_name=True)


def with_name(path: Path) -> Path:
    """Resolves `.` and `..`, which have no name."""
    return path if path.name not in ("", "..") else Path(os.path.abspath(path))  # noqa: PTH100


def _listed_runs(paths: Iterable[Path], *, by_name: bool) -> list[RunPath]:
    runs: dict[tuple[str, str], RunPath] = {}
    for path in paths:
        for run in list(_runs_below(path, by_name=by_name)) or [RunPath(path)]:
            runs.setdefault((os.path.realpath(run.path), run.prefix), run)
    return list(runs.values())


def _runs_below(top: Path, *, by_name: bool) -> Iterator[RunPath]:
    places = [top]
    while places:
        path = places.pop()
        named = path is not top and parse_folder_name(path.name) is not None
        if named and by_name:
            yield RunPath(path)
            continue
        try:
            with os.scandir(path) as entries:
                ordered = sorted(entries, key=attrgetter("name"), reverse=True)
        except NotADirectoryError:
            continue
        except OSError:  # reading it says why; the path that was named is looked at by the caller
            if path is not top:
                yield RunPath(path)
            continue
        names = [entry.name for entry in ordered]
        if not _is_bag(names) and (prefixes := run_prefixes(names)):
            yield from (RunPath(path, prefix) for prefix in prefixes)
        elif named or _is_bag(names):  # its recording may be missing
            yield RunPath(path)
        else:
            places += [
                path / entry.name
                for entry in ordered
                if entry.name[0] != "." and entry.is_dir(follow_symlinks=False)
            ]


def _is_bag(names: Iterable[str]) -> bool:
    return any(name == "metadata.yaml" or name.endswith((".mcap", ".db3")) for name in names)


@dataclass(frozen=True, slots=True)
class RunPlace:
    """Where a run with a usable result lies; an empty `run_id` equals no other."""

    name: str
    run_id: str
    practice: bool
    issue: int


def places_that_count(places: Iterable[RunPlace]) -> dict[str, str]:
    """By `run_id`, the name of the place that counts: official, of the latest issue, the first."""
    counting: dict[str, RunPlace] = {}
    for place in places:
        other = counting.get(place.run_id)
        if place.run_id and (other is None or _rank(place) > _rank(other)):
            counting[place.run_id] = place
    return {run_id: place.name for run_id, place in counting.items()}


def _rank(place: RunPlace) -> tuple[bool, int]:
    return not place.practice, place.issue
