"""The runs of a results folder: what each `result.json` says, with an index for speed.

The index `.history.json` is only a cache: it is made again whenever it is missing, damaged or
of another version, and not kept where the folder cannot be written.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec.structs import replace

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    RESULT_FORMAT,
    RunId,
    parse_folder_name,
    run_folder_names,
)
from madrob_console.archive.result_reader import (
    ListedResult,
    Name,
    StartTime,
    UnusableResultError,
    read_result,
    read_setup,
)
from madrob_console.archive.stamped_index import StampedIndex
from madrob_console.files.bounded import stamp_of
from madrob_console.kinds import SourceKind
from scoring.errors import ScoringError
from scoring.protocol import Condition, Outcome

INDEX_FILE = ".history.json"
"""In the results folder."""

_INDEX_VERSION = (2, RESULT_FORMAT)
_LONGEST_REASON = 500  # characters
_VALID = (Outcome.COMPLETED, Outcome.TIMEOUT)

OUTCOME_WORDS = {
    Outcome.COMPLETED: "completed",
    Outcome.TIMEOUT: "timeout",
    Outcome.ABORTED: "INVALID",
    Outcome.INTERRUPTED: "INTERRUPTED",
}
"""In capitals where a run does not count."""


class ConditionWords(NamedTuple):
    """A condition in words: `pull, from CW to CCW` and the benchmark type."""

    way: str
    door: str


@lru_cache
def condition_words(number: int) -> ConditionWords:
    """What a condition asks of the robot; empty words for a number that does not exist."""
    try:
        found = Condition.from_number(number)
    except ScoringError:
        return ConditionWords("", "")
    return ConditionWords(found.way, found.benchmark_type.value)


class RunSummary(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One run in a list.

    Attributes:
        folder: name of its folder.
        subject, condition, run_number: which run it is; the condition's number.
        started: s since the epoch; before there is a result, as the folder's name has it.
        team: the team's name; empty where unknown.
        outcome: None = no result yet: the run goes on, or it was cut off.
        reason: why it does not count, in the referee's words; empty for a valid run. Long ones
            are cut.
        values: indicator file name -> value, those with a value only.
        issue: of the result; 0 = none yet.
        final: whether the result is finalised.
        team_word: what the team said to the final result.
        source: `ros`, `simulated` or `replay`; None = unknown.
        competition, ruleset: as they were set.
        problem: what is wrong with the result, in words; None = nothing. With a problem, all but
            folder, numbers and start is unknown.
    """

    folder: str
    subject: int
    condition: int
    run_number: int
    started: StartTime
    team: Name = ""
    outcome: Outcome | None = None
    reason: str = ""
    values: dict[str, int | float] = {}
    issue: int = 0
    final: bool = False
    team_word: str | None = None
    source: str | None = None
    competition: str = ""
    ruleset: str = ""
    problem: str | None = None

    @property
    def valid(self) -> bool:
        """Whether its indicators count: completed or timeout (protocol section 2)."""
        return self.outcome in _VALID and self.problem is None

    @property
    def official(self) -> bool:
        """Whether the messages came from a real testbed."""
        return self.source == SourceKind.ROS

    @property
    def practice(self) -> bool:
        """Whether they came from a simulated one."""
        return self.source == SourceKind.SIMULATED

    @property
    def outcome_word(self) -> str:
        """How it ended, in a word; in capitals where it does not count."""
        if self.problem is not None:
            return "DAMAGED"
        return "unfinished" if self.outcome is None else OUTCOME_WORDS[self.outcome]

    @property
    def closing(self) -> str:
        """`open` until the result is final; then `final`, or `protested`."""
        if not self.final:
            return "open"
        return "protested" if self.team_word == "protested" else "final"

    @property
    def started_text(self) -> str:
        """Local date and time of day: `21 Nov 14:28`."""
        return time.strftime("%d %b %H:%M", time.localtime(self.started))

    @cached_property
    def words(self) -> str:
        """Everything that a filter looks at, in small letters."""
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
            *(self.competition, self.problem or ""),
        )
        return " ".join(parts).casefold()


