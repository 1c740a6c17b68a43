"""A run in a list: what history, plan, standings, pages and zips know of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from madrob_console.common.formatting import time_words
from madrob_console.common.names import SourceKind, is_rehearsal
from madrob_console.referee.flags import Flag
from madrob_console.referee.run import VALID_OUTCOMES
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome, ScoringError
from scoring.result import DOUBTED, Uncertainty, quantity_text

Name = Annotated[str, Meta(max_length=200)]
StartTime = Annotated[float, Meta(ge=0, le=1e11)]
"""s since the epoch, within the range of calendars."""

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
        condition = Condition.from_number(number)
    except ScoringError:
        return ConditionWords("", "")
    return ConditionWords(condition.way, condition.benchmark_type.value)


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
        practice: it does not count (protocol section 2).
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
        return f"{self.folder} is the same run as {self.twin}, which counts"

    @property
    def why_left_out(self) -> str:
        """Why a run that is not valid does not count."""
        if self.problem is not None:
            return self.problem
        if self.twin:
            return self.why_twin
        if self.outcome is None:
            return "no result yet: it goes on, or the referee decides on it"
        aborted = self.outcome is Outcome.ABORTED
        unsaid = "the referee gave no reason" if aborted else "the machine failed"
        return self.reason or unsaid

    @property
    def official(self) -> bool:
        """Whether it was meant to count, on a real testbed or in a rehearsal."""
        measured = self.source == SourceKind.ROS
        rehearsed = self.source == SourceKind.SIMULATED and is_rehearsal(self.competition)
        return (measured or rehearsed) and not self.practice

    def sign(self, name: str) -> str:
        """As `Indicator.sign`."""
        return DOUBTED if name in self.doubts else ""

    def value_words(self, name: IndicatorName) -> str:
        """`13.86? +- 0.02`, or a dash; of a run that failed the outcome instead of its time."""
        value, uncertainty = self.values.get(name), self.uncertainties.get(name)
        if value is None:
            return f"-{self.sign(name)}"
        if name is IndicatorName.EXECUTION_TIME and self.outcome is not Outcome.COMPLETED:
            return self.outcome_word
        return quantity_text(value, uncertainty, self.sign(name))

    @property
    def result_words(self) -> str:
        """`level 6, completed in 13.86 +- 0.02 s`, `level 1, timeout`, `INVALID: robot on fire`."""
        if not self.valid:
            return f"{self.outcome_word}: {self.reason}" if self.reason else self.outcome_word
        level = f"level {self.value_words(IndicatorName.CAPABILITY_LEVEL)}, {self.outcome_word}"
        if self.outcome is not Outcome.COMPLETED:
            return level
        return f"{level} in {self.value_words(IndicatorName.EXECUTION_TIME)} s"

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
                "practice" if self.practice else "official" if self.official else "",
            ),
            *(f"{flag.words} {'undecided' * flag.undecided}" for flag in self.flags),
        )
        return " ".join(parts).casefold()
