"""The quality of a run's data in numbers: rate, gaps, jitter, clock steps (section 8)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from scoring.protocol import SENSORS_PER_STRIP, Signal
from scoring.samples import PassageSample

_UNEVEN = 1 / 3
"""A larger jitter, as a part of the mean interval, gets a remark: a flood, several publishers."""


@dataclass(frozen=True, slots=True)
class SignalQuality:
    """The quality of one signal over the whole recording.

    Attributes:
        signal: which.
        samples: samples used.
        rate: their mean rate, gaps left out, Hz; null below two samples.
        largest_gap: the longest interval between samples, s; null below two samples.
        gaps: how many intervals were longer than allowed.
        jitter: standard deviation of the other intervals, s; null below two of them.
        dropped: samples with a duplicate, backward or missing stamp.
        shifted: samples whose stamp was shifted back after a step of the publisher's clock.
        no_reading: readings that were NaN, missing, out of range or impossible.
        skew: largest difference between stamp and log time, outside of the clock's steps, s; null
            without samples.
        skewed: whether the `skew` is as large as the setting `largest_skew`.
        clock_steps: how often the publisher's clock was stepped.
        begins_late, ends_early: how long nothing of it could be used at that end of the
            recording, s; 0 = no longer than an interval may be.
        impossible: those among the missing readings that are beyond what the sensor can say;
            `eurobench-2020` takes them for readings.
    """

    signal: Signal
    samples: int
    rate: float | None
    largest_gap: float | None
    gaps: int
    jitter: float | None
    dropped: int
    shifted: int
    no_reading: int
    skew: float | None
    clock_steps: int = 0
    begins_late: float = 0.0
    ends_early: float = 0.0
    impossible: int = 0
    skewed: bool = False

    def cells(self) -> tuple[str, ...]:
        """Return the numbers of a row in the order of the columns, intervals in ms."""

        def text(value: float | None, scale: float = 1000) -> str:
            return "-" if value is None else f"{value * scale:.1f}"

        gaps = (text(self.largest_gap), str(self.gaps))
        counts = map(str, (self.dropped, self.shifted, self.no_reading))
        rate = text(self.rate, 1)
        return (str(self.samples), rate, *gaps, text(self.jitter), text(self.skew), *counts)

    def remarks(self) -> Iterator[str]:
        """Return what to know of the signal."""
        if not self.samples:
            yield "nothing recorded"
        if self.dropped:
            yield f"{self.dropped} duplicate, backward, wrong or missing stamps dropped"
        if self.clock_steps:
            yield f"clock steps: {self.clock_steps}, later stamps shifted back"
        if not self.signal.optional:
            yield from self._interruptions()
        if self.no_reading:
            impossible = f", {self.impossible} of them impossible" if self.impossible else ""
            yield f"{self.no_reading} values without a reading{impossible}"
        if self.skewed:
            yield f"stamps differ from reception by up to {self.skew:.3f} s"

    def _interruptions(self) -> Iterator[str]:
        if self.begins_late:
            yield f"nothing in the first {self.begins_late:.1f} s of the recording"
        if self.gaps:
            yield f"gaps: {self.gaps}, the longest {self.largest_gap:.3f} s"
        if self.ends_early:
            yield f"nothing in the last {self.ends_early:.1f} s of the recording"
        if self.rate and self.jitter and self.jitter * self.rate > _UNEVEN:
            yield (
                f"uneven intervals of {1000 / self.rate:.1f} ms on average, "
                f"{1000 * self.jitter:.1f} ms standard deviation"
            )


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of the data of a run.

    Attributes:
        signals: in numbers.
        remarks: what the recording says beyond them, in words.
        lost: what did not get into the recording, in words of the engine that made it.
        against_opening: how far the panel turned to the side that is not the opening side, rad;
            0 = no farther than closed.
    """

    signals: tuple[SignalQuality, ...] = ()
    remarks: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    against_opening: float = 0.0


def all_in_range(sample: PassageSample) -> bool:
    low, high = sample.range_min, sample.range_max
    for distance in sample.ranges:
        if not low <= distance <= high:
            return False
    return len(sample.ranges) == SENSORS_PER_STRIP


def is_reading(sample: PassageSample, element: int) -> bool:
    if element >= len(sample.ranges):
        return False
    distance = sample.ranges[element]
    return sample.range_min <= distance <= sample.range_max or math.isinf(distance)
