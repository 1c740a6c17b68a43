"""The signals of a recording as arrays, and what the passage sensors saw in them."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.kinematics import Array
from scoring.protocol import (
    PASSAGE_SENSORS,
    SENSORS_PER_STRIP,
    PassageSensor,
    Signal,
    Strip,
    Thresholds,
)
from scoring.quality import SignalQuality
from scoring.rows import Rows
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from scoring.stamps import StampGuard

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A signal as recorded, in the order of its stamps.

    Attributes:
        time: stamps, s since the epoch, increasing, shape (n,).
        log: when each was received, s since the epoch.
        value: rad, N or 0 and 1, shape (n,); of a strip m down from the lintel, shape (n, 4),
            inf = nothing there. NaN = no reading.
        sequence: the publisher's count of its messages; 0 = unknown.
    """

    time: Array
    log: Array
    value: Array
    sequence: Array

    def where(self, rows: Flags) -> Series:
        return Series(self.time[rows], self.log[rows], self.value[rows], self.sequence[rows])

    def within(self, largest: float) -> Series:
        """The samples whose value is a reading, at most `largest` to either side."""
        return self.where(np.abs(self.value) <= largest)


Signals = Mapping[Signal, Series]
"""One of each signal; empty ones where nothing was recorded."""


def signals_of(samples: Iterable[Sample]) -> Signals:
    """Return the samples of a recording whose stamps can be used, by signal."""
    guards = {signal: StampGuard() for signal in Signal}
    logs = {signal: SignalLog() for signal in Signal}
    for sample in samples:
        admitted = guards[sample.signal].admit(sample)
        if admitted is not None:
            logs[sample.signal].add(admitted)
    return {signal: log.series(signal) for signal, log in logs.items()}


class SignalLog:
    """The samples of one signal, in plain arrays: a run has tens of thousands of them."""

    def __init__(self) -> None:
        self.time = array("d")
        self.value = array("d")
        self._log = array("d")
        self._sequence = array("d")

    def add(self, sample: Sample) -> None:
        self.time.append(sample.time)
        self._log.append(sample.log_time)
        self._sequence.append(sample.sequence)
        match sample:
            case DoorSample():
                self.value.append(sample.angle)
            case HandleSample():
                self.value.append(sample.force)
            case LatchSample():
                self.value.append(sample.engaged)
            case PassageSample():
                self.value.extend(_ranges(sample))

    def series(self, signal: Signal) -> Series:
        value = np.array(self.value)
        if signal in _STRIPS:
            value = value.reshape(-1, SENSORS_PER_STRIP)
        return Series(np.array(self.time), np.array(self._log), value, np.array(self._sequence))


_STRIPS = {Signal.of_strip(strip) for strip in Strip}


def _ranges(sample: PassageSample) -> tuple[float, ...]:
    """Four ranges of which those that are no reading are NaN (REP-117)."""
    low, high = sample.range_min, sample.range_max
    if len(sample.ranges) == SENSORS_PER_STRIP and all(low <= one <= high for one in sample.ranges):
        return sample.ranges
    ranges = [np.nan] * SENSORS_PER_STRIP
    for element, distance in enumerate(sample.ranges[:SENSORS_PER_STRIP]):
        if low <= distance <= high or abs(distance) == np.inf:
            ranges[element] = distance
    return tuple(ranges)


def signal_quality(
    signal: Signal,
    series: Series,
    guard: StampGuard,
    recorded: tuple[float, float],
    thresholds: Thresholds,
) -> SignalQuality:
    """The quality of a signal in a recording of these log times, s since the epoch."""
    intervals = np.diff(series.time)
    regular = intervals[intervals <= thresholds.largest_gap]
    begin, end = recorded
    late, early = 0.0, 0.0
    if series.log.size:
        late, early = float(series.log[0] - begin), float(end - series.log[-1])
    skew = float(np.abs(series.time - series.log).max()) if series.time.size else None
    no_reading, impossible = _missing_readings(signal, series, thresholds)
    return SignalQuality(
        signal=signal,
        samples=series.time.size,
        rate=float(1 / regular.mean()) if regular.size else None,
        largest_gap=float(intervals.max()) if intervals.size else None,
        gaps=intervals.size - regular.size,
        jitter=float(regular.std()) if regular.size > 1 else None,
        dropped=guard.dropped,
        shifted=guard.shifted,
        no_reading=no_reading,
        skew=skew,
        skewed=skew is not None and skew >= thresholds.largest_skew,
        clock_steps=len(guard.steps),
        begins_late=late if late > thresholds.largest_gap else 0.0,
        ends_early=early if early > thresholds.largest_gap else 0.0,
        impossible=impossible,
    )


