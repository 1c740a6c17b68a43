"""Door angle -> velocity, acceleration, low-passed acceleration, jerk (sections 5, 6, 8, 9).

Everything is filtered over the whole recording; cut afterwards, so that no filter edge falls
inside a run.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from scoring.errors import ScoringError
from scoring.imports import imports_kept
from scoring.protocol import Thresholds
from scoring.rulesets import JerkRule, LowPassRule, Ruleset, WindowRule

Array = NDArray[np.float64]

_NO_STRETCH = "no stretch of the door angle without gaps is long enough for the filters"


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """The door panel's motion, one row a sample. NaN = undefined.

    Attributes:
        time: strictly increasing times, s, shape (n,).
        position: panel angle as recorded, rad, shape (n,).
        velocity: angular velocity, rad/s, shape (n,).
        acceleration: angular acceleration, rad/s^2, shape (n,).
        reason: why no row of the recording has velocity and acceleration, in words; None if
            some row has.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    reason: str | None = None

    def rows(self, start: float, stop: float) -> slice:
        """The rows that lie in [start, stop]."""
        first = int(np.searchsorted(self.time, start, side="left"))
        return slice(first, max(first, int(np.searchsorted(self.time, stop, side="right"))))

    def cut(self, start: float, stop: float) -> JointState:
        """Only the rows that lie in [start, stop]."""
        rows = self.rows(start, stop)
        return JointState(
            self.time[rows],
            self.position[rows],
            self.velocity[rows],
            self.acceleration[rows],
            self.reason,
        )


def load_filters() -> None:
    """Import SciPy and pandas now, so that the first result does not wait for them.

    Elsewhere they are imported where they are used: they take most of the time that an engine
    needs to be there.
    """
    with imports_kept():
        import_module("scipy.signal")
        import_module("pandas")


def joint_state(
    time: Array, position: Array, ruleset: Ruleset, thresholds: Thresholds
) -> JointState:
    """Velocity and acceleration of the panel: a moving average, then Savitzky-Golay.

    A row without a finite position is no reading and left out, like a message that never came.

    Args:
        time: strictly increasing times of the whole recording, s, shape (n,).
        position: panel angles, rad, shape (n,).
        ruleset: how long the filters are, and whether gaps count.
        thresholds: what a gap is.

    Raises:
        ScoringError: shapes differ, or times do not increase.
    """
    time, position = _readings(time, position)
    velocity, acceleration = np.full(time.size, np.nan), np.full(time.size, np.nan)
    gap = _gap(ruleset, thresholds)
    filters = _filters(time, ruleset, gap)
    if isinstance(filters, str):
        return JointState(time, position, velocity, acceleration, filters)
    for stretch in _stretches(time, np.ones(time.size, dtype=np.bool_), gap):
        inner = slice(stretch.start + filters.edge, stretch.stop - filters.edge)
        if inner.start < inner.stop:
            smooth = filters.moving_average(position[stretch])
            velocity[inner] = filters.derive(smooth, 1)
            acceleration[inner] = filters.derive(smooth, 2)
    reason = None if np.isfinite(acceleration).any() else _NO_STRETCH
    return JointState(time, position, velocity, acceleration, reason)


