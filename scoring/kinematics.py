"""Velocity, acceleration and jerk of the door.

The whole recording is filtered and then cut, so that no filter edge falls inside a run.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoring.protocol import ScoringError, Thresholds
from scoring.rulesets import JerkRule, LowPassRule, Ruleset, WindowRule

Array = NDArray[np.float64]

_RESPONSE = 3.0
"""The low-pass filter has forgotten a pulse after this many periods of its frequency."""

_STRAY = 3.0
"""The mean interval strays by this many of its standard deviations."""

_NO_STRETCH = "no stretch of the door angle without gaps is long enough for the filters"


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """The panel's motion, one row a sample, s, rad, rad/s and rad/s^2, shape (n,). NaN = undefined.

    `reason` says why no row has velocity and acceleration; None if some row has.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    reason: str | None = None

    def rows(self, start: float, stop: float) -> slice:
        first = int(np.searchsorted(self.time, start, side="left"))
        return slice(first, max(first, int(np.searchsorted(self.time, stop, side="right"))))

    def cut(self, start: float, stop: float) -> JointState:
        rows = self.rows(start, stop)
        return JointState(
            self.time[rows],
            self.position[rows],
            self.velocity[rows],
            self.acceleration[rows],
            self.reason,
        )


def load_filters() -> None:
    """Import SciPy and pandas now, so that the first result does not wait for them."""
    import_module("scipy.signal")
    import_module("pandas")


def joint_state(
    time: Array, position: Array, ruleset: Ruleset, thresholds: Thresholds
) -> JointState:
    """Velocity and acceleration of the panel: a moving average, then Savitzky-Golay.

    A row without a finite position is left out, like a message that never came. `ScoringError` if
    times do not increase.
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
    """Low-passed acceleration of a whole recording, rad/s^2, shape (n,), NaN where undefined."""
    filtered = np.full(joint.time.size, np.nan)
    interval = _low_pass_interval(joint, ruleset, thresholds)
    if interval is None or low_pass_problem(joint, ruleset, thresholds) is not None:
        return filtered
    from scipy import signal

    with np.errstate(over="ignore", invalid="ignore"):
        match ruleset.low_pass:
            case LowPassRule.ONE_PASS:
                b, a = _butterworth(ruleset, interval)
                defined = np.isfinite(joint.acceleration)
                filtered[defined] = signal.lfilter(b, a, joint.acceleration[defined])
            case LowPassRule.ZERO_PHASE:
                b, a = _butterworth(ruleset, interval)
                for stretch in _filtered_stretches(joint, ruleset, thresholds):
                    filtered[stretch] = signal.filtfilt(b, a, joint.acceleration[stretch])
    return or_nan(filtered)


def low_pass_problem(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> str | None:
    """Why no row can have a low-passed acceleration; None if some row can."""
    if joint.reason is not None:
        return joint.reason
    interval = _low_pass_interval(joint, ruleset, thresholds)
    if interval is not None and 2 * ruleset.low_pass_frequency * interval >= 1:
        return _too_slow(interval)
    if interval is None or not _filtered_stretches(joint, ruleset, thresholds):
        return "no stretch of acceleration without gaps is long enough for the low-pass filter"
    return None


def jerk(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> tuple[Array, Array]:
    """Times, s, and jerk, rad/s^3, of the open panel, shape (m,), all finite; none over a gap."""
    before, after = jerk_rows(joint, ruleset, thresholds)
    return joint.time[after], _quotients(joint, before, after)


def jerk_rows(
    joint: JointState, ruleset: Ruleset, thresholds: Thresholds
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The earlier and the later row of each difference quotient, which belongs to the later one."""
    is_open = np.abs(joint.position) > thresholds.closed_angle
    rows = np.arange(joint.time.size)
    if ruleset.jerk is JerkRule.SELECT_THEN_DERIVE:
        rows = rows[is_open]
    before, after = rows[:-1], rows[1:]
    near = joint.time[after] - joint.time[before] <= _gap(ruleset, thresholds)
    defined = np.isfinite(_quotients(joint, before, after))
    usable = is_open[after] & near & defined
    return before[usable], after[usable]


def _quotients(joint: JointState, before: NDArray[np.intp], after: NDArray[np.intp]) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        changes = joint.acceleration[after] - joint.acceleration[before]
        quotients: Array = changes / (joint.time[after] - joint.time[before])
    return quotients


