"""A report's neighbours: the team's other runs, and reports of older versions."""

from __future__ import annotations

import os
import posixpath
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from madrob_console.archive.folders import REPORT_FILE, parse_folder_name, results_folder_of
from madrob_console.archive.history import History, with_result
from madrob_console.archive.result_reader import (
    UnusableResultError,
    earlier_issues,
    read_result,
    read_sound_result,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import read_bounded, stamp_of
from madrob_console.pages.templates import NOTHING
from madrob_console.referee.run_summary import RunSummary

if TYPE_CHECKING:
    from madrob_console.archive.scored import Scored
    from scoring.protocol import Step

_HEAD = 1000  # bytes of a report in which it says what it was made of
_MADE_OF = re.compile('<meta name="(journal|team)" content="([^"]*)">')


def made_of(head: str) -> dict[str, str]:
    """What a page says in its `head` that it was made of.

    `journal`: its lines and digest. `team`: digest of the lines about the team's other runs.
    """
    return dict(_MADE_OF.findall(head))


def has_report(folder: Path) -> bool:
    return stamp_of(str(folder / REPORT_FILE)) is not None


def report_is_old(folder: Path) -> bool:
    """Whether there is a report that names another journal than the result."""
    stated_journal = _stated(folder).get("journal")
    try:
        mark = read_result(str(folder)).journal
    except (OSError, UnusableResultError):
        return False
    return bool(stated_journal and stated_journal != f"{mark.lines} {mark.sha256}")


def _stated(folder: Path) -> dict[str, str]:
    try:
        head, _ = read_bounded(str(folder / REPORT_FILE), _HEAD)
    except OSError:
        return {}
    return made_of(head.decode(errors="replace"))


_MOST_FILES = _MOST_RUNS = 60


@dataclass(frozen=True, slots=True)
class LinkedRun:
    """Another run of the team; `page` is the path of its report from this one, empty = none."""

    summary: RunSummary
    page: str


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A comparable run: completed, same condition, same rules, official or practice too.

    `steps` are the times of those that count, s since its start.
    """

    summary: RunSummary
    steps: Mapping[Step, float]


@dataclass(frozen=True, slots=True)
class PagePlace:
    """What a page can link to and compare with, as known when it is made.

    Attributes:
        files: the names of the files beside it.
        team: the other runs of its team, by condition and number; of very many those of its
            condition, the latest ones.
        team_shortened: whether there are more.
        field: the comparable runs of all teams; none where the run failed.
        itself: the run in the list of runs; None = it is not there.
        earlier: the issues of its result before this one.
        digest: of what the page tells of the team's other runs.
    """

    files: tuple[str, ...] = ()
    team: tuple[LinkedRun, ...] = ()
    team_shortened: bool = False
    field: tuple[ComparedRun, ...] = ()
    itself: RunSummary | None = None
    earlier: tuple[RunSummary, ...] = ()
    digest: str = ""
    ways: Markup = NOTHING


NOWHERE = PagePlace()


class RelatedRuns:
    """The other runs that a page needs; reads each results folder and each run's steps once."""

    def __init__(self) -> None:
        self._runs: dict[Path, tuple[RunSummary, ...]] = {}
        self._steps: dict[Path, Mapping[Step, float]] = {}

    def place_of(self, folder: Path, scored: Scored) -> PagePlace:
        """The place of a page in the run's folder; what cannot be read is left out."""
        folder = folder.absolute()
        if not folder.is_dir() or parse_folder_name(folder.name) is None:
            return NOWHERE
        root = results_folder_of(folder)
        name = folder.relative_to(root).as_posix()

        def page(run: RunSummary) -> str:
            if not has_report(root / run.folder):
                return ""
            return posixpath.relpath(f"{run.folder}/{REPORT_FILE}", name)

        place = self.among(root, name, self._runs_below(root), scored, page)
        return replace(place, files=_files(folder))

    def among(
        self,
        root: Path,
        name: str,
        runs: Sequence[RunSummary],
        scored: Scored,
        page: Callable[[RunSummary], str],
    ) -> PagePlace:
        """The place of a page anywhere, for the run in the folder `name` among all known runs.

        `root` is the parent of the runs' folders. `page` gives the path of another run's report
        from the page; empty = it has none.
        """
        setup = scored.record.setup
        itself = next((run for run in runs if run.folder == name), None)
        mine = RunSummary(
            folder=name,
            subject=setup.subject,
            condition=setup.condition.number,
            run_number=setup.run_number,
            started=scored.result.start,
            practice=setup.practice if itself is None else itself.practice,
            competition=scored.record.competition,
            run_id="" if scored.run.setup is None else scored.run.setup.run_id,
        )
        others = _others(mine, runs)
        team = team_runs(mine, others)
        field = [run for run in others if _comparable(run, scored, practice=mine.practice)]
        return PagePlace(
            team=tuple(LinkedRun(run, page(run)) for run in team),
            team_shortened=sum(run.subject == mine.subject for run in others) > len(team),
            field=tuple(
                ComparedRun(run, steps)
                for run in field
                if (steps := self._steps_of(root / run.folder))
            ),
            itself=itself,
            earlier=tuple(
                with_result(mine, issue)
                for issue in earlier_issues(root / name, scored.run.reissues)
            ),
            digest=_digest(team),
        )

    def old_reports(self, root: Path) -> Iterator[Path]:
        """Runs whose reports name other runs of their team than there are now."""
        teams: dict[tuple[int, bool], list[RunSummary]] = defaultdict(list)
        for run in self._runs_below(root):
            teams[run.subject, run.practice].append(run)
        for runs in teams.values():
            for run in runs:
                stated = None if run.outcome is None else _stated(root / run.folder).get("team")
                if stated is not None and stated != team_digest(run, runs):
                    yield root / run.folder

    def _runs_below(self, root: Path) -> tuple[RunSummary, ...]:
        if root not in self._runs:
            try:
                self._runs[root] = History(root).refresh()
            except MadrobError:  # the page is made without
                self._runs[root] = ()
        return self._runs[root]

    def _steps_of(self, folder: Path) -> Mapping[Step, float]:
        if folder not in self._steps:
            self._steps[folder] = {}
            if result := read_sound_result(str(folder)):
                done = result.steps_done.items()
                self._steps[folder] = {step: time - result.start for step, time in done}
        return self._steps[folder]


def _others(mine: RunSummary, runs: Iterable[RunSummary]) -> list[RunSummary]:
    """Other runs of the same competition and kind, without those that never ran."""
    return [
        run
        for run in runs
        if run.folder != mine.folder
        and run.practice is mine.practice
        and run.competition == mine.competition
        and not run.never_ran
        and not (mine.run_id and run.run_id == mine.run_id)
    ]


def team_runs(mine: RunSummary, runs: Iterable[RunSummary]) -> list[RunSummary]:
    """The team's other runs that a run's report tells of."""
    related = [run for run in _others(mine, runs) if run.subject == mine.subject]
    if len(related) > _MOST_RUNS:
        related = [run for run in related if run.condition == mine.condition]
    related.sort(key=lambda run: (run.condition, run.run_number))
    return related[-_MOST_RUNS:]


def team_digest(mine: RunSummary, runs: Iterable[RunSummary]) -> str:
    """Digest of all that a run's report tells of its team's other runs."""
    return _digest(team_runs(mine, runs))


def _digest(team: Iterable[RunSummary]) -> str:
    facts = [
        (
            *(run.folder, run.run_number, run.condition, run.outcome_word, run.valid),
            *(run.ruleset, sorted(run.values.items()), sorted(run.uncertainties.items())),
        )
        for run in team
    ]
    return sha256(repr(facts).encode()).hexdigest()


def _comparable(run: RunSummary, scored: Scored, *, practice: bool) -> bool:
    return (
        run.comparable
        and scored.run.comparable
        and run.condition == scored.record.setup.condition.number
        and run.ruleset == scored.result.ruleset
        and (practice or run.official)
    )


def _files(folder: Path) -> tuple[str, ...]:
    """The plain files of a run's folder except the page itself; of very many only the first."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(
                entry.name
                for entry in entries
                if entry.is_file(follow_symlinks=False)
                and not entry.name.startswith(".")
                and entry.name != REPORT_FILE
            )
    except OSError:
        return ()
    return tuple(names[:_MOST_FILES])
