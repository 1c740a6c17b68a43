"""A run from arrays to its result, for those who have samples and no console."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from heapq import merge
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from scoring.assessment import Assessment
from scoring.indicator_table import RulesetName
from scoring.indicator_table import ruleset as ruleset_called
from scoring.kinematics import Array
from scoring.protocol import (
    LIMITS,
    SENSORS_PER_STRIP,
    Condition,
    Outcome,
    ScoringError,
    Strip,
    Thresholds,
)
from scoring.result import Ending, Result
from scoring.rows import Rows
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ENGAGED = 0.5
"""A latch sensor that sends numbers is engaged from here on."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation(Result):
    """A result with the data behind it, which do not count where results are compared.

    Attributes:
        condition: what the robot had to do.
        rows: the pre-processed data, cut to the run.
    """

    condition: Condition
    rows: Rows

    @classmethod
    def of(cls, result: Result, rows: Rows, condition: Condition) -> Self:
        parts = {each.name: getattr(result, each.name) for each in fields(Result)}
        return cls(**parts, rows=rows, condition=condition)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Result) and all(
            getattr(self, each.name) == getattr(other, each.name) for each in fields(Result)
        )

    __hash__ = Result.__hash__

    def figures(self) -> dict[str, Figure]:
        """The figures of the protocol document (section 6), by name; needs matplotlib."""
        from scoring.figures import figures_of

        figures = figures_of(self, self.rows, self.condition)
        return {name.value: figure for name, figure in figures.items()}


def evaluate(  # noqa: PLR0913  a signal is an argument
    condition: Condition,
    start: float,
    *,
    door: Any,  # noqa: ANN401  whatever becomes an array
    handle: Any,  # noqa: ANN401
    passage: Mapping[str, Any],
    latch: Any = None,  # noqa: ANN401
    timeout: float = 300.0,
    ruleset: RulesetName = RulesetName.PROTOCOL,
    handle_zero: float = 0.0,
    thresholds: Thresholds | None = None,
) -> Evaluation:
    """Score a run from its samples, which may come in any order.

    A signal is a pair of arrays, or a DataFrame whose first column is the time. All times are in s
    on one clock. The run stops when all steps are done, else at the timeout (section 2). Give what
    was measured until 1 s after the stop: filters and the last step need it.

    Args:
        condition: what the robot had to do.
        start: of the run.
        door: times; angles, rad, 0 = closed, positive = CCW.
        handle: times; forces, N, positive = pushes the panel towards CCW.
        passage: for each strip, `cw_left` to `ccw_right`, times; four ranges a row, m down from the
            lintel, inf = nothing there. NaN is no reading, here as elsewhere.
        latch: times; whether the latch is engaged. None = there is no latch sensor.
        timeout: of the run, s.
        ruleset: the rules of the indicators.
        handle_zero: force of the handle at rest, N.
        thresholds: the testbed's numbers; None = the protocol's.

    Raises:
        ScoringError: an argument cannot be used; names it and the remedy.
    """
    for name, value, unit in (
        ("start", start, "s"),
        ("timeout", timeout, "s"),
        ("handle_zero", handle_zero, "N"),
    ):
        if not _is_finite(value):
            raise ScoringError(f"{name} {value!r}: give a finite number, {unit}")
    if timeout <= 0:
        raise ScoringError(f"timeout {timeout!r}: give more than 0 s")
    thresholds = Thresholds() if thresholds is None else thresholds
    for argument, kind in ((condition, Condition), (passage, Mapping), (thresholds, Thresholds)):
        if not isinstance(argument, kind):
            name = kind.__name__.replace("Mapping", "passage").lower()
            raise ScoringError(f"{name}: give a {kind.__name__}, not {type(argument).__name__}")
    _demand_limits(thresholds)
    streams = [_door(door), _handle(handle)]
    streams += [_strip(name, data) for name, data in passage.items()]
    if latch is not None:
        streams.append(_latch(latch))
    assessment = Assessment(
        condition,
        float(start),
        ruleset=ruleset_called(ruleset),
        thresholds=thresholds,
        handle_zero=float(handle_zero),
    )
    ending = _follow(assessment, merge(*streams, key=lambda sample: sample.time), float(timeout))
    return Evaluation.of(*assessment.result(ending), condition)


