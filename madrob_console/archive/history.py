"""The runs of a results folder: what each `result.json` says."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TypeAlias

from msgspec.structs import replace

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    RunName,
    holds_rehearsals,
    lies_in_practice,
    parse_folder_name,
    run_folder_names,
)
from madrob_console.archive.journal_agreement import (
    disagreement,
    is_of_earlier_lines,
    out_of_date,
)
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import (
    DamagedResultError,
    UnusableResultError,
    read_result,
)
from madrob_console.archive.run_journal import (
    UnusableJournalError,
    ever_protested,
    read_run_journal,
    recorded_competition,
)
from madrob_console.archive.run_paths import RunPlace, places_that_count
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.names import is_rehearsal
from madrob_console.common.plain_files import Stamp, stamp_of
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome

_LONGEST_REASON = 500  # characters

_Stamps: TypeAlias = tuple[Stamp | None, ...]


class History:
    """All runs of a results folder, which need not exist. Thread-safe."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._place = str(root)
        self._rehearsal = holds_rehearsals(root)
        self._lock = threading.Lock()
        self._cached: dict[str, tuple[_Stamps, RunSummary]] = {}

    def refresh(self) -> tuple[RunSummary, ...]:
        """Every run, oldest first; only a `result.json` that changed is read.

        Links are not followed. What is wrong with a run's files is in its `problem`.
        """
        with self._lock:
            runs = list(self._listed())
        runs.sort(key=attrgetter("started"))
        return mark_duplicates(runs)

    def _listed(self) -> Iterator[RunSummary]:
        """In the order of their folders' names."""
        names, before, self._cached = sorted(run_folder_names(self._root)), self._cached, {}
        for name in names:
            files = (f"{self._place}/{name}/{file}" for file in (RESULT_FILE, JOURNAL_FILE))
            stamps, cached = tuple(map(stamp_of, files)), before.get(name)
            if cached is not None and cached[0] == stamps:
                self._cached[name] = cached
                yield cached[1]
            elif (run := self._read(name, stamps)) is not None:
                yield run

    def _read(self, name: str, stamps: _Stamps) -> RunSummary | None:
        folder = f"{self._place}/{name}"
        parsed = parse_folder_name(name)
        if parsed is None:  # a date that does not exist
            return None
        named, local = parsed
        unread = RunSummary(
            folder=name,
            subject=named.subject,
            condition=named.condition,
            run_number=named.run,
            started=local.timestamp(),
            practice=lies_in_practice(name),
            competition=None,
        )
        try:
            result = read_result(folder)
            if (why := misplaced(result, named) or self._mixed(result.competition)) is not None:
                return _unusable(unread, folder, why)
            if (why := disagreement(result, Path(folder))) is not None:
                held = is_held(Path(folder, JOURNAL_FILE))
                if held and is_of_earlier_lines(result, Path(folder)):
                    return self._with_protests(unread, result)  # the newer is about to be written
                return _unusable(unread, folder, out_of_date(why), repairable=True)
        except FileNotFoundError:
            run = _of_journal(unread, Path(folder))
            if run.competition is not None and (why := self._mixed(run.competition)) is not None:
                run = replace(run, problem=why)
            self._cached[name] = (stamps, run)
            return run
        except (UnusableResultError, UnusableJournalError) as problem:
            damaged = isinstance(problem, DamagedResultError)
            return _unusable(unread, folder, str(problem), repairable=damaged)
        run = self._with_protests(unread, result)
        self._cached[name] = (stamps, run)
        return run

    def _mixed(self, competition: str) -> str | None:
        """Why a run may not stand among the others: rehearsals and official runs never mix."""
        if is_rehearsal(competition) is self._rehearsal:
            return None
        if self._rehearsal:
            return "is not of a rehearsal: move it out of this rehearsal's results folder"
        return "is of a rehearsal: move it into a results folder whose name ends in `rehearsal`"

    def _with_protests(self, unread: RunSummary, result: ResultDocument) -> RunSummary:
        """Adds the result; an earlier issue of it may have been protested."""
        run = with_result(unread, result)
        if run.protested or run.issue <= 1:
            return run
        return replace(run, protested=ever_protested(self._root / unread.folder))


def mark_duplicates(runs: Sequence[RunSummary]) -> tuple[RunSummary, ...]:
    """Sets `twin` of each duplicate that does not count."""
    counting = places_that_count(
        RunPlace(run.folder, run.run_id, run.practice, run.issue) for run in runs
    )
    return tuple(
        run if first == run.folder else replace(run, twin=first)
        for run in runs
        for first in [counting.get(run.run_id, run.folder)]
    )


