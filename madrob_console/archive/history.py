"""The runs of a results folder: what each `result.json` says."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import msgspec
from msgspec.structs import replace

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    RunName,
    RunPlace,
    lies_in_practice,
    parse_folder_name,
    places_that_count,
    run_folder_names,
    why_twin,
)
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import (
    DamagedResultError,
    Name,
    StartTime,
    UnusableResultError,
    read_result,
    read_setup,
)
from madrob_console.archive.run_journal import (
    UnusableJournalError,
    disagreement,
    ever_protested,
    is_held,
    out_of_date,
    read_run_journal,
)
from madrob_console.common.files import Stamp, stamp_of
from madrob_console.common.formatting import time_words
from madrob_console.common.names import SourceKind
from madrob_console.referee.flags import Flag
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import VALID_OUTCOMES
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome, ScoringError, Thresholds
from scoring.result import DOUBTED, Uncertainty

_LONGEST_REASON = 500  # characters

OUTCOME_WORDS = {
    Outcome.COMPLETED: "completed",
    Outcome.TIMEOUT: "timeout",
    Outcome.ABORTED: "INVALID",
    Outcome.INTERRUPTED: "INTERRUPTED",
}
"""In capitals where a run does not count."""

PROTEST_OPEN = "PROTEST"

VOID = "VOID"


TWICE = "TWICE"


class ConditionWords(NamedTuple):
    """`pull, from CW to CCW` and the benchmark type."""

    way: str
    door: str


@lru_cache
def condition_words(number: int) -> ConditionWords:
    """A condition in words; empty for a number that does not exist."""
    try:
        found = Condition.from_number(number)
    except ScoringError:
        return ConditionWords("", "")
    return ConditionWords(found.way, found.benchmark_type.value)


class RunSummary(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One run in a list.

    Attributes:
        folder: relative to the results folder.
        started: s since the epoch; without a result, from the folder's name.
        outcome: None = no result yet: the run goes on, or it was cut off.
        reason: why it does not count, in the referee's words (shortened); empty if valid.
        values: by indicator file name, where there is one.
        uncertainties: likewise, where one is known.
        doubts: the number of doubts, where there are any.
        flags: open questions, the most serious first.
        thresholds: those of the testbed that are not the protocol's; None = not known.
        issue: of the result; 0 = none yet.
        protest_filed: when the first open protest was, s since the epoch; None = none is open.
        protest_at: the instant in question of that or the last protest, s from the start.
        protested: a team protested at some time, whatever became of it.
        source: `ros`, `simulated` or `replay`; None = unknown.
        practice: it does not count (protocol section 2). A run of an older version without
            a result may be practice and not say so.
        competition: empty = none was set, None = its files do not say.
        problem: what is wrong with the result; then only folder, numbers and start are known.
        repairable: the result is damaged or out of date, and can be made again.
        voided: the referee voided it, whatever its outcome.
        never_ran: why there is nothing to score; empty = there is, or may be.
        run_id: unique over all testbeds; empty where its files do not say.
        rate: of the door's angle, Hz; None = not known.
        twin: the folder of the same run that counts in place of this one; empty = none.
    """

    folder: str
    subject: int
    condition: int
    run_number: int
    started: StartTime
    team: Name = ""
    outcome: Outcome | None = None
    reason: str = ""
    values: Mapping[IndicatorName, int | float] = {}
    uncertainties: Mapping[IndicatorName, Uncertainty] = {}
    doubts: Mapping[IndicatorName, int] = {}
    flags: tuple[Flag, ...] = ()
    thresholds: Mapping[str, Any] | None = None
    issue: int = 0
    final: bool = False
    team_word: str | None = None
    protest_filed: float | None = None
    protest_at: float | None = None
    protested: bool = False
    source: str | None = None
    practice: bool = False
    competition: str | None = ""
    ruleset: str = ""
    problem: str | None = None
    repairable: bool = False
    never_ran: str = ""
    voided: bool = False
    run_id: str = ""
    testbed: Name = ""
    rate: float | None = None
    twin: str = ""

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        ended = self.outcome in VALID_OUTCOMES and not self.voided
        return ended and self.problem is None and not self.twin

    @property
    def comparable(self) -> bool:
        """Whether it can be compared: it counts and was completed (protocol section 11)."""
        return self.valid and self.outcome is Outcome.COMPLETED

    @property
    def why_twin(self) -> str:
        return why_twin(self.folder, self.twin)

    @property
    def official(self) -> bool:
        """Whether it was meant to count, on a real testbed."""
        return self.source == SourceKind.ROS and not self.practice

    def sign(self, name: str) -> str:
        """As `Indicator.sign`."""
        return DOUBTED if name in self.doubts else ""

    @property
    def outcome_word(self) -> str:
        if self.problem is not None:
            return "DAMAGED"
        if self.twin:
            return TWICE
        if self.outcome is None:
            return "never ran" if self.never_ran else "unfinished"
        return VOID if self.voided else OUTCOME_WORDS[self.outcome]

    @property
    def closing(self) -> str:
        """`PROTEST` while one is open, else `not final`, `final`, or `protested`."""
        if self.protest_filed is not None:
            return PROTEST_OPEN
        if not self.final:
            return "not final"
        return "protested" if self.team_word == "protested" else "final"

    @property
    def started_text(self) -> str:
        return time_words(self.started)

    @cached_property
    def words(self) -> str:
        """The text that a filter searches, in small letters."""
        day = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.started))
        parts = (
            *(self.started_text, day, str(self.subject), self.team, str(self.run_number)),
            *(
                str(self.condition),
                *condition_words(self.condition),
                self.outcome_word,
                self.outcome or "",
            ),
            *(self.closing, self.team_word or "", self.source or "", self.ruleset),
            *(
                self.competition or "",
                self.testbed,
                self.problem or "",
                "practice" if self.practice else "",
            ),
            *(flag.words for flag in self.flags),
        )
        return " ".join(parts).casefold()


