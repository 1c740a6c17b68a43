"""Velocity, acceleration and jerk of the door (protocol sections 5 and 6).

The whole recording is filtered and then cut, so that no filter edge falls inside a run.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from scoring.protocol import Thresholds

Array = NDArray[np.float64]

WINDOW_TIME = 0.2
"""Base of the length of the moving average, s."""

LOW_PASS_FREQUENCY = 2.0
"""Critical frequency of the acceleration's Butterworth filter, Hz."""

_ORDER = 2
_LOW_PASS_ORDER = 5
_GAIN_ERROR = 1e-3  # of the low-pass filter at rest
_PADDING = 3 * (_LOW_PASS_ORDER + 1)  # filtfilt's default


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


def joint_state(time: Array, position: Array, thresholds: Thresholds) -> JointState:
    """Derive velocity and acceleration of the panel: a moving average, then Savitzky-Golay.

    Times must increase, angles be finite; both of shape (n,).
    """
    velocity, acceleration = np.full(time.size, np.nan), np.full(time.size, np.nan)
    interval = mean_interval(time, thresholds.largest_gap)
    reason = _filter_problem(time, interval)
    if interval is None or reason is not None:
        return JointState(time, position, velocity, acceleration, reason)
    window = window_of(interval)
    for stretch in _stretches(time, np.ones(time.size, dtype=np.bool_), thresholds.largest_gap):
        derived = derivatives(position[stretch], interval, window, window)
        velocity[stretch], acceleration[stretch] = derived
    if not np.isfinite(acceleration).any():
        reason = "no stretch of the door angle without gaps is long enough for the filters"
    return JointState(time, position, velocity, acceleration, reason)


def derivatives(position: Array, interval: float, average: int, savgol: int) -> tuple[Array, Array]:
    """Return velocity and acceleration of one stretch of angles, shape (n,) each.

    `interval` is between samples, s; `average` and `savgol` are the lengths of the windows. Rows at
    which a window is incomplete are NaN.
    """
    velocity, acceleration = np.full(position.size, np.nan), np.full(position.size, np.nan)
    half, reach = average // 2, savgol // 2
    inner = slice(half + reach, position.size - half - reach)
    if inner.start >= inner.stop:
        return velocity, acceleration
    import pandas as pd
    from scipy import signal

    means = pd.Series(position).rolling(average, center=True).mean().to_numpy(dtype=np.float64)
    smooth = means[half : position.size - half]
    for derivative, derived in ((1, velocity), (2, acceleration)):
        # constant: the edges are dropped, fit nothing there
        values = signal.savgol_filter(
            smooth, savgol, _ORDER, deriv=derivative, delta=interval, mode="constant"
        )
        derived[inner] = or_nan(values[reach : smooth.size - reach])
    return velocity, acceleration


def low_pass(joint: JointState, thresholds: Thresholds) -> tuple[Array, str | None]:
    """Return the low-passed acceleration, rad/s^2, shape (n,), NaN where undefined.

    Beside it stands why no row has one; None if some row has.
    """
    filtered = np.full(joint.time.size, np.nan)
    interval = mean_interval(joint.time, thresholds.largest_gap)
    if joint.reason is not None or interval is None:
        return filtered, joint.reason
    if 2 * LOW_PASS_FREQUENCY * interval >= 1:
        return filtered, _too_slow(interval)
    if (problem := too_fast(interval)) is not None:
        return filtered, problem
    from scipy import signal

    b, a = butterworth(interval)
    stretches = _stretches(joint.time, np.isfinite(joint.acceleration), thresholds.largest_gap)
    with np.errstate(over="ignore", invalid="ignore"):
        for stretch in stretches:
            if stretch.stop - stretch.start > _PADDING:
                filtered[stretch] = signal.filtfilt(b, a, joint.acceleration[stretch])
    filtered = or_nan(filtered)
    if not np.isfinite(filtered).any():
        return filtered, (
            "no stretch of acceleration without gaps is long enough for the low-pass filter"
        )
    return filtered, None


@lru_cache(maxsize=16)  # uncertainties filter the same run a dozen times
def butterworth(interval: float) -> tuple[Array, Array]:
    """Design the low-pass filter for a sampling interval, s."""
    from scipy import signal

    b, a = signal.iirfilter(
        N=_LOW_PASS_ORDER,
        Wn=LOW_PASS_FREQUENCY,
        btype="lowpass",
        ftype="butter",
        fs=1 / interval,
    )
    return b, a


def too_fast(interval: float) -> str | None:
    """Return why the low-pass filter cannot be computed: its coefficients drown in their digits."""
    b, a = butterworth(interval)
    if abs(b.sum() / a.sum() - 1) < _GAIN_ERROR:
        return None
    return f"door angle at {1 / interval:.0f} Hz: too fast for the low-pass filter"


def jerk(joint: JointState, thresholds: Thresholds) -> tuple[Array, Array]:
    """Times, s, and jerk, rad/s^3, of the open panel, shape (m,), all finite.

    None over a gap.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        quotients: Array = np.diff(joint.acceleration) / np.diff(joint.time)
    is_open = np.abs(joint.position[1:]) > thresholds.closed_angle
    usable = is_open & (np.diff(joint.time) <= thresholds.largest_gap) & np.isfinite(quotients)
    return joint.time[1:][usable], quotients[usable]


def mean_interval(time: Array, largest_gap: float = math.inf) -> float | None:
    """The mean of the intervals that are no gaps, s.

    None without any.
    """
    intervals = np.diff(time)
    intervals = intervals[intervals <= largest_gap]
    return float(intervals.mean()) if intervals.size else None


def window_of(interval: float) -> int:
    """The smallest odd number of samples >= 0.2 s x rate - 1, with the rate in whole Hz."""
    rate = math.floor(1 / interval + 0.5)
    # rounded: a product such as 0.2 * 55 must not exceed 11 by its last digit
    least = math.ceil(round(WINDOW_TIME * rate - 1, 9))
    return max(1, least + (least + 1) % 2)


def or_nan(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def _filter_problem(time: Array, interval: float | None) -> str | None:
    if not time.size:
        return "no door angle recorded"
    if interval is None and time.size > 1:
        return _too_slow(float(np.diff(time).mean()))
    if interval is None or WINDOW_TIME / interval > time.size:
        return "too few door angles recorded for the filters"
    return _too_slow(interval) if window_of(interval) < 3 else None


def _too_slow(interval: float) -> str:
    return f"door angle at {1 / interval:.2g} Hz: too slow for the filters"


def _stretches(time: Array, defined: NDArray[np.bool_], largest_gap: float) -> list[slice]:
    """Longest runs of defined rows without gaps between them."""
    borders = np.flatnonzero((np.diff(time) > largest_gap) | (defined[1:] != defined[:-1])) + 1
    bounds = [0, *borders.tolist(), time.size]
    runs = (slice(first, end) for first, end in itertools.pairwise(bounds))
    return [run for run in runs if run.stop > run.start and defined[run.start]]
