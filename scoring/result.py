"""The result of one run: plain data without the numbers' machinery, so that screens can hold it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scoring.errors import ScoringError
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import Condition, Event, LockDetection, Outcome
from scoring.quality import Quality
from scoring.rulesets import RulesetName


@dataclass(frozen=True, slots=True)
class Indicator:
    """One performance indicator: a value, or the reason why there is none.

    Attributes:
        name: which one.
        value: the value in `unit`; None where it cannot be computed.
        unit: unit of the value.
        reason: why there is no value, in words; None where there is one.

    Raises:
        ScoringError: there are both or neither of value and reason, or the value is not finite.
    """

    name: IndicatorName
    value: float | int | None
    unit: str
    reason: str | None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.reason is None):
            raise ScoringError(f"{self.name}: give either a value or the reason why there is none")
        if self.value is not None and not math.isfinite(self.value):
            raise ScoringError(f"{self.name}: {self.value} is no value: give a reason instead")

    @classmethod
    def of(cls, name: IndicatorName, value: float) -> Indicator:
        """An indicator with a value; a value that is not finite becomes a reason."""
        if not math.isfinite(value):
            return cls.missing(name, "out of the range of numbers")
        # numpy scalars would be written as object tags by YAML
        plain = int(value) if name.spec.counts else float(value)
        return cls(name, plain, name.spec.unit, None)

    @classmethod
    def missing(cls, name: IndicatorName, reason: str) -> Indicator:
        """An indicator without a value."""
        return cls(name, None, name.spec.unit, reason)


@dataclass(frozen=True, slots=True)
class Ending:
    """How the run ended.

    Attributes:
        outcome: completed, timeout, aborted or interrupted.
        reason: why, in words.
        stop: s since the epoch; None for a run cut off by a failure of the machine.
    """

    outcome: Outcome
    reason: str
    stop: float | None


@dataclass(frozen=True, slots=True)
class Result:
    """The result of one run (sections 6 and 7).

    Attributes:
        ruleset: the rules that made it.
        condition: of the run.
        ending: how it ended.
        start: s since the epoch.
        indicators: all that there are, in the protocol's order.
        steps: the six, with what sensors and referee say.
        lock_detection: what decided step 6; never `AUTO`.
        events: all events by time.
        handle_zero: N, as set by the referee.
        quality: of the data.
    """

    ruleset: RulesetName
    condition: Condition
    ending: Ending
    start: float
    indicators: tuple[Indicator, ...]
    steps: tuple[StepRecord, ...]
    lock_detection: LockDetection
    events: tuple[Event, ...]
    handle_zero: float
    quality: Quality

    def indicator(self, name: IndicatorName) -> Indicator:
        """One of them."""
        return next(i for i in self.indicators if i.name is name)


def value_text(value: float) -> str:
    """Counts as they are, numbers with four decimals, very small or large ones in powers."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.4f}" if value == 0 or 1e-2 <= abs(value) < 1e6 else f"{value:.4e}"
