"""A run from arrays to its result, for those who have samples and no console."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
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
        return cls(**vars(result), rows=rows, condition=condition)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Result) and all(
            getattr(self, each.name) == getattr(other, each.name) for each in fields(Result)
        )

    __hash__ = Result.__hash__

    def figures(self) -> dict[str, Figure]:
        """Draw the figures of the protocol document (section 6), by name.

        Needs matplotlib.
        """
        from scoring.figures import figures_of

        drawn = figures_of(self, self.rows, self.condition)
        return {name.value: figure for name, figure in drawn.items()}


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
    thresholds = Thresholds() if thresholds is None else thresholds
    for name, number, unit in (
        ("start", start, "s"),
        ("timeout", timeout, "s"),
        ("handle_zero", handle_zero, "N"),
    ):
        if not isinstance(number, Real) or not abs(number) <= sys.float_info.max:
            raise ScoringError(f"{name} {number!r}: give a finite number, {unit}")
    if timeout <= 0:
        raise ScoringError(f"timeout {timeout!r}: give more than 0 s")
    for name, value, kind in (
        ("condition", condition, Condition),
        ("passage", passage, Mapping),
        ("thresholds", thresholds, Thresholds),
    ):
        if not isinstance(value, kind):
            raise ScoringError(f"{name}: give a {kind.__name__}, not {type(value).__name__}")
    _demand_limits(thresholds)

    samples = _samples(door, handle, passage, latch)
    samples.sort(key=lambda sample: sample.time)
    assessment = Assessment(
        condition,
        float(start),
        ruleset=ruleset_called(ruleset),
        thresholds=thresholds,
        handle_zero=float(handle_zero),
    )
    ending = _follow(assessment, samples, float(timeout))
    return Evaluation.of(*assessment.result(ending), condition)


def _demand_limits(thresholds: Thresholds) -> None:
    usual = Thresholds().numbers
    for each in fields(Thresholds):
        low, high, _ = each.metadata.get(LIMITS, (0, math.inf, ""))
        given = getattr(thresholds, each.name)
        count = np.size(usual[each.name])
        numbers = np.ravel(given)
        is_usable = numbers.dtype.kind in "iuf" and numbers.size == count
        if not is_usable or not ((low <= numbers) & (numbers <= high)).all():
            wanted = "a number" if count == 1 else f"{count} numbers"
            raise ScoringError(
                f"thresholds: {each.name} {given!r}: give {wanted} from {low:g} to {high:g}"
            )


def _samples(
    door: object, handle: object, passage: Mapping[str, Any], latch: object
) -> list[Sample]:
    """Return all samples.

    They were received when they were measured.
    """
    times, angles = _columns("door", door, 1)
    samples: list[Sample] = [*map(DoorSample, times, times, angles[:, 0].tolist())]
    times, forces = _columns("handle", handle, 1)
    samples += map(HandleSample, times, times, forces[:, 0].tolist())
    for name, data in passage.items():
        if name not in [*Strip]:
            raise ScoringError(f"passage: there is no strip {name!r}: name {', '.join(Strip)}")
        times, ranges = _columns(f"passage[{name!r}]", data, SENSORS_PER_STRIP)
        for time, row in zip(times, ranges.tolist(), strict=True):
            samples.append(PassageSample(time, time, Strip(name), tuple(row), 0.0, math.inf))
    if latch is not None:
        times, states = _columns("latch", latch, 1)
        if np.isnan(states).any():
            raise ScoringError("latch: a state is nan: leave that sample out")
        samples += map(LatchSample, times, times, (states[:, 0] >= _ENGAGED).tolist())
    return samples


def _columns(name: str, data: Any, width: int) -> tuple[list[float], Array]:  # noqa: ANN401
    """Return n times and their values, shape (n, `width`)."""
    wanted = "a value" if width == 1 else f"{width} ranges"
    try:
        if hasattr(data, "columns") and hasattr(data, "iloc"):
            data = data.iloc[:, 0], data.iloc[:, 1:]
        times, values = map(_numbers, data)
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
        raise ScoringError(f"{name}: a time is no finite number: leave that sample out")
    return times.tolist(), values.reshape(-1, width)


def _numbers(part: object) -> Array:
    """Return numbers as an array.

    One that is masked is NaN.
    """
    numbers: np.ma.MaskedArray[Any, Any] = np.ma.asarray(part)
    if not numbers.ndim or numbers.dtype.kind in "mMc":  # no row, or dates, whose unit is not s
        raise TypeError
    return np.ma.filled(numbers.astype(np.float64), np.nan)


def _follow(assessment: Assessment, samples: Sequence[Sample], timeout: float) -> Ending:
    """Feed all samples, and stop at the first instant at which all steps are done."""
    procedure = assessment.procedure()
    changes = assessment.changes
    stop = None
    for sample in samples:
        assessment.feed(sample)
        assessment.release(math.inf)  # they are in order
        if stop is None and (procedure.settling or assessment.changes != changes):
            changes = assessment.changes
            procedure = assessment.procedure()
            stop = procedure.completed

    limit = assessment.start + timeout
    if stop is not None and stop <= limit:
        return Ending(Outcome.COMPLETED, "all six steps done", stop)
    newest = samples[-1].time
    if newest >= limit:
        return Ending(Outcome.TIMEOUT, f"{timeout:g} s elapsed", limit)
    after = f"{newest - assessment.start:.1f} s after the start"
    reason = f"the samples end {after}, before the timeout of {timeout:g} s"
    return Ending(Outcome.INTERRUPTED, reason, None)
