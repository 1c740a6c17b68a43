"""The keys of `result.json` that lists and tables of runs need, and how far they are believed.

What the file holds is declared in `result_document`.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from madrob_console.archive.folders import LARGEST_NUMBER
from madrob_console.kinds import SourceKind
from madrob_console.referee.flags import Flag
from madrob_console.referee.on_record import (
    AcceptedDoubts,
    Closure,
    Correction,
    FalseStart,
    Incident,
    JournalMark,
    Reissuing,
    TestbedFault,
    Voiding,
    Waiver,
)
from madrob_console.referee.protests import Protest
from madrob_console.referee.run import VALID_OUTCOMES
from scoring.indicator_table import IndicatorName
from scoring.libraries import Libraries
from scoring.procedure import Ruling, StepRecord
from scoring.protocol import Condition, Outcome, Signal, Step, Thresholds
from scoring.result import Indicator, Uncertainty

Number = Annotated[int, Meta(ge=1, le=LARGEST_NUMBER)]
"""Of a subject or a run."""
ConditionNumber = Annotated[int, Meta(ge=1, le=20)]
Name = Annotated[str, Meta(max_length=200)]
"""Longer than any name that the console writes."""
StartTime = Annotated[float, Meta(ge=0, le=1e11)]
"""s since the epoch, within what calendars reach."""

_UNTOLD = "why is not told"

Spread = Annotated[float, Meta(ge=0)]
"""Of a value, in its unit."""


class UncertaintyPart(msgspec.Struct, frozen=True):
    """How far a value can be trusted."""

    u: Spread
    expanded: Spread


class IndicatorPart(msgspec.Struct, frozen=True):
    """One indicator; no value where there is a reason instead."""

    value: int | float | None
    unit: str = ""
    reason: str | None = None
    uncertainty: UncertaintyPart | None = None
    doubts: tuple[str, ...] = ()

    def of(self, name: IndicatorName) -> Indicator:
        """The same of an indicator that is known, in its unit."""
        if self.value is None:
            return Indicator(None, name.spec.unit, self.reason or _UNTOLD, doubts=self.doubts)
        known = self.uncertainty
        spread = None if known is None else Uncertainty(known.u, known.expanded)
        return Indicator(self.value, name.spec.unit, None, spread, self.doubts)


class ClosurePart(msgspec.Struct, frozen=True):
    """How the result was finalised."""

    team_word: Name


class VoidingPart(msgspec.Struct, frozen=True):
    """Why a run counts nowhere."""

    reason: str


class AnswerPart(msgspec.Struct, frozen=True):
    """What closed a protest."""

    end: Name


class ProtestPart(msgspec.Struct, frozen=True):
    """A protest against the result; without an answer it is open. Times as `StartTime`."""

    due: StartTime
    at: StartTime | None = None
    answer: AnswerPart | None = None


class FormerSetup(msgspec.Struct, frozen=True):
    """As which run a run was set up, before a correction."""

    subject: Number
    run_number: Number
    condition: Condition


class CorrectionPart(msgspec.Struct, frozen=True):
    """What was set until a correction."""

    before: FormerSetup


class ZeroPart(msgspec.Struct, frozen=True):
    """The handle zero that was set for a run, N."""

    mean: int | float


class SignalRate(msgspec.Struct, frozen=True):
    """How often a signal was sampled, Hz."""

    signal: str
    rate: Annotated[float, Meta(ge=0)] | None = None


class RatesPart(msgspec.Struct, frozen=True):
    """What is read of the data quality."""

    signals: Annotated[tuple[SignalRate, ...], Meta(max_length=50)] = ()


class RunKind(msgspec.Struct, frozen=True):
    """What is read of the set-up in a result; older ones know no practice."""

    practice: bool = False


class ListedResult(msgspec.Struct, frozen=True):
    """What lists of runs read of a `ResultDocument`; words of later versions pass as they are."""

    subject: Number
    condition_number: ConditionNumber
    run_number: Number
    team: Name
    start: StartTime
    outcome: Outcome
    indicators: dict[str, IndicatorPart]
    issue: Annotated[int, Meta(ge=0)]
    ruleset: Name
    source: Name | None = None
    competition: Name = ""
    closure: ClosurePart | None = None
    outcome_reason: str = ""
    journal: JournalMark | None = None
    flags: Annotated[tuple[Flag, ...], Meta(max_length=50)] | None = None
    voided: VoidingPart | None = None
    corrections: tuple[CorrectionPart, ...] = ()
    protests: Annotated[tuple[ProtestPart, ...], Meta(max_length=50)] = ()
    setup: RunKind = RunKind()
    libraries: Libraries | None = None
    zero_samples: ZeroPart | None = None
    run_id: Name = ""
    testbed: Name = ""
    thresholds: Thresholds | None = None
    quality: RatesPart = RatesPart()

    @property
    def told(self) -> dict[IndicatorName, Indicator]:
        """The indicators that this version knows, in the protocol's order."""
        parts = self.indicators
        return {name: parts[name].of(name) for name in IndicatorName if name in parts}

    @property
    def rate(self) -> float | None:
        """How often the door's angle was sampled, Hz; None where it does not say."""
        door = Signal.DOOR.value
        return next((one.rate for one in self.quality.signals if one.signal == door), None)

    @property
    def open_protest(self) -> ProtestPart | None:
        """The open protest that is due first; None = none is open."""
        waiting = (one for one in self.protests if one.answer is None)
        return min(waiting, key=lambda one: one.due, default=None)

    @property
    def instant_in_question(self) -> float | None:
        """Of the protest that is open, else of the last one, s from the start; None = none."""
        of = self.open_protest or (self.protests[-1] if self.protests else None)
        return None if of is None or of.at is None else of.at - self.start

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        return self.outcome in VALID_OUTCOMES and self.voided is None

    @property
    def why_invalid(self) -> str:
        """Why they do not, in the referee's words or the machine's; empty where they do."""
        if self.voided is not None:
            return self.voided.reason
        return "" if self.valid else self.outcome_reason

    @property
    def practice(self) -> bool:
        """Whether it is of a practice run; all those of a simulated testbed are."""
        return self.setup.practice or self.source == SourceKind.SIMULATED