class History:
    """All runs of a results folder. Any thread may ask; one at a time is served.

    Args:
        root: the results folder; it need not exist.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._index: StampedIndex[RunSummary] | None = None

    def refresh(self) -> tuple[RunSummary, ...]:
        """Every run, oldest first; only a `result.json` that changed is read.

        Links are not followed. Whatever is wrong with a run's files stands in its `problem`.

        Raises:
            MadrobError: the results folder exists but cannot be read.
        """
        with self._lock:
            names = run_folder_names(self._root)
            if self._index is None:
                self._index = StampedIndex(self._root / INDEX_FILE, RunSummary, _INDEX_VERSION)
            found = (self._summary(name, self._index) for name in names)
            runs = [run for run in found if run is not None]
            self._index.keep_only(names)
            self._index.save()
        return tuple(sorted(runs, key=lambda run: (run.started, run.folder)))

    def _summary(self, name: str, index: StampedIndex[RunSummary]) -> RunSummary | None:
        folder = f"{self._root}/{name}"
        kept = index.get(name, stamp_of(f"{folder}/{RESULT_FILE}"))
        if kept is not None and kept.folder == name:
            return kept
        parsed = parse_folder_name(name)
        if parsed is None:  # a date that does not exist
            return None
        run_id, local = parsed
        unread = RunSummary(
            folder=name,
            subject=run_id.subject,
            condition=run_id.condition,
            run_number=run_id.run,
            started=local.timestamp(),
        )
        try:
            result, stamp = read_result(folder)
        except FileNotFoundError:
            setup = read_setup(f"{folder}/{JOURNAL_FILE}")
            if setup is None:
                return unread
            return replace(unread, team=setup.team, ruleset=setup.ruleset)
        except UnusableResultError as problem:
            return replace(unread, problem=str(problem))
        if (why := _misplaced(result, run_id)) is not None:
            return replace(unread, problem=why)
        run = _of_result(unread, result)
        index.put(name, stamp, run)
        return run


def earlier_runs(
    runs: Iterable[RunSummary],
    subject: int,
    condition: int,
    before: float,
    *,
    source: str | None,
    ruleset: str | None = None,
) -> tuple[RunSummary, ...]:
    """The runs with which a run can be compared: valid, same robot, same condition.

    Args:
        runs: from a history.
        subject: of the run.
        condition: its number.
        before: the start of the run, s since the epoch; only runs started before it.
        source: of the run: simulated runs compare with simulated ones only.
        ruleset: of the run: other rules make other numbers; None = any.
    """
    return tuple(
        run
        for run in runs
        if run.valid
        and (run.subject, run.condition, run.source) == (subject, condition, source)
        and run.started < before
        and ruleset in (None, run.ruleset)
    )


def matches(run: RunSummary, text: str) -> bool:
    """Whether a run passes a filter: every word of the text occurs in the run's words.

    Capitals do not matter. `subject:3`, `run:2`, `cond:5` and `team:delft` look at that alone.
    """
    return all(_has(run, word) for word in text.casefold().split())


def _has(run: RunSummary, word: str) -> bool:
    field, _, wanted = word.partition(":")
    match field:
        case "subject" | "run" | "cond":
            number = {"subject": run.subject, "run": run.run_number, "cond": run.condition}[field]
            return not wanted or wanted.lstrip("0") == str(number)
        case "team":
            return wanted in run.team.casefold()
    return word in run.words


def _of_result(unread: RunSummary, result: ListedResult) -> RunSummary:
    values = {name: found.value for name, found in result.indicators.items()}
    closure = result.closure
    return replace(
        unread,
        started=result.start,
        team=result.team,
        outcome=result.outcome,
        reason="" if result.outcome in _VALID else result.outcome_reason[:_LONGEST_REASON],
        values={name: value for name, value in values.items() if value is not None},
        issue=result.issue,
        final=closure is not None,
        team_word=None if closure is None else closure.team_word,
        source=result.source,
        competition=result.competition,
        ruleset=result.ruleset,
    )


def _misplaced(result: ListedResult, folder: RunId) -> str | None:
    """A result in the folder of another run would count twice, or for another team."""
    run = RunId(result.subject, result.condition_number, result.run_number)
    if run == folder:
        return None
    of = f"subject {run.subject}, condition {run.condition}, run {run.run}"
    return f"{RESULT_FILE} is of {of}: put it back into its own folder"
