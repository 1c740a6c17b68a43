"""The quality of a run's data: losses, gaps, jitter, clock steps (section 8)."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass

from scoring.protocol import PASSAGE_SENSORS, SENSORS_PER_STRIP, Signal, Thresholds
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from scoring.stamps import KEPT_STEPS, StampGuard

LARGEST_UNEVENNESS = 1 / 3
"""A larger jitter, as a part of the mean interval, gets a remark: a flood, several publishers."""

_HOLE = 1.2
"""Intervals above this part of the mean so far are remembered."""

_MOST_HOLES = 200_000
"""Remembered interval ends: an hour of every second sample missing, at 50 Hz."""

_DELAYS_TOGETHER = 50
"""The least of so many delays is kept: memory stays small."""

AGAINST_OPENING = "against the opening side: check the testbed"
"""Ends a remark that another opening side would not make."""


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
        dropped: samples with a duplicate, backward, wrong or missing stamp.
        shifted: samples whose stamp was shifted back after a step of the publisher's clock.
        no_reading: readings that were NaN, missing, out of range or impossible.
        skew: largest difference between stamp and log time, outside of the clock's steps, s; null
            without samples.
        clock_steps: how often the publisher's clock was stepped.
        impossible: those among them that are beyond what the sensor can say; `eurobench-2020` takes
            them for readings.
        begins_late, ends_early: how long nothing of it could be used at that end of the
            recording, s; 0 = no longer than an interval may be.
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

    def cells(self) -> tuple[str, ...]:
        """Samples, rate, gap, gaps, jitter, skew, dropped, shifted, no reading; intervals in ms."""

        def text(value: float | None, scale: float = 1000) -> str:
            return "-" if value is None else f"{value * scale:.1f}"

        gaps = (text(self.largest_gap), str(self.gaps))
        counts = map(str, (self.dropped, self.shifted, self.no_reading))
        rate = text(self.rate, 1)
        return (str(self.samples), rate, *gaps, text(self.jitter), text(self.skew), *counts)

    def remarks(self, largest_skew: float) -> list[str]:
        """What to know of the signal; `largest_skew` between stamp and reception is in s."""
        return [f"{self.signal.value}: {words}" for words in self._remarks(largest_skew)]

    def _remarks(self, largest_skew: float) -> Iterator[str]:
        if self.dropped:
            yield f"{self.dropped} duplicate, backward, wrong or missing stamps dropped"
        if self.clock_steps > KEPT_STEPS:
            limit = f"of which the first {KEPT_STEPS} are told"
            yield f"clock stepped {self.clock_steps} times, {limit}"
        if not self.signal.optional:
            yield from self._interruptions()
        if self.no_reading:
            impossible = f", {self.impossible} of them impossible" if self.impossible else ""
            yield f"{self.no_reading} values without a reading{impossible}"
        if self.skew is not None and self.skew >= largest_skew:
            yield f"stamps differ from reception by up to {self.skew:.3f} s"

    def _interruptions(self) -> Iterator[str]:
        if self.begins_late:
            yield f"nothing in the first {self.begins_late:.1f} s of the recording"
        if self.gaps:
            yield f"{self.gaps} gaps, the longest {self.largest_gap:.3f} s"
        if self.ends_early:
            yield f"nothing in the last {self.ends_early:.1f} s of the recording"
        if self.rate and self.jitter and self.jitter * self.rate > LARGEST_UNEVENNESS:
            yield (
                f"uneven intervals of {1000 / self.rate:.1f} ms on average, "
                f"{1000 * self.jitter:.1f} ms standard deviation"
            )


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of the data of a run.

    Attributes:
        signals: in numbers.
        remarks: what to know of them, in words; waived checks and faults among them.
    """

    signals: tuple[SignalQuality, ...] = ()
    remarks: tuple[str, ...] = ()