class RulingPart(msgspec.Struct, frozen=True):
    """The referee's word on a step."""

    confirmed: bool | None


class StepPart(msgspec.Struct, frozen=True):
    """One of the six steps: its times, s since the epoch; null = not done."""

    step: Step
    name: Name = ""
    sensors: StartTime | None = None
    referee: RulingPart | None = None
    final: StartTime | None = None
    reason: str | None = None


class StepsPart(msgspec.Struct, frozen=True):
    """When what was done in a run, s since the epoch; no stop where the machine failed."""

    start: StartTime
    stop: StartTime | None
    steps: Annotated[tuple[StepPart, ...], Meta(max_length=len(Step))]

    @property
    def done(self) -> dict[Step, float]:
        """The steps that count."""
        return {one.step: one.final for one in self.steps if one.final is not None}


class SetupPart(msgspec.Struct, frozen=True):
    """What is read of a run's set-up in its journal."""

    subject: Number
    team: Name
    ruleset: Name
    practice: bool = False
    run_id: Name = ""
    testbed: Name = ""
    competition: Name | None = None


class RemarksPart(msgspec.Struct):
    """What is said of the data quality."""

    remarks: list[str]


class MarksPart(msgspec.Struct, frozen=True):
    """What a result of a version that wrote no flags has of them."""

    outcome: Outcome
    source: SourceKind
    quality: RemarksPart
    steps: tuple[StepRecord, ...]
    false_starts: tuple[FalseStart, ...]
    incidents: tuple[Incident, ...]
    waivers: tuple[Waiver, ...]
    rulings: tuple[Ruling, ...]
    closure: Closure | None
    voided: Voiding | None = None
    corrections: tuple[Correction, ...] = ()
    setup: RunKind = RunKind()

    @property
    def practice(self) -> bool:
        """Whether it was set up as practice."""
        return self.setup.practice

    @property
    def out_of_plan(self) -> bool:
        """Who wrote no flags knew no plan."""
        return False

    @property
    def team_reason(self) -> str:
        """There was no list of teams to differ from."""
        return ""

    @property
    def accepted_doubts(self) -> tuple[AcceptedDoubts, ...]:
        """Nor any doubts."""
        return ()

    @property
    def protests(self) -> tuple[Protest, ...]:
        """Nor any protests but the team's word."""
        return ()

    @property
    def faults(self) -> tuple[TestbedFault, ...]:
        """They stand among the remarks, as `Run.remarks` words them."""
        found = (text for text in self.quality.remarks if text.startswith(("fault at ", "fault: ")))
        return tuple(TestbedFault(0.0, text) for text in found)

    @property
    def unrecorded(self) -> int:
        """It was told by the remarks alone."""
        return 0


class EventPart(msgspec.Struct, frozen=True):
    """Something that happened, s since the epoch and since the start."""

    time: float
    since_start: float
    event: Name


class PagedResult(ListedResult, frozen=True):
    """What the page of a run on a competition's site reads besides."""

    steps: Annotated[tuple[StepRecord, ...], Meta(max_length=len(Step))] = ()
    reissues: tuple[Reissuing, ...] = ()


class TabledResult(ListedResult, frozen=True):
    """What the tables of runs read besides."""

    stop: float | None = None
    lock_detection: Name = ""
    software: str = ""
    events: tuple[EventPart, ...] = ()
    steps: tuple[StepPart, ...] = ()
