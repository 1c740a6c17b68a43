"""The uncertainty of the values: how far they repeat, 95 of 100 times (section 11).

Times have a closed form. Motion and force are repeated: the same pipeline on copies to which the
noise of the sensor at rest was added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scoring.edges import DecidingEdge
from scoring.indicator_table import IndicatorName as Name
from scoring.indicators import SMOOTHNESS_SCALE
from scoring.kinematics import Array
from scoring.protocol import Signal, Thresholds
from scoring.rest import RestForce
from scoring.result import Uncertainty
from scoring.rows import process_rows
from scoring.series import Series, Signals

_REPETITIONS = 12
_BROAD = 4.0
"""Standard deviations of the repetitions: 2 miss what the recorded noise has done already."""

_LONGEST = 0.5
"""A panel that takes longer for its zero or half a count stands still, s."""

_PARTS = (0.0, 0.25, 0.5, 0.75)
"""Where a sudden stop may lie between two samples."""

_PLATEAU = 6.0
"""Forces less than so many standard deviations below the largest are as large."""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A run as recorded; times in s since the epoch.

    Attributes:
        rows_end: of the motion and the force that count.
        by_hand: how late the start may be, s; 0 where the robot answered.
        completed: whether the last step ended the run.
        signals: door and handle without what is no reading.
        edges: those that decide.
    """

    start: float
    rows_end: float
    by_hand: float
    completed: bool
    signals: Signals
    edges: Sequence[DecidingEdge]
    rest: RestForce
    thresholds: Thresholds

    @property
    def door(self) -> Series:
        return self.signals[Signal.DOOR]

    def in_run(self, signal: Signal) -> Series:
        """The samples of a signal from the start to `rows_end`."""
        series = self.signals[signal]
        return series.where((series.time >= self.start) & (series.time <= self.rows_end))

    @property
    def door_steps(self) -> Array:
        """The sizes of the steps of the door angle, rad, ascending, shape (n,)."""
        steps = np.abs(np.diff(self.door.value))
        return np.sort(steps[steps > 1e-9])

    @property
    def count(self) -> float:
        """The smallest step of the door angle but for two, at most one of the encoder, rad."""
        steps = self.door_steps
        usual = self.thresholds.encoder_count
        return min(float(steps[2]), usual) if steps.size > 10 else usual

    def at_rest(self, signal: Signal) -> tuple[float, float]:
        """Mean and standard deviation in the last second before the start."""
        series = self.signals[signal]
        rest = series.value[(series.time >= self.start - 1.0) & (series.time < self.start)]
        return (float(rest.mean()), float(rest.std())) if rest.size else (0.0, 0.0)

    def motion(self, time: Array, angle: Array) -> tuple[float, float]:
        """Unsafety and smoothness of these angles, rad, shape (n,).

        NaN = none.
        """
        nothing = np.zeros(0)
        rows = process_rows(time, angle, nothing, nothing, self.thresholds)
        rows = rows.cut(self.start, self.rows_end)
        accelerations = np.abs(rows.low_passed[np.isfinite(rows.low_passed)])
        mean = float(np.abs(rows.jerk).mean()) if rows.jerk.size else 0.0
        unsafety = float(accelerations.max()) if accelerations.size else math.nan
        return unsafety, SMOOTHNESS_SCALE / mean if mean else math.nan


def uncertainties(run: Recorded) -> dict[Name, Uncertainty | None]:
    """Return the uncertainty of each indicator, or None where it is not known.

    The level is exact.
    """
    late = [(edge, _lateness(run, edge)) for edge in run.edges]
    sizes: dict[Name, float] = {Name.CAPABILITY_LEVEL: 0.0}
    for name in (Name.DOOR_OCCUPATION_TIME, Name.PASSAGE_TIME):
        sizes[name] = max((size for e, size in late if name in e.kind.indicators), default=0.0)
    for name in (Name.EXECUTION_TIME, Name.TIME_TO_HANDLE):
        ends = run.completed or name is Name.TIME_TO_HANDLE  # else the clock ended the run
        of_name = [size for e, size in late if ends and name in e.kind.indicators]
        sizes[name] = math.hypot(max(of_name, default=0.0), run.by_hand)
    sizes[Name.UNSAFETY_OF_DOOR_OPERATION], sizes[Name.SMOOTHNESS_OF_DOOR_ACTUATION] = _motion(run)
    sizes[Name.ROUGHNESS_OF_DOOR_ACTUATION] = _force(run)
    known: dict[Name, Uncertainty | None] = dict.fromkeys(Name)
    for name, size in sizes.items():
        if math.isfinite(size):
            rest = run.rest.largest if name is Name.ROUGHNESS_OF_DOOR_ACTUATION else 0.0
            known[name] = Uncertainty(*map(_two_digits, (size / 2, size, rest)))
    return known


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


def _lateness(run: Recorded, edge: DecidingEdge) -> float:
    """Return by how much an edge may be late, s.

    That is the interval before its reading; of the door also what its zero and half a count take at
    the panel's speed.
    """
    series = run.signals[edge.signal]
    at = int(np.searchsorted(series.time, edge.time))
    if not 0 < at < series.time.size:
        return 0.0
    late = float(series.time[at] - series.time[at - 1])
    if edge.signal is Signal.LATCH:  # one that speaks when it changes is no slow one
        return min(late, 1 / run.thresholds.rate)
    if edge.signal is not Signal.DOOR:
        return late
    low, high = max(0, at - 3), min(series.time.size - 1, at + 2)
    speed = abs(series.value[high] - series.value[low]) / (series.time[high] - series.time[low])
    off = abs(run.at_rest(Signal.DOOR)[0]) + run.count / 2
    return late + min(_LONGEST, float(off / speed) if speed else _LONGEST)


def _motion(run: Recorded) -> tuple[float, float]:
    """Repeat the pipeline with more of the noise, and as if a sudden stop lay elsewhere."""
    time, angle = run.door.time, run.door.value
    value = run.motion(time, angle)
    if not any(map(math.isfinite, value)):
        return math.nan, math.nan
    noise = math.hypot(run.at_rest(Signal.DOOR)[1], run.count / math.sqrt(12))
    random = np.random.RandomState(0)  # its stream is frozen, unlike a Generator's
    copies = [angle + noise * random.standard_normal(angle.size) for _ in range(_REPETITIONS)]
    repeated = np.array([run.motion(time, copy) for copy in copies])
    unsafety, smoothness = _BROAD * repeated.std(axis=0, ddof=1)
    moved = []
    for part in _PARTS:
        between = time[:-1] + part * np.diff(time), angle[:-1] + part * np.diff(angle)
        moved.append(run.motion(*between)[0])
    # more noise is more jerk: in proportion, the spread is that of the value
    share = value[1] / repeated[:, 1].mean()
    return math.hypot(unsafety, max(moved) - min(moved)), float(smoothness * share)


def _force(run: Recorded) -> float:
    """Return twice the noise, with what the samples about a lone peak leave open."""
    size = np.abs(run.in_run(Signal.HANDLE).value)
    if not size.size:
        return math.nan
    noise = run.at_rest(Signal.HANDLE)[1]
    top = int(np.argmax(size))
    stands_alone = (size > size[top] - _PLATEAU * noise).sum() < 3
    fall = size[top] - size[max(0, top - 1) : top + 2].min()
    return math.hypot(2 * noise, float(fall) / 4 if stands_alone else 0.0)