_Stamps: TypeAlias = tuple[Stamp | None, ...]


class History:
    """All runs of a results folder, which need not exist. Thread-safe."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._place = str(root)
        self._lock = threading.Lock()
        self._known: dict[str, tuple[_Stamps, RunSummary]] = {}

    def refresh(self) -> tuple[RunSummary, ...]:
        """Every run, oldest first; only a `result.json` that changed is read.

        Links are not followed. What is wrong with a run's files is in its `problem`.
        """
        with self._lock:
            runs = list(self._listed())
        runs.sort(key=attrgetter("started"))
        return twins_told(runs)

    def _listed(self) -> Iterator[RunSummary]:
        """In the order of their folders' names."""
        names, before, self._known = sorted(run_folder_names(self._root)), self._known, {}
        for name in names:
            files = (f"{self._place}/{name}/{file}" for file in (RESULT_FILE, JOURNAL_FILE))
            stamps, kept = tuple(map(stamp_of, files)), before.get(name)
            if kept is not None and kept[0] == stamps:
                self._known[name] = kept
                yield kept[1]
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
            if (why := misplaced(result, named)) is not None:
                return _unusable(unread, folder, why)
            if (why := disagreement(result, Path(folder))) is not None:
                if is_held(Path(folder, JOURNAL_FILE)):
                    return self._told(unread, result)  # it is about to be written
                return _unusable(unread, folder, out_of_date(why), repairable=True)
        except FileNotFoundError:
            run = _of_journal(unread, Path(folder))
            self._known[name] = (stamps, run)
            return run
        except (UnusableResultError, UnusableJournalError) as problem:
            damaged = isinstance(problem, DamagedResultError)
            return _unusable(unread, folder, str(problem), repairable=damaged)
        run = self._told(unread, result)
        self._known[name] = (stamps, run)
        return run

    def _told(self, unread: RunSummary, result: ResultDocument) -> RunSummary:
        """Adds the result; an earlier issue of it may have been protested."""
        run = _of_result(unread, result)
        if run.protested or run.issue <= 1:
            return run
        return replace(run, protested=ever_protested(self._root / unread.folder))


def twins_told(runs: Sequence[RunSummary]) -> tuple[RunSummary, ...]:
    """Sets `twin` of each duplicate that does not count."""
    counting = places_that_count(
        RunPlace(run.folder, run.run_id, run.practice, run.issue) for run in runs
    )
    return tuple(
        run if kept == run.folder else replace(run, twin=kept)
        for run in runs
        for kept in [counting.get(run.run_id, run.folder)]
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
    setup = read_setup(f"{folder}/{JOURNAL_FILE}")
    competition = None if setup is None else setup.competition
    return replace(unread, problem=why, repairable=repairable, competition=competition)


def _of_journal(unread: RunSummary, folder: Path) -> RunSummary:
    problem, never_ran = None, ""
    try:
        never_ran = read_run_journal(folder).never_ran
    except FileNotFoundError:
        return unread
    except UnusableJournalError as error:
        problem = str(error)
    unread = replace(unread, problem=problem, never_ran=never_ran)
    setup = read_setup(f"{folder}/{JOURNAL_FILE}")
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


def _of_result(unread: RunSummary, result: ResultDocument) -> RunSummary:
    found = result.indicators
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
        values={name: one.value for name, one in found.items() if one.value is not None},
        uncertainties={
            name: one.uncertainty for name, one in found.items() if one.uncertainty is not None
        },
        doubts={name: len(one.doubts) for name, one in found.items() if one.doubts},
        flags=result.flags,
        thresholds=_unlike_protocol(result.thresholds or None),
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


def _unlike_protocol(thresholds: Thresholds | None) -> dict[str, Any] | None:
    if thresholds is None:
        return None
    usual = msgspec.to_builtins(Thresholds())
    found = msgspec.to_builtins(thresholds)
    return {name: value for name, value in found.items() if value != usual[name]}


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