def of_competition(runs: Iterable[RunSummary], name: str | None) -> tuple[RunSummary, ...]:
    """A run whose files name no competition may be of any."""
    return tuple(run for run in runs if run.competition in (name, None))


def earlier_runs(
    runs: Iterable[RunSummary],
    subject: int,
    condition: int,
    before: float,
    *,
    competition: str,
    practice: bool,
    ruleset: str | None = None,
) -> tuple[RunSummary, ...]:
    """The runs to compare a run with: completed, same robot, same condition, before it.

    `before` is its start, s since the epoch. Another competition has another team of this number;
    practice is compared with practice only; `ruleset` None = any.
    """
    return tuple(
        run
        for run in runs
        if run.comparable
        and (run.competition, run.subject, run.condition) == (competition, subject, condition)
        and (run.practice if practice else run.official)
        and run.started < before
        and ruleset in (None, run.ruleset)
    )


def rank(run: RunSummary) -> tuple[float, bool, float, float]:
    """Sort key for the best of a team's runs, smallest first. A failed run's time is left out."""
    completed = run.outcome is Outcome.COMPLETED
    return (
        -run.values.get(IndicatorName.CAPABILITY_LEVEL, -1),
        not completed,
        run.values.get(IndicatorName.EXECUTION_TIME, math.inf) if completed else math.inf,
        run.started,
    )


def _unusable(unread: RunSummary, folder: str, why: str, *, repairable: bool = False) -> RunSummary:
    return replace(
        unread,
        problem=why,
        repairable=repairable,
        competition=recorded_competition(Path(folder)),
    )


def _of_journal(unread: RunSummary, folder: Path) -> RunSummary:
    try:
        journal = read_run_journal(folder)
    except FileNotFoundError:
        return unread
    except UnusableJournalError as error:
        return replace(unread, problem=str(error))
    unread, setup = replace(unread, never_ran=journal.never_ran), journal.run.setup
    if setup is None:
        return unread
    practice = unread.practice or setup.practice
    return replace(
        unread,
        team=setup.team,
        ruleset=setup.ruleset,
        practice=practice,
        run_id=setup.run_id,
        testbed=setup.testbed,
        competition=setup.competition,
    )


def with_result(unread: RunSummary, result: ResultDocument) -> RunSummary:
    """A run in a list with what its result says of it."""
    indicators = result.indicators
    closure, waiting = result.closure, result.open_protest
    signed_so = closure is not None and closure.team_word == TeamWord.PROTESTED
    return replace(
        unread,
        subject=result.subject,
        condition=result.condition_number,
        run_number=result.run_number,
        started=result.start,
        team=result.team,
        outcome=result.outcome,
        reason=result.why_invalid[:_LONGEST_REASON],
        voided=result.voided is not None,
        values={
            name: indicator.value
            for name, indicator in indicators.items()
            if indicator.value is not None
        },
        uncertainties={
            name: indicator.uncertainty
            for name, indicator in indicators.items()
            if indicator.uncertainty is not None
        },
        doubts={
            name: len(indicator.doubts)
            for name, indicator in indicators.items()
            if indicator.doubts
        },
        flags=result.flags,
        thresholds=result.thresholds.unlike_protocol,
        issue=result.issue,
        final=closure is not None,
        team_word=None if closure is None else closure.team_word.value,
        protest_filed=None if waiting is None else waiting.time,
        protest_at=result.instant_in_question,
        protested=bool(result.protests) or signed_so,
        source=result.source.value,
        practice=unread.practice or result.practice,
        competition=result.competition,
        ruleset=result.ruleset,
        run_id=result.run_id,
        testbed=result.testbed,
        rate=result.rate,
    )


def misplaced(result: ResultDocument, folder: RunName) -> str | None:
    """Why a result is in the wrong folder, where it would count twice or for another team."""
    run = RunName(result.subject, result.condition_number, result.run_number)
    if result.corrections:  # the folder is named after what was set up first
        first = result.corrections[0].before
        run = RunName(first.subject, first.condition.number, first.run_number)
    if run == folder:
        return None
    of = f"subject {run.subject}, condition {run.condition}, run {run.run}"
    return f"{RESULT_FILE} is of {of}: put it back into its own folder"
