"""One topic of the testbed, live: its faults, found within 2 s and put in words."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from textwrap import shorten

from madrob_console.engine.snapshot import Extent, Recent
from madrob_console.messages.codec import range_problem
from madrob_console.messages.mapping import TopicMapping
from madrob_console.referee.records import SILENT, FaultKind
from madrob_console.referee.topic_health import Freshness, Health, Presence, SensorLimits
from madrob_console.testbeds.source import TopicStatus
from scoring.protocol import PASSAGE_SENSORS, Signal, Thresholds
from scoring.quality import all_in_range
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample

RECENT = 22.0
"""How much of it the screens get, s: 20 and what they move on by at once."""

EXTENT = 0.1
"""Readings within this time are one extent, s."""


class RecentReadings:
    """The extents of the readings of the last `RECENT` s, by steady receive times."""

    def __init__(self) -> None:
        self._extents: deque[Extent] = deque(maxlen=round(RECENT / EXTENT))

    def add(self, now: float, value: float) -> None:
        extents, time = self._extents, (now // EXTENT + 0.5) * EXTENT
        if extents and time < extents[-1].time:
            extents.clear()  # the clock was stepped back
        same = extents and time == extents[-1].time
        before = extents.pop() if same else Extent(time, value, value)
        extents.append(Extent(time, min(before.low, value), max(before.high, value)))

    def stretches(self, now: float, gap: float) -> Recent:
        """Split where no message arrived for longer than `gap`, s."""
        parts: list[list[Extent]] = []
        for extent in self._extents:
            if parts and extent.time - parts[-1][-1].time <= gap:
                parts[-1].append(extent)
            elif extent.time > now - RECENT:
                parts.append([extent])
        return tuple(map(tuple, parts))


WINDOW = 2.0
"""Window of faults and rates, s: a fault that happened once is shown this long."""

_REGULAR = 10
"""A latch with so many messages in `WINDOW` speaks all the time, not only when it changes."""

_LONGEST_WORDS = 120
"""Most characters of a decoder's error."""


