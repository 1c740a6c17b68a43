"""The rules by which signals become results: the protocol's, and others beside it (section 9).

A ruleset holds choices, not code: the modules that compute look their choice up here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto
from sys import float_info

from scoring.indicator_table import IndicatorName
from scoring.protocol import ScoringError, Thresholds


class RulesetName(StrEnum):
    """The rulesets, as results and settings name them."""

    PROTOCOL = "protocol"
    EUROBENCH_2020 = "eurobench-2020"


class WindowRule(Enum):
    """How many samples the moving average takes.

    `INSIDE`: the smallest odd number >= window_time * rate - 1, with the rate rounded to whole
    Hz. `COVERING`: 1 + 2 * ceil(window_time / interval / 2).
    """

    INSIDE = auto()
    COVERING = auto()


class LowPassRule(Enum):
    """How the low-pass filter runs.

    `ZERO_PHASE`: forth and back (no delay). `ONE_PASS`: forth only.
    """

    ZERO_PHASE = auto()
    ONE_PASS = auto()


class JerkRule(Enum):
    """When rows of a closed door are dropped: after or before the jerk is derived."""

    DERIVE_THEN_SELECT = auto()
    SELECT_THEN_DERIVE = auto()


class ExecutionEnd(Enum):
    """What ends the execution time."""

    BENCHMARK_STOP = auto()
    LAST_CLOSING_OR_CROSSING = auto()


class CapabilityRule(Enum):
    """What the capability level counts: steps in order (0..6), or events in any order (0..4)."""

    STEPS_IN_ORDER = auto()
    EVENTS_IN_ANY_ORDER = auto()

    @property
    def arrival_decides(self) -> tuple[IndicatorName, ...]:
        """Indicators that depend on the arrival, which the level counts only as an event."""
        counted = self is CapabilityRule.EVENTS_IN_ANY_ORDER
        return (IndicatorName.CAPABILITY_LEVEL,) if counted else ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ruleset:
    """One way to compute results (section 9).

    Attributes:
        window_time: base of the length of the door angle's moving average, s.
        savgol_window: samples; None = as in the moving average.
        low_pass_frequency: critical frequency of the acceleration's Butterworth filter, Hz.
        knows_gaps: whether a gap ends a stretch of data and stays out of the sampling interval.
        passage_needs_steps: whether the passage time requires steps 1, 3, 4 and 5.
        missing_value: stands in an indicator's YAML file that has no value.
        cut_rows: whether rows outside of [start, stop] are left out.
        passage_events_to_end: whether passage events up to the recording's end count.
        present_height: an obstacle higher than this is a robot, m; None = as in `Thresholds`.
        masked_is_absent: whether a masked sensor counts as absent; else it keeps its state.
        believes_impossible: whether readings beyond the sensors' range count.
    """

    name: RulesetName
    windows: WindowRule
    window_time: float = 0.2
    savgol_window: int | None = None
    savgol_order: int = 2
    low_pass: LowPassRule
    low_pass_order: int = 5
    low_pass_frequency: float = 2.0
    knows_gaps: bool
    jerk: JerkRule
    execution_end: ExecutionEnd
    passage_needs_steps: bool
    occupation_only_if_positive: bool
    capability: CapabilityRule
    missing_value: str | None
    cut_rows: bool
    passage_events_to_end: bool
    present_height: float | None
    masked_is_absent: bool
    believes_impossible: bool = False
    explanations: Mapping[IndicatorName, str] = field(default_factory=dict, hash=False)

    def explanation(self, name: IndicatorName) -> str:
        return self.explanations.get(name, name.spec.explanation)

    def largest_angle(self, thresholds: Thresholds) -> float:
        """Door angles beyond this, to either side, are no readings, rad."""
        return float_info.max if self.believes_impossible else thresholds.largest_angle

    def largest_force(self, thresholds: Thresholds) -> float:
        """Forces beyond this, in either direction, are no readings, N."""
        return float_info.max if self.believes_impossible else thresholds.impossible_force


PROTOCOL = Ruleset(
    name=RulesetName.PROTOCOL,
    windows=WindowRule.INSIDE,
    low_pass=LowPassRule.ZERO_PHASE,
    knows_gaps=True,
    jerk=JerkRule.DERIVE_THEN_SELECT,
    execution_end=ExecutionEnd.BENCHMARK_STOP,
    passage_needs_steps=True,
    occupation_only_if_positive=False,
    capability=CapabilityRule.STEPS_IN_ORDER,
    missing_value=None,
    cut_rows=True,
    passage_events_to_end=False,
    present_height=None,
    masked_is_absent=False,
)

EUROBENCH_2020 = Ruleset(
    name=RulesetName.EUROBENCH_2020,
    windows=WindowRule.COVERING,
    savgol_window=11,
    low_pass=LowPassRule.ONE_PASS,
    knows_gaps=False,
    jerk=JerkRule.SELECT_THEN_DERIVE,
    execution_end=ExecutionEnd.LAST_CLOSING_OR_CROSSING,
    passage_needs_steps=False,
    occupation_only_if_positive=True,
    capability=CapabilityRule.EVENTS_IN_ANY_ORDER,
    missing_value="TIMEOUT",
    cut_rows=False,
    passage_events_to_end=True,
    present_height=1.00,
    masked_is_absent=True,
    believes_impossible=True,
    explanations={
        IndicatorName.EXECUTION_TIME: (
            "From the start of the run until the door was closed and the robot through, whichever "
            "came later."
        ),
        IndicatorName.CAPABILITY_LEVEL: (
            "How many of four things happened, in any order: arrival, touch, passage, closing."
        ),
    },
)
"""As the published EUROBENCH scripts compute, so that new results can be compared with old ones."""


def ruleset(name: str) -> Ruleset:
    try:
        ruleset = RulesetName(name)
    except ValueError:
        allowed = " or ".join(RulesetName)
        raise ScoringError(f"ruleset {name!r} is not known: use --ruleset {allowed}") from None
    match ruleset:
        case RulesetName.PROTOCOL:
            return PROTOCOL
        case RulesetName.EUROBENCH_2020:
            return EUROBENCH_2020
