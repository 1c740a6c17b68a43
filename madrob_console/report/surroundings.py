"""What lies around a page: the files of its run, the team's other runs, runs to compare with."""

from __future__ import annotations

import os
import posixpath
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import (
    PRACTICE_FOLDER,
    REPORT_FILE,
    parse_folder_name,
)
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.listed_result import ListedResult
from madrob_console.archive.result_reader import earlier_issues, read_steps
from madrob_console.archive.scored import Scored
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import stamp_of
from scoring.figures.phases import PhaseTimes, phases_of

_MOST_FILES = 60


@dataclass(frozen=True, slots=True)
class LinkedRun:
    """Another run of the team.

    Attributes:
        summary: what the list of runs knows of it.
        page: its report, as seen from this one; empty = it has none.
    """

    summary: RunSummary
    page: str


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A run that can be compared: valid, same condition, same rules, official or practice as well.

    Attributes:
        summary: what the list of runs knows of it.
        phases: where its time went.
    """

    summary: RunSummary
    phases: PhaseTimes


@dataclass(frozen=True, slots=True)
class PagePlace:
    """What a page can link to and compare with, as known when it is made.

    Attributes:
        files: the names of the files beside it.
        team: the other runs of its team, by condition and number.
        field: the other runs, of all teams, that can be compared with it.
        itself: the run in the list of runs; None = it is not there.
        earlier: the issues of its result before this one.
    """

    files: tuple[str, ...] = ()
    team: tuple[LinkedRun, ...] = ()
    field: tuple[ComparedRun, ...] = ()
    itself: RunSummary | None = None
    earlier: tuple[ListedResult, ...] = ()


NOWHERE = PagePlace()
"""Of a page that does not lie in the folder of its run."""


class Surroundings:
    """Looks around runs; each results folder is read once, each run's steps, too."""

    def __init__(self) -> None:
        self._runs: dict[Path, tuple[RunSummary, ...]] = {}
        self._phases: dict[Path, PhaseTimes | None] = {}

    def place_of(self, folder: Path, scored: Scored) -> PagePlace:
        """What lies around the run in a folder; what cannot be read is left out.

        Args:
            folder: of the run; a page in it is meant.
            scored: the run.
        """
        folder = folder.absolute()
        if not folder.is_dir() or parse_folder_name(folder.name) is None:
            return NOWHERE
        practice = folder.parent.name == PRACTICE_FOLDER
        root = folder.parent.parent if practice else folder.parent
        name = folder.relative_to(root).as_posix()
        runs = self._known(root)
        setup = scored.record.setup
        itself = next((run for run in runs if run.folder == name), None)
        mine = setup.practice if itself is None else itself.practice
        run_id = scored.run.setup.run_id if scored.run.setup is not None else ""
        others = [
            run
            for run in runs
            if run.folder != name
            and run.practice is mine
            and not (run_id and run.run_id == run_id)  # the same run in another place
        ]
        team = [run for run in others if run.subject == setup.subject and not run.never_ran]
        field = [run for run in others if _comparable(run, scored, practice=mine)]
        return PagePlace(
            files=_files(folder),
            team=tuple(
                LinkedRun(run, _page(root, run, name))
                for run in sorted(team, key=lambda run: (run.condition, run.run_number))
            ),
            field=tuple(
                ComparedRun(run, phases)
                for run in field
                if (phases := self._phases_of(root / run.folder)) is not None
            ),
            itself=itself,
            earlier=earlier_issues(folder, scored.run.reissues),
        )

    def _known(self, root: Path) -> tuple[RunSummary, ...]:
        if root not in self._runs:
            try:
                self._runs[root] = History(root).refresh()
            except MadrobError:  # the page is made without
                self._runs[root] = ()
        return self._runs[root]

    def _phases_of(self, folder: Path) -> PhaseTimes | None:
        if folder not in self._phases:
            steps = read_steps(str(folder))
            phases: PhaseTimes | None = None
            if steps is not None:
                phases = phases_of(steps.done, steps.start, steps.stop)
            self._phases[folder] = phases
        return self._phases[folder]


def _comparable(run: RunSummary, scored: Scored, *, practice: bool) -> bool:
    return (
        run.valid
        and run.condition == scored.record.setup.condition.number
        and run.ruleset == scored.result.ruleset
        and (practice or run.official)
    )


def _files(folder: Path) -> tuple[str, ...]:
    """The plain files of a run's folder but for the page itself; the first of very many."""
    try:
        with os.scandir(folder) as found:
            names = sorted(
                item.name
                for item in found
                if item.is_file(follow_symlinks=False)
                and not item.name.startswith(".")
                and item.name != REPORT_FILE
            )
    except OSError:
        return ()
    return tuple(names[:_MOST_FILES])


def _page(root: Path, run: RunSummary, seen_from: str) -> str:
    if stamp_of(f"{root}/{run.folder}/{REPORT_FILE}") is None:
        return ""
    return posixpath.relpath(f"{run.folder}/{REPORT_FILE}", seen_from)