def _missing_readings(signal: Signal, series: Series, thresholds: Thresholds) -> tuple[int, int]:
    """Count the values, of the used ranges, that are no reading, and the impossible ones."""
    value = series.value
    if signal in (Signal.DOOR, Signal.HANDLE):
        limits = {
            Signal.DOOR: thresholds.largest_angle,
            Signal.HANDLE: thresholds.impossible_force,
        }
        missing = ~(np.abs(value) <= limits[signal])
        return int(missing.sum()), int((missing & np.isfinite(value)).sum())
    if signal.optional or not value.size:
        return 0, 0
    used = [s.element for s in PASSAGE_SENSORS if Signal.of_strip(s.strip) is signal]
    ranges = value[:, used]
    # what lies too close to a sensor is a reading, but none of a robot
    return int((np.isnan(ranges) | (ranges == -np.inf)).sum()), 0


def last_angles(door: Series, time: Array) -> Array:
    """The last door angle at each time, rad, shape (n,).

    Before the first one it is closed.
    """
    places = np.searchsorted(door.time, time, side="right")
    angles: Array = np.concatenate(([0.0], door.value))[places]
    return angles


def is_masked(sensor: PassageSensor, angle: Array, thresholds: Thresholds) -> Flags:
    """Return where the panel, at `angle` rad, passes under a sensor."""
    low, high = thresholds.mask(sensor.side, sensor.index)
    turned = angle * sensor.side.sign
    return (low < turned) & (turned < high)


@dataclass(frozen=True, slots=True, eq=False)
class PassageSeries:
    """What the used passage sensors saw, one row per sensor and sample, as recorded (section 4).

    Attributes:
        time: s since the epoch, increasing for each sensor; all arrays have shape (n,).
        sensor: index in `PASSAGE_SENSORS`.
        distance: down from the lintel, m, inf = nothing there, NaN = no reading.
        present: after this reading: 1 = something is there, 0 = nothing, -1 = not known yet.
        masked: whether the panel passes under it.
    """

    time: Array
    sensor: NDArray[np.int8]
    distance: Array
    present: NDArray[np.int8]
    masked: Flags


@dataclass(frozen=True, slots=True, eq=False)
class WholeSeries:
    """Everything that was measured; the run's rows lie in [`rows_from`, `rows_until`], s."""

    rows: Rows
    rows_from: float
    rows_until: float
    passage: PassageSeries
    latch_time: Array
    latch_engaged: Flags


def passage_series(signals: Signals, door: Series, thresholds: Thresholds) -> PassageSeries:
    """The rows of all used passage sensors by time, by the protocol's rules."""
    columns = []
    for place, sensor in enumerate(PASSAGE_SENSORS):
        strip = signals[Signal.of_strip(sensor.strip)]
        distance = strip.value[:, sensor.element]
        masked = is_masked(sensor, last_angles(door, strip.time), thresholds)
        counts = ~masked & ~np.isnan(distance)
        present = thresholds.lintel_height - distance > thresholds.present_height
        # a masked sensor, or one without a reading, keeps its last state
        newest = np.maximum.accumulate(np.where(counts, np.arange(distance.size), -1))
        state = np.where(newest < 0, -1, present[newest.clip(0)])
        columns.append((strip.time, np.full(distance.size, place), distance, state, masked))
    time, sensors, distance, state, masked = map(np.concatenate, zip(*columns, strict=True))
    order = np.argsort(time, kind="stable")
    return PassageSeries(
        time[order],
        sensors[order].astype(np.int8),
        distance[order],
        state[order].astype(np.int8),
        masked[order],
    )
