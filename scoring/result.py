"""The result of one run: plain data without the numbers' machinery, so that screens can hold it.

What stands here is what `result.json` says of it: names, order and meaning are the file's.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import Event, EventName, LockDetection, Outcome, ScoringError
from scoring.quality import Quality
from scoring.rest import RestForce

if TYPE_CHECKING:
    from pandas import DataFrame

DOUBTED = "?"
"""Stands directly behind a value that is doubted, and behind the reason why there is none."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How far a value can be trusted (protocol section 11), in the indicator's unit.

    Attributes:
        u: standard uncertainty, two significant digits.
        expanded: half-width of the 95 % interval, two significant digits.
        rest: how much of the value the sensor reads at rest.
    """

    u: float
    expanded: float
    rest: float = 0.0

    @classmethod
    def of_mean(
        cls, parts: Sequence[Uncertainty | None], deviation: float | None = None
    ) -> Uncertainty | None:
        """Return that of the mean of several values, by measurement or by their scatter.

        Args:
            parts: of the values, which err independently of each other.
            deviation: the sample standard deviation of the values; None for one value.

        Returns:
            The larger one: the root of the sum of the parts' squares divided by their number, or
            the deviation divided by the root of that number, expanded by Student's t. None where a
            part is not known, there is none, or it is beyond the range of numbers.
        """
        uncertainties = [part for part in parts if part is not None]
        if not uncertainties or len(uncertainties) < len(parts):
            return None
        scatter = (deviation or 0.0) / math.sqrt(len(uncertainties))
        u = math.hypot(*(part.u for part in uncertainties)) / len(uncertainties)
        expanded = math.hypot(*(part.expanded for part in uncertainties)) / len(uncertainties)
        if not math.isfinite(expanded):
            return None
        rest = math.fsum(part.rest for part in uncertainties) / len(uncertainties)
        return cls(max(u, scatter), max(expanded, _student(len(uncertainties) - 1) * scatter), rest)


_STUDENT = (0.0, 12.71, 4.31, 3.19, 2.78, 2.58, 2.45, 2.37, 2.31, 2.27)


def _student(freedom: int) -> float:
    """Return Student's t for 95 of 100 on both sides, from 10 on by its first two terms."""
    if freedom < len(_STUDENT):
        return _STUDENT[freedom]
    return 1.96 + 2.38 / freedom + 2.9 / freedom**2