class TopicWatch:
    """Follows the messages of one topic.

    Attributes:
        absent: the name of the mapped element, once a message came that lacks it; else None.
    """

    def __init__(self, mapping: TopicMapping, limits: SensorLimits, thresholds: Thresholds) -> None:
        self.signal = mapping.signal
        self.absent: str | None = None
        self._is_by_name = mapping.element_name is not None
        self.messages = Health(limits.fresh, limits.lost, WINDOW)
        self.readings = Presence(limits.fresh, limits.lost)
        self.sensors = {
            sensor: Presence(limits.fresh, limits.lost)
            for sensor in PASSAGE_SENSORS
            if Signal.of_strip(sensor.strip) is mapping.signal
        }
        self.received = 0
        self.is_regular = False
        self._limits = limits
        self._thresholds = thresholds
        self._unreadable = Health(window=WINDOW)
        self._complaint = ""
        self._empty = Health(window=WINDOW)
        self._missing = ""
        self._disordered = Health(window=WINDOW)
        self._reversed = Health(window=WINDOW)
        self._sequence = 0
        self._stamp: float | None = None
        self._skews: deque[tuple[float, float]] = deque()
        self._recent = RecentReadings()

    # ------------------------------------------------------------------ what arrives

    def note_arrival(self, now: float) -> None:
        """`now` is s since the epoch."""
        self.received += 1
        self.messages.add(now)
        self.is_regular = self.is_regular or self.messages.count(now) >= _REGULAR

    def receive(self, now: float, sample: Sample | None, problem: str | None, angle: float) -> None:
        """Take a message, or why it cannot be read.

        The `problem` of a strip's sample is why a range of it is missing. `now` is s since the
        epoch. `angle` is the panel's, rad: sensors under it need no reading.
        """
        self.note_arrival(now)
        if problem is not None and not isinstance(sample, PassageSample):
            self._unreadable.add(now)
            self._complaint = shorten(problem, _LONGEST_WORDS, placeholder=" ...")
            problem = None
        if sample is None:
            return
        if sample.sequence <= self._sequence:
            self._reversed.add(now)
        self._sequence = sample.sequence
        self._follow_stamp(now, sample)
        missing = self._missing_in(now, sample, angle)
        if missing is None:
            self.readings.newest = now
            if isinstance(sample, DoorSample | HandleSample):
                value = sample.angle if isinstance(sample, DoorSample) else sample.force
                self._recent.add(now, value)
        else:
            self._empty.add(now)
            self._missing = problem or missing

    def _follow_stamp(self, now: float, sample: Sample) -> None:
        if self._skews and now < self._skews[-1][0]:  # the clock was stepped back, stamps follow
            self._skews.clear()
            self._stamp = None
        previous, self._stamp = self._stamp, sample.time
        if sample.time == 0 or (previous is not None and sample.time <= previous):
            self._disordered.add(now)
        if sample.time != 0:  # else it was never set
            self._skews.append((now, sample.time - sample.log_time))
        while self._skews and self._skews[0][0] < now - self._limits.averaging:
            self._skews.popleft()

    def _missing_in(self, now: float, sample: Sample, angle: float) -> str | None:
        match sample:
            case PassageSample():
                return self._missing_range(now, sample, angle)
            case DoorSample():
                return _no_reading("angle", sample.angle, self._thresholds.largest_angle, "rad")
            case HandleSample():
                return _no_reading("force", sample.force, self._thresholds.impossible_force, "N")
            case _:
                return None

    def _missing_range(self, now: float, sample: PassageSample, angle: float) -> str | None:
        missing = None
        if all_in_range(sample):
            for presence in self.sensors.values():
                presence.newest = now
            return None
        for sensor, presence in self.sensors.items():
            problem = range_problem(sample, sensor.element, sensor.element)
            if problem is None:
                presence.newest = now
            elif not self._thresholds.masked(sensor.side, sensor.index, angle):
                missing = missing or problem
        return missing

    def recent(self, now: float) -> Recent:
        return self._recent.stretches(now, self._limits.fresh)

    # ------------------------------------------------------------------ what is wrong

    def missing(self, now: float) -> str | None:
        """Why messages have no reading, in words; None = they have."""
        return self._missing if self._empty.count(now) else None

    def skew(self, now: float, extreme: Callable[..., float] = max) -> float | None:
        """The largest stamp - log time of the last second, s, with its sign.

        With `min` it is the smallest, which no stray stamp decides.
        """
        recent = [skew for time, skew in self._skews if time >= now - self._limits.averaging]
        return extreme(recent, key=abs) if recent else None

    def faults(self, status: TopicStatus | None, now: float) -> dict[FaultKind, str]:
        faults: dict[FaultKind, str] = {}
        if status is not None and status.problem:
            faults[FaultKind.SOURCE] = status.problem
        if status is not None and status.publishers > 1 and self._has_rivals(now):
            faults[FaultKind.SEVERAL_PUBLISHERS] = f"{status.publishers} publishers: keep one"
        freshness = self.messages.freshness(now)
        if freshness is Freshness.NEVER:
            if not self.signal.optional and not faults:  # else it is known why
                published = status is not None and status.publishers > 0
                faults[FaultKind.NEVER_SEEN] = (
                    self._silence if published else f"{self._silence}, no publisher"
                )
            return faults
        if not self.signal.optional:
            self._find_slowness(faults, freshness, now)
        self._find_flood(faults, now)
        self._find_content_faults(faults, now)
        return faults

    def _has_rivals(self, now: float) -> bool:
        """Whether publishers mix: others may send other names, then sequence numbers tell."""
        return not self._is_by_name or self._reversed.count(now) > 0

    @property
    def _silence(self) -> str:
        return SILENT if self.absent is None else f"no message names {self.absent}"

    def _find_slowness(
        self, faults: dict[FaultKind, str], freshness: Freshness, now: float
    ) -> None:
        limits, rate = self._limits, self.messages.rate(now)
        if freshness is not Freshness.FRESH:
            faults[FaultKind.SILENT] = f"{self._silence} for {self.messages.age(now):.1f} s"
        elif rate is None and self.received > 1:
            faults[FaultKind.SLOW] = f"only one message in {WINDOW:g} s"
        elif rate is not None and rate < limits.least_rate * limits.rate:
            faults[FaultKind.SLOW] = (
                f"{limits.rate - rate:.0f} of {limits.rate:.0f} messages/s missing"
            )

    def _find_flood(self, faults: dict[FaultKind, str], now: float) -> None:
        rate, usual = self.messages.rate(now), self._limits.rate
        if rate is not None and rate > self._limits.most_rate * usual:
            faults[FaultKind.FLOOD] = f"{rate:.0f} messages/s, far above {usual:.0f}"

    def _find_content_faults(self, faults: dict[FaultKind, str], now: float) -> None:
        total = self.messages.count(now)
        if unreadable := self._unreadable.count(now):
            of = f"{unreadable} of {total} messages"
            faults[FaultKind.UNREADABLE] = f"{of}: {self._complaint}"
        empty = self._empty.count(now)
        if empty > (1 - self._limits.least_rate) * total:
            faults[FaultKind.NO_READING] = (
                f"no reading in {empty} of {total} messages: {self._missing}"
            )
        if disordered := self._disordered.count(now):
            what = "is missing (0)" if self._stamp == 0 else "repeats or goes back"
            faults[FaultKind.STAMPS] = f"the stamp {what} in {disordered} of {total} messages"
        skew = self.skew(now)
        if skew is not None and abs(skew) >= self._thresholds.largest_skew:
            where = "ahead" if skew > 0 else "late"
            faults[FaultKind.SKEW] = f"stamps {abs(skew):.2f} s {where}"


def _no_reading(name: str, value: float, largest: float, unit: str) -> str | None:
    if abs(value) <= largest:
        return None
    if math.isfinite(value):
        return f"{name} {value:+.6g} {unit} is impossible, beyond +-{largest:g} {unit}"
    return f"{name} is {'NaN or empty' if math.isnan(value) else f'{value:+}'}"