class QualityCounter:
    """Counts one signal as its samples pass; memory does not grow.

    `holes` are the ends of intervals that may be too long, `restarts` the times at which the
    publisher's count of its messages went back, `read_until` that of the last reading; in s since
    the epoch, holes two each.
    """

    def __init__(self, signal: Signal, thresholds: Thresholds) -> None:
        self.guard = StampGuard()
        self.no_reading = 0
        self.signal = signal
        self.impossible = 0
        self.restarts = array("d")
        self.holes = array("d")
        self._thresholds = thresholds
        self._limit = thresholds.largest_gap
        self._used = tuple(s.element for s in PASSAGE_SENSORS if Signal.of_strip(s.strip) is signal)
        self._samples = 0
        self._newest = 0.0
        self._first_log = 0.0
        self._last_log = 0.0
        self._longest = 0.0
        self._gaps = 0
        self._regular = 0
        self._sum = 0.0
        self._squares = 0.0
        self._skew = 0.0
        self._least_delay = math.inf
        self._delays = array("d")
        self.read_until = -math.inf
        self._ranges: tuple[float, ...] = ()
        self._changed = 0.0
        self._repeated = 0
        self._stills = array("d")
        self._delay_ends = array("d")
        self._sequence = 0
        self._dropping = False

    def admit(self, sample: Sample) -> Sample | None:
        """Count `sample`; return it with its stamp corrected, or None if dropped."""
        if 0 < sample.sequence < self._sequence and len(self.restarts) < _MOST_HOLES:
            self.restarts.append(sample.time)
        self._sequence = sample.sequence
        admitted = self.guard.admit(sample)
        if admitted is None:
            self._dropping = True
            return None
        if self._samples:
            self._interval(admitted.time - self._newest)
            if self._dropping:
                self._dropping = False
                self._hole(admitted.time, admitted.log_time - self._last_log)
        else:
            self._first_log = admitted.log_time
        self._newest = admitted.time
        self._last_log = admitted.log_time
        self._samples += 1
        self._skew = max(self._skew, abs(admitted.time - admitted.log_time))
        self._delay(admitted.log_time - admitted.time)
        if missing := missing_readings(admitted, self._thresholds, self._used):
            self.no_reading += missing
            self.impossible += is_impossible(admitted, self._thresholds)
        if isinstance(admitted, PassageSample):
            self._follow_ranges(admitted)
        if not missing:
            if self._limit / 2 < admitted.time - self.read_until < math.inf:  # it said nothing
                self._hole(admitted.time, admitted.time - self.read_until)
            self.read_until = admitted.time
        return admitted

    def _follow_ranges(self, sample: PassageSample) -> None:
        if sample.ranges == self._ranges:
            self._repeated += 1
            return
        if sample.time - self._changed > self._thresholds.doubt.stuck_time:
            self._stills.extend((self._changed, sample.time))
        self._ranges, self._changed = sample.ranges, sample.time

    def stills(self) -> list[tuple[float, float]]:
        """When a strip that usually has noise gave the same ranges for long, s since the epoch."""
        if not self._ranges or self._repeated > self._samples / 2:
            return []
        times = [*self._stills, self._changed, self._newest]
        stretches = zip(times[::2], times[1::2], strict=True)
        longest = self._thresholds.doubt.stuck_time
        return [(since, until) for since, until in stretches if until - since > longest]

    def _delay(self, delay: float) -> None:
        self._least_delay = min(self._least_delay, delay)  # what arrives late has the same stamps
        if self._samples % _DELAYS_TOGETHER == 0:
            self._delays.append(self._least_delay)
            self._delay_ends.append(self._newest)
            self._least_delay = math.inf

    @property
    def interval(self) -> float | None:
        """The mean of the intervals that are no gaps, s; None without any."""
        return self._sum / self._regular if self._regular else None

    @property
    def jitter(self) -> float | None:
        """Standard deviation of the intervals that are no gaps, s; None below two of them."""
        if self._regular < 2:
            return None
        mean = self._sum / self._regular
        return math.sqrt(max(0.0, self._squares / self._regular - mean * mean))

    def delay_near(self, time: float) -> float | None:
        """How far reception lies behind the stamps about then, s, where nothing arrives late."""
        place = bisect_left(self._delay_ends, time)
        near = self._delays[max(0, place - 1) : place + 2]
        return min(near, default=None)

    @property
    def readings(self) -> int:
        """How many values the samples had, of the used ranges."""
        return self._samples * max(1, len(self._used))

    def longer_than(self, intervals: float) -> list[tuple[float, float]]:
        """Ends, s since the epoch, of intervals longer than this many mean ones."""
        mean = self.interval
        if mean is None:
            return []
        ends = ((self.holes[i], self.holes[i + 1]) for i in range(0, len(self.holes), 2))
        return [(since, until) for since, until in ends if until - since > intervals * mean]

    def _interval(self, interval: float) -> None:
        self._longest = max(self._longest, interval)
        self._hole(self._newest + interval, interval)
        if interval > self._limit:
            self._gaps += 1
            return
        self._regular += 1
        self._sum += interval
        self._squares += interval * interval

    def _hole(self, end: float, length: float) -> None:
        if length * self._regular > _HOLE * self._sum and len(self.holes) < _MOST_HOLES:
            self.holes.extend((end - length, end))

    def quality(self, begin: float | None = None, end: float | None = None) -> SignalQuality:
        """Quality in a recording from log time `begin` to `end`, s; None = the signal's own."""
        mean = self._sum / self._regular if self._regular else 0.0
        return SignalQuality(
            signal=self.signal,
            samples=self._samples,
            rate=1 / mean if mean > 0 else None,
            largest_gap=self._longest if self._samples >= 2 else None,
            gaps=self._gaps,
            jitter=self.jitter,
            dropped=self.guard.dropped,
            shifted=self.guard.shifted,
            no_reading=self.no_reading,
            skew=self._skew if self._samples else None,
            clock_steps=self.guard.step_count,
            begins_late=self._silence(begin, self._first_log),
            ends_early=self._silence(self._last_log, end),
            impossible=self.impossible,
        )

    def _silence(self, begin: float | None, end: float | None) -> float:
        if not self._samples or begin is None or end is None:
            return 0.0
        return end - begin if end - begin > self._limit else 0.0


def missing_readings(sample: Sample, thresholds: Thresholds, used: tuple[int, ...]) -> int:
    """How many values of a sample, of the `used` ranges, are no reading (REP-117, section 11)."""
    match sample:
        case PassageSample():
            if all_in_range(sample):
                return 0
            # what lies too close to a sensor is a reading, but none of a robot
            unread = [e for e in used if not is_reading(sample, e) or sample.ranges[e] == -math.inf]
            return len(unread)
        case DoorSample():
            return not abs(sample.angle) <= thresholds.largest_angle
        case HandleSample():
            return not abs(sample.force) <= thresholds.impossible_force
        case _:
            return 0


def is_impossible(sample: Sample, thresholds: Thresholds) -> bool:
    match sample:
        case DoorSample():
            return math.isfinite(sample.angle) and abs(sample.angle) > thresholds.largest_angle
        case HandleSample():
            return math.isfinite(sample.force) and abs(sample.force) > thresholds.impossible_force
        case _:
            return False


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