@dataclass(frozen=True, slots=True)
class Indicator:
    """One performance indicator: a value, or the reason why there is none (protocol section 6).

    Attributes:
        value: in the unit; null where it cannot be computed.
        unit: of the value.
        reason: why there is no value, in words; null where there is one.
        uncertainty: of the value (section 11); null where there is no value, or none is known yet.
        doubts: why the value, or that there is none, may be wrong, in sentences; none changes it.

    Raises:
        ScoringError: there are both or neither of value and reason, or the value is not finite.
    """

    value: int | float | None
    unit: str
    reason: str | None
    uncertainty: Uncertainty | None = None
    doubts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if (self.value is None) == (self.reason is None):
            raise ScoringError("give either a value or the reason why there is none")
        if self.value is not None and not math.isfinite(self.value):
            raise ScoringError(f"{self.value} is no value: give a reason instead")

    @property
    def sign(self) -> str:
        """A question mark where it is doubted, else nothing."""
        return DOUBTED if self.doubts else ""

    @property
    def text(self) -> str:
        """All of it on one line: `13.86? +- 0.02 s`, or `none: handle never touched`."""
        if self.value is None:
            return f"none: {self.reason}{self.sign}"
        text = quantity_text(self.value, self.uncertainty, self.sign, self.unit)
        worth = self.uncertainty
        if worth is None or abs(worth.rest) <= worth.expanded:
            return text
        return f"{text}, of these {worth.rest:.1f} {self.unit} at rest"

    @classmethod
    def of(cls, name: IndicatorName, value: float) -> Indicator:
        """An indicator with a value.

        A value that is not finite becomes a reason.
        """
        if not math.isfinite(value):
            return cls.missing(name, "out of the range of numbers")
        # numpy scalars would be written as object tags by YAML
        plain = int(value) if name.spec.counts else float(value)
        return cls(plain, name.spec.unit, None)

    @classmethod
    def missing(cls, name: IndicatorName, reason: str) -> Indicator:
        """An indicator without a value."""
        return cls(None, name.spec.unit, reason)


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
class EventRecord:
    """Something that happened (protocol section 4).

    Attributes:
        time: s since the epoch.
        since_start: s since the start of the run.
        event: what, as EUROBENCH names it.
    """

    time: float
    since_start: float
    event: EventName

    @classmethod
    def of(cls, event: Event, start: float) -> EventRecord:
        """An event of a run that started at `start`, s since the epoch."""
        return cls(event.time, event.time - start, event.name)


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of one run (sections 6 and 7).

    Attributes:
        handle_zero: force of the handle at rest, N; subtracted before a touch is looked for.
        ruleset: name of the rules that made the indicators.
        outcome: how the run ended; an aborted run is invalid, an interrupted one does not count.
        outcome_reason: why it ended, in words.
        start: s since the epoch.
        stop: s since the epoch; null for a run that was cut off by a failure of the machine.
        indicators: all that there are, in the protocol's order, each with unit and value or
            reason.
        lock_detection: what decided step 6; never `auto`.
        steps: the six, in order, with what sensors and referee say.
        events: by time.
        quality: of the data.
        rest: the handle's force at rest before the run and after it; null in results of earlier
            versions.
    """

    handle_zero: float
    ruleset: str
    outcome: Outcome
    outcome_reason: str
    start: float
    stop: float | None
    indicators: dict[IndicatorName, Indicator]
    lock_detection: LockDetection
    steps: tuple[StepRecord, ...]
    events: tuple[EventRecord, ...]
    quality: Quality
    rest: RestForce | None = None

    @property
    def doubts(self) -> dict[str, tuple[IndicatorName, ...]]:
        """Each doubt once, with the indicators that it is on."""
        return doubts_of(self.indicators)

    @property
    def lacks_steps(self) -> bool:
        """Whether a run that ended as completed has steps that do not count."""
        return self.outcome is Outcome.COMPLETED and not all(step.done for step in self.steps)

    @property
    def ended(self) -> str:
        """The reason for the end.

        Of a run that lacks steps, how many count, and why not the next one.
        """
        if not self.lacks_steps:
            return self.outcome_reason
        undone = [record for record in self.steps if not record.done]
        step, count = undone[0].step, len(self.steps) - len(undone)
        why = f"step {step:d}: {undone[0].why_not}"
        if undone[0].denied:
            why = f"the referee denied step {step:d}"
        return f"{count} of {len(self.steps)} steps count: {why}"

    def to_frame(self) -> DataFrame:
        """The indicators, a row each.

        Numbers with all their digits, missing ones NaN.
        """
        from pandas import DataFrame

        rows = (
            {
                "value": indicator.value,
                "uncertainty": indicator.uncertainty and indicator.uncertainty.u,
                "expanded_uncertainty": indicator.uncertainty and indicator.uncertainty.expanded,
                "unit": indicator.unit,
                "reason": indicator.reason or "",
                "doubts": "; ".join(indicator.doubts),
            }
            for indicator in self.indicators.values()
        )
        frame = DataFrame(rows, index=[*map(str, self.indicators)])
        return frame.astype(dict.fromkeys(frame.columns[:3], float))

    def _repr_html_(self) -> str:
        """The table that a notebook shows, with the digits that the values have."""
        from html import escape

        rows = (
            "<tr><td>"
            + "<td>".join(map(escape, (name, indicator.text, "; ".join(indicator.doubts))))
            for name, indicator in self.indicators.items()
        )
        about = escape(f"{self.outcome}: {self.ended}, by {self.ruleset}")
        return f"<table><caption>{about}</caption>{''.join(rows)}</table>"


def doubts_of(
    indicators: Mapping[IndicatorName, Indicator],
) -> dict[str, tuple[IndicatorName, ...]]:
    """Each doubt on some indicators once, with those that it is on."""
    names_of: dict[str, tuple[IndicatorName, ...]] = {}
    for name, indicator in indicators.items():
        for words in indicator.doubts:
            names_of[words] = (*names_of.get(words, ()), name)
    return names_of


def distinguishable(
    value: float, other: float, of_value: Uncertainty | None, of_other: Uncertainty | None
) -> bool:
    """Return whether two values differ by more than their uncertainties (section 11).

    They do not where their expanded uncertainties overlap, nor where the rests that they contain
    differ by as much. Where one is unknown, or neither has any, they count as different.

    Args:
        value: one of the two, or a mean of values.
        other: the second one.
        of_value: the uncertainty of the first.
        of_other: and of the second.
    """
    if of_value is None or of_other is None:
        return True
    both = of_value.expanded + of_other.expanded + abs(of_value.rest - of_other.rest)
    return not both or abs(value - other) > both


def value_text(value: float, uncertainty: Uncertainty | None = None) -> str:
    """A value with the digits that it has.

    Counts as they are; numbers down to the digit that their expanded uncertainty leaves
    (`uncertainty_text`), with four decimals where none is known; exact ones, such as a timeout's
    time, with two from 1 on and no zeros at their end; very small or large ones in powers.
    """
    if isinstance(value, int):
        return str(value)
    plain = value == 0 or 1e-2 <= abs(value) < 1e6
    if uncertainty is None or not uncertainty.expanded:
        decimals = 4 if uncertainty is None or abs(value) < 1 else 2
        text = f"{value:.{decimals}f}" if plain else f"{value:.4e}"
        return text if uncertainty is None else without_zeros(text)
    if plain:
        return f"{value:.{decimals_left(uncertainty)}f}"
    _, place = _rounded_up(uncertainty.expanded)
    return f"{value:.{max(0, math.floor(math.log10(abs(value) or 1)) - place)}e}"


def quantity_text(
    value: float, uncertainty: Uncertainty | None, sign: str = "", unit: str = ""
) -> str:
    """A value with its sign, its uncertainty and its unit: `13.86? +- 0.02 s`."""
    number = f"{value_text(value, uncertainty)}{sign}"
    return " ".join(filter(None, (number, uncertainty_text(uncertainty), unit)))


def without_zeros(number: str) -> str:
    """The text of an exact number, without the zeros behind its last decimal."""
    return number.rstrip("0").rstrip(".") if "." in number and "e" not in number else number


def uncertainty_text(uncertainty: Uncertainty | None) -> str:
    """An expanded uncertainty as it stands beside its value, `+- 0.02`.

    Empty where none is known.

    Of one digit, rounded up: that never says less than there is.
    """
    if uncertainty is None or not uncertainty.expanded:
        return ""
    digit, place = _rounded_up(uncertainty.expanded)
    if -4 <= place < 6:
        return f"+- {digit * 10.0**place:.{max(0, -place)}f}"
    return f"+- {digit}e{place:+03d}"


def difference_text(difference: float, of: Iterable[Uncertainty | None], decimals: int) -> str:
    """A difference with its sign, and the digits that the largest uncertainty leaves.

    Args:
        difference: of two values, in their unit.
        of: the uncertainties of the two; None = not known.
        decimals: where none is known, or both are exact: then without zeros at the end.
    """
    uncertainties = [each for each in of if each is not None]
    widest = max(uncertainties, key=lambda each: each.expanded, default=None)
    if widest is not None and widest.expanded:
        return f"{difference:+.{decimals_left(widest)}f}"
    if isinstance(difference, int):
        return f"{difference:+d}"
    text = f"{difference:+.{decimals}f}"
    return text if widest is None else without_zeros(text)


def decimals_left(uncertainty: Uncertainty) -> int:
    """Return how many decimals an expanded uncertainty above 0 leaves of a value."""
    _, place = _rounded_up(uncertainty.expanded)
    return max(0, -place)


def _rounded_up(expanded: float) -> tuple[int, int]:
    """One significant digit, rounded up, and the power of ten at which it stands."""
    two_digits, _, power = f"{expanded:.1e}".partition("e")
    digit = math.ceil(float(two_digits))
    return (1, int(power) + 1) if digit == 10 else (digit, int(power))


LIBRARY_NAMES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "pandas": "pandas"}
"""The attributes of `Libraries`, as people write them."""

VersionText = Annotated[str, Meta(max_length=100)]


@dataclass(frozen=True, slots=True)
class Libraries:
    """The versions that computed a result; they decide its last digits (section 11).

    Attributes:
        python: of the interpreter.
        numpy: of NumPy.
        scipy: of SciPy.
        pandas: of pandas.
    """

    python: VersionText
    numpy: VersionText
    scipy: VersionText
    pandas: VersionText

    @property
    def words(self) -> str:
        return ", ".join(f"{LIBRARY_NAMES[key]} {version}" for key, version in asdict(self).items())


@cache
def libraries_here() -> Libraries:
    """Return the versions loaded in this process.

    Installed ones may have been upgraded since.
    """
    import numpy as np
    import pandas as pd
    import scipy

    return Libraries(platform.python_version(), np.__version__, scipy.__version__, pd.__version__)