def low_pass(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> Array:
    """Low-passed acceleration of every row of a whole recording, rad/s^2, shape (n,).

    NaN where undefined; `low_pass_problem` says why, where that is every row.
    """
    filtered = np.full(joint.time.size, np.nan)
    interval = _low_pass_interval(joint, ruleset, thresholds)
    if interval is None or low_pass_problem(joint, ruleset, thresholds) is not None:
        return filtered
    from scipy import signal

    b, a = _butterworth(ruleset, interval)
    with np.errstate(over="ignore", invalid="ignore"):
        if ruleset.low_pass is LowPassRule.ONE_PASS:
            defined = np.isfinite(joint.acceleration)
            filtered[defined] = signal.lfilter(b, a, joint.acceleration[defined])
        else:
            for stretch in _filtered_stretches(joint, ruleset, thresholds):
                filtered[stretch] = signal.filtfilt(b, a, joint.acceleration[stretch])
    return _or_nan(filtered)


def low_pass_problem(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> str | None:
    """Why no row can have a low-passed acceleration, in words; None if some row can."""
    if joint.reason is not None:
        return joint.reason
    interval = _low_pass_interval(joint, ruleset, thresholds)
    if interval is not None and 2 * ruleset.low_pass_frequency * interval >= 1:
        return _too_slow(interval)
    if interval is None or not _filtered_stretches(joint, ruleset, thresholds):
        return "no stretch of acceleration without gaps is long enough for the low-pass filter"
    return None


def jerk(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> tuple[Array, Array]:
    """Jerk of the panel while the door is open.

    A difference quotient belongs to the later one of its two rows.

    Args:
        joint: the panel's motion over the whole recording.
        ruleset: whether rows of a closed door are dropped after or before deriving.
        thresholds: when the door is open, and what a gap is, over which nothing is derived.

    Returns:
        Times, s, and jerk, rad/s^3, both of shape (m,), all finite.
    """
    is_open = np.abs(joint.position) > thresholds.closed_angle
    time, acceleration = joint.time, joint.acceleration
    if ruleset.jerk is JerkRule.SELECT_THEN_DERIVE:
        time, acceleration, is_open = time[is_open], acceleration[is_open], is_open[is_open]
    intervals = np.diff(time)
    with np.errstate(over="ignore", invalid="ignore"):
        quotients = np.diff(acceleration) / intervals
    selected = is_open[1:] & np.isfinite(quotients) & (intervals <= _gap(ruleset, thresholds))
    return time[1:][selected], quotients[selected]


@dataclass(frozen=True, slots=True)
class _Filters:
    """A centred moving average of `average` samples, then Savitzky-Golay of `savgol` samples."""

    average: int
    savgol: int
    order: int
    interval: float

    @property
    def edge(self) -> int:
        """Rows at each end of a stretch at which either window is incomplete."""
        return self.average // 2 + self.savgol // 2

    def moving_average(self, position: Array) -> Array:
        """The averages of complete windows."""
        import pandas as pd

        means = pd.Series(position).rolling(self.average, center=True).mean()
        half = self.average // 2
        return means.to_numpy(dtype=np.float64)[half : position.size - half]

    def derive(self, smooth: Array, derivative: int) -> Array:
        """A derivative of the moving average, of complete windows."""
        from scipy import signal

        values = signal.savgol_filter(
            smooth,
            self.savgol,
            self.order,
            deriv=derivative,
            delta=self.interval,
            mode="constant",  # the edges are dropped: fit nothing there
        )
        half = self.savgol // 2
        return _or_nan(values[half : smooth.size - half])


def _readings(time: Array, position: Array) -> tuple[Array, Array]:
    """The rows with a reading, as float64.

    Raises:
        ScoringError: shapes differ, or times do not increase.
    """
    time, position = np.asarray(time, dtype=np.float64), np.asarray(position, dtype=np.float64)
    if time.ndim != 1 or time.shape != position.shape:
        raise ScoringError(
            f"door angle: {time.shape} times for {position.shape} angles: give one of each a row"
        )
    read = np.isfinite(time) & np.isfinite(position)
    time, position = time[read], position[read]
    if (time[1:] <= time[:-1]).any():
        raise ScoringError("door angle: times do not increase: drop duplicate and backward stamps")
    return time, position


def _gap(ruleset: Ruleset, thresholds: Thresholds) -> float:
    """Intervals above this between samples are gaps, s."""
    return thresholds.largest_gap if ruleset.knows_gaps else math.inf


def _interval(time: Array, largest_gap: float) -> float | None:
    """The mean of all intervals up to `largest_gap`, s; None if there are none."""
    intervals = np.diff(time)
    intervals = intervals[intervals <= largest_gap]
    return float(intervals.mean()) if intervals.size else None


def _filters(time: Array, ruleset: Ruleset, gap: float) -> _Filters | str:
    """The two filters of the door angle, or why they cannot run, in words."""
    if not time.size:
        return "no door angle recorded"
    interval = _interval(time, gap)
    if interval is None and time.size > 1:
        return _too_slow(float(np.diff(time).mean()))
    if interval is None or ruleset.window_time / interval > time.size:
        return "too few door angles recorded for the filters"
    average, savgol = _windows(interval, ruleset)
    if min(average, savgol) < 3:
        return _too_slow(interval)
    return _Filters(average, savgol, ruleset.savgol_order, interval)


def _windows(interval: float, ruleset: Ruleset) -> tuple[int, int]:
    """Samples in the moving average and in the Savitzky-Golay filter."""
    if ruleset.windows is WindowRule.COVERING:
        average = 1 + 2 * math.ceil(ruleset.window_time / interval / 2)
    else:
        rate = math.floor(1 / interval + 0.5)
        # rounded: a product such as 0.2 * 55 must not exceed 11 by its last digit
        least = math.ceil(round(ruleset.window_time * rate - 1, 9))
        average = max(1, least + (least + 1) % 2)
    return average, ruleset.savgol_window or average


def _too_slow(interval: float) -> str:
    return f"door angle at {1 / interval:.2g} Hz: too slow for the filters"


def _stretches(time: Array, defined: NDArray[np.bool_], largest_gap: float) -> list[slice]:
    """Longest runs of defined rows without gaps between them."""
    if not time.size:
        return []
    borders = np.flatnonzero((np.diff(time) > largest_gap) | (defined[1:] != defined[:-1])) + 1
    bounds = [0, *borders.tolist(), time.size]
    runs = (slice(first, end) for first, end in itertools.pairwise(bounds))
    return [run for run in runs if defined[run.start]]


def _low_pass_interval(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> float | None:
    """The sampling interval for the low-pass filter, s."""
    if ruleset.knows_gaps:
        return _interval(joint.time, thresholds.largest_gap)
    return _interval(joint.time[np.isfinite(joint.acceleration)], math.inf)


def _filtered_stretches(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> list[slice]:
    """The stretches of acceleration that are long enough for the low-pass filter."""
    defined = np.isfinite(joint.acceleration)
    stretches = _stretches(joint.time, defined, _gap(ruleset, thresholds))
    if ruleset.low_pass is LowPassRule.ONE_PASS:
        return stretches
    padding = 3 * (ruleset.low_pass_order + 1)  # filtfilt's default
    return [stretch for stretch in stretches if stretch.stop - stretch.start > padding]


def _butterworth(ruleset: Ruleset, interval: float) -> tuple[Array, Array]:
    from scipy import signal

    b, a = signal.iirfilter(
        ruleset.low_pass_order,
        ruleset.low_pass_frequency,
        btype="lowpass",
        ftype="butter",
        fs=1 / interval,
    )
    return b, a


def _or_nan(values: Array) -> Array:
    """Values, with NaN for what left the range of numbers."""
    return np.where(np.isfinite(values), values, np.nan)