def _follow(assessment: Assessment, samples: Iterator[Sample], timeout: float) -> Ending:
    """Feed all samples, and stop at the first instant at which all steps are done."""
    limit, changes, stop = assessment.start + timeout, -1, None
    procedure = assessment.procedure()
    for sample in samples:
        assessment.feed(sample)
        assessment.release(math.inf)  # they are in order
        if stop is None and (procedure.settling or assessment.changes != changes):
            changes, procedure = assessment.changes, assessment.procedure()
            stop = procedure.completed
    if stop is not None and stop <= limit:
        return Ending(Outcome.COMPLETED, "all six steps done", stop)
    newest = assessment.newest or 0.0
    if newest >= limit:
        return Ending(Outcome.TIMEOUT, f"{timeout:g} s elapsed", limit)
    after = newest - assessment.start
    reason = f"the samples end {after:.1f} s after the start, before the timeout of {timeout:g} s"
    return Ending(Outcome.INTERRUPTED, reason, None)


def _door(data: object) -> Iterator[Sample]:
    times, angles = _columns("door", data, 1)
    return map(DoorSample, times.tolist(), times.tolist(), angles[:, 0].tolist())


def _handle(data: object) -> Iterator[Sample]:
    times, forces = _columns("handle", data, 1)
    return map(HandleSample, times.tolist(), times.tolist(), forces[:, 0].tolist())


def _latch(data: object) -> Iterator[Sample]:
    times, states = _columns("latch", data, 1)
    if np.isnan(states).any():
        raise ScoringError("latch: a state is nan: leave that sample out")
    engaged = (states[:, 0] >= _ENGAGED).tolist()
    return map(LatchSample, times.tolist(), times.tolist(), engaged)


def _strip(name: str, data: object) -> Iterator[Sample]:
    if name not in [*Strip]:
        raise ScoringError(f"passage: there is no strip {name!r}: name {', '.join(Strip)}")
    times, ranges = _columns(f"passage[{name!r}]", data, SENSORS_PER_STRIP)
    strip = Strip(name)
    rows = zip(times.tolist(), ranges.tolist(), strict=True)
    return (PassageSample(time, time, strip, tuple(row), 0.0, math.inf) for time, row in rows)


def _columns(name: str, data: Any, width: int) -> tuple[Array, Array]:  # noqa: ANN401
    """Times of shape (n,) in order, values of shape (n, `width`)."""
    wanted = "a value" if width == 1 else f"{width} ranges"
    try:
        if hasattr(data, "columns") and hasattr(data, "iloc"):
            data = data.iloc[:, 0], data.iloc[:, 1:]
        times, values = (_numbers(part) for part in data)
    except (TypeError, ValueError, IndexError, OverflowError):
        raise ScoringError(f"{name}: give times in s, and {wanted} for each, as numbers") from None
    if not times.size:
        raise ScoringError(f"{name}: no samples: give those of the whole run")
    if times.shape != values.shape[:1] or values.size != width * times.size:
        shape = " x ".join(map(str, values.shape))
        raise ScoringError(
            f"{name}: {times.size} times, but {shape} values: give {wanted} for each"
        )
    if not np.isfinite(times).all():
        row = np.flatnonzero(~np.isfinite(times))[0]
        raise ScoringError(f"{name}: time [{row}] is {times[row]}: leave that sample out")
    order = np.argsort(times, kind="stable")
    return times[order], values.reshape(-1, width)[order]


def _numbers(part: object) -> Array:
    numbers = np.asanyarray(part)
    if not numbers.ndim or numbers.dtype.kind in "mMc":  # no row, or dates, whose unit is not s
        raise TypeError
    floats = numbers.astype(np.float64)
    return floats.filled(np.nan) if isinstance(floats, np.ma.MaskedArray) else np.asarray(floats)


def _is_finite(value: object) -> bool:
    try:
        is_real = isinstance(value, (int, float, np.integer, np.floating))
        return is_real and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:  # an integer of any length
        return False


def _demand_limits(thresholds: Thresholds) -> None:
    for each in fields(thresholds):
        given, usual = getattr(thresholds, each.name), getattr(Thresholds(), each.name)
        is_row = isinstance(usual, tuple)
        many = len(usual) if is_row else 1
        numbers = given if is_row and isinstance(given, tuple) else (given,)
        low, high, _ = each.metadata.get(LIMITS, (0, math.inf, ""))
        in_limits = all(_is_finite(number) and low <= number <= high for number in numbers)
        if len(numbers) != many or not in_limits:
            wanted = f"{many} numbers" if is_row else "a number"
            raise ScoringError(
                f"thresholds: {each.name} {given!r}: give {wanted} from {low:g} to {high:g}"
            )