def smoothed(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> JointState:
    """The motion of a panel without the steps of its encoder: of its moving average."""
    filters = _filters(joint.time, ruleset, _gap(ruleset, thresholds))
    if isinstance(filters, str):
        return joint
    position = joint.position.copy()
    half = filters.average // 2
    every = np.ones(joint.time.size, dtype=np.bool_)
    for stretch in _stretches(joint.time, every, _gap(ruleset, thresholds)):
        if stretch.stop - stretch.start > 2 * half:
            inner = slice(stretch.start + half, stretch.stop - half)
            average = filters.moving_average(joint.position[stretch])
            position[inner] = np.where(np.isfinite(average), average, position[inner])
    return joint_state(joint.time, position, ruleset, thresholds)


def noise_kernel(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> Array | None:
    """Weights that noise of the door angle has in the acceleration, an odd number, 1/s^2.

    Moving average and Savitzky-Golay as one convolution; None where the filters cannot run.
    """
    filters = _filters(joint.time, ruleset, _gap(ruleset, thresholds))
    if isinstance(filters, str):
        return None
    from scipy import signal

    average = np.full(filters.average, 1 / filters.average)
    derive = signal.savgol_coeffs(filters.savgol, filters.order, deriv=2, delta=filters.interval)
    kernel: Array = np.convolve(average, derive)
    return kernel


def low_pass_response(
    joint: JointState, ruleset: Ruleset, thresholds: Thresholds, kernel: Array
) -> Array:
    """As `noise_kernel`, of the low-passed acceleration; one weight where there is none."""
    interval = _low_pass_interval(joint, ruleset, thresholds)
    if interval is None or low_pass_problem(joint, ruleset, thresholds) is not None:
        return np.zeros(1)
    from scipy import signal

    half = kernel.size // 2 + math.ceil(_RESPONSE / ruleset.low_pass_frequency / interval)
    pulse = np.zeros(2 * half + 1)
    pulse[half - kernel.size // 2 : half + kernel.size // 2 + 1] = kernel
    sections = signal.iirfilter(**_low_pass_design(ruleset, interval), output="sos")
    response: Array = signal.sosfilt(sections, pulse)
    if ruleset.low_pass is not LowPassRule.ONE_PASS:
        response = signal.sosfilt(sections, response[::-1])[::-1]
    return response


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
        import pandas as pd

        means = pd.Series(position).rolling(self.average, center=True).mean()
        half = self.average // 2
        return means.to_numpy(dtype=np.float64)[half : position.size - half]

    def derive(self, smooth: Array, derivative: int) -> Array:
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
        return or_nan(values[half : smooth.size - half])


def _readings(time: Array, position: Array) -> tuple[Array, Array]:
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
    return thresholds.largest_gap if ruleset.knows_gaps else math.inf


def _interval(time: Array, largest_gap: float) -> float | None:
    intervals = np.diff(time)
    intervals = intervals[intervals <= largest_gap]
    return float(intervals.mean()) if intervals.size else None


def _filters(time: Array, ruleset: Ruleset, gap: float) -> _Filters | str:
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
    if ruleset.windows is WindowRule.COVERING:
        average = 1 + 2 * math.ceil(ruleset.window_time / interval / 2)
    else:
        rate = math.floor(1 / interval + 0.5)
        # rounded: a product such as 0.2 * 55 must not exceed 11 by its last digit
        least = math.ceil(round(ruleset.window_time * rate - 1, 9))
        average = max(1, least + (least + 1) % 2)
    return average, ruleset.savgol_window or average


def other_windows(time: Array, ruleset: Ruleset) -> Ruleset | None:
    """The rules with the other length of the moving average, where chance decides on it.

    `COVERING` windows jump where the mean interval divides the window's time evenly, as 0.02 s
    does; the jitter of the first and the last stamp then decides.
    """
    if ruleset.windows is not WindowRule.COVERING or time.size < 3:
        return None
    intervals = np.diff(time)
    halves = ruleset.window_time / float(intervals.mean()) / 2
    stray = _STRAY * float(intervals.std()) / (time[-1] - time[0])
    if abs(halves - round(halves)) > stray * halves:
        return None
    nudge = 1 + 2 * stray if math.ceil(halves) == round(halves) else 1 - 2 * stray
    return replace(ruleset, window_time=ruleset.window_time * nudge)


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
    if ruleset.knows_gaps:
        return _interval(joint.time, thresholds.largest_gap)
    return _interval(joint.time[np.isfinite(joint.acceleration)], math.inf)


def _filtered_stretches(joint: JointState, ruleset: Ruleset, thresholds: Thresholds) -> list[slice]:
    defined = np.isfinite(joint.acceleration)
    stretches = _stretches(joint.time, defined, _gap(ruleset, thresholds))
    if ruleset.low_pass is LowPassRule.ONE_PASS:
        return stretches
    padding = 3 * (ruleset.low_pass_order + 1)  # filtfilt's default
    return [stretch for stretch in stretches if stretch.stop - stretch.start > padding]


def _butterworth(ruleset: Ruleset, interval: float) -> tuple[Array, Array]:
    from scipy import signal

    b, a = signal.iirfilter(**_low_pass_design(ruleset, interval))
    return b, a


def _low_pass_design(ruleset: Ruleset, interval: float) -> dict[str, Any]:
    return {
        "N": ruleset.low_pass_order,
        "Wn": ruleset.low_pass_frequency,
        "btype": "lowpass",
        "ftype": "butter",
        "fs": 1 / interval,
    }


def or_nan(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)
