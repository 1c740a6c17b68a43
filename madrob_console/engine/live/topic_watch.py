"""One topic of the testbed, live: what can be wrong with it, found within 2 s and put in words."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from textwrap import shorten
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness, Health, Presence
from scoring.protocol import PASSAGE_SENSORS, PassageSensor, Signal, Thresholds
from scoring.quality import all_in_range, is_reading
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample

if TYPE_CHECKING:
    from madrob_console.engine.live.limits import SensorLimits
    from madrob_console.testbeds.source import TopicStatus

WINDOW = 2.0
"""What happened within this long is told, s: also what happened only once."""

_LONGEST_WORDS = 120
"""Of a decoder's complaint."""


class Trouble(StrEnum):
    """What can be wrong with a topic."""

    SOURCE = "its source says so"
    SEVERAL_PUBLISHERS = "several publishers"
    NEVER_SEEN = "nothing received"
    SILENT = "silent"
    SLOW = "too slow"
    FLOOD = "too fast"
    UNREADABLE = "messages that cannot be read"
    NO_READING = "messages without a reading"
    STAMPS = "stamps that are missing, repeat or go back"
    SKEW = "stamps off the time of reception"
    BEHIND = "the engine is behind"
    EVIDENCE = "evidence that is lost"


class TopicWatch:
    """Follows the messages of one topic.

    Args:
        signal: what the topic carries.
        limits: what counts as healthy.
        thresholds: the testbed's numbers.
    """

    def __init__(self, signal: Signal, limits: SensorLimits, thresholds: Thresholds) -> None:
        self.signal = signal
        self.messages = Health(limits.fresh, limits.lost, WINDOW)
        self.readings = Presence(limits.fresh, limits.lost)
        self.sensors = {
            sensor: Presence(limits.fresh, limits.lost)
            for sensor in PASSAGE_SENSORS
            if Signal.of_strip(sensor.strip) is signal
        }
        self.received = 0
        self._limits = limits
        self._thresholds = thresholds
        self._unreadable = Health(window=WINDOW)
        self._complaint = ""
        self._empty = Health(window=WINDOW)
        self._missing = ""
        self._disordered = Health(window=WINDOW)
        self._stamp: float | None = None
        self._skews: deque[tuple[float, float]] = deque()

    # ------------------------------------------------------------------ what arrives

    def note_arrival(self, now: float) -> None:
        """A message arrived at `now`, s since the epoch."""
        self.received += 1
        self.messages.seen(now)

    def receive(self, now: float, sample: Sample | None, error: str | None, angle: float) -> None:
        """A message arrived.

        Args:
            now: when, s since the epoch.
            sample: what it says; None when it cannot be read.
            error: why it cannot be read; None when it can.
            angle: of the panel, rad: sensors under which it passes need no reading.
        """
        self.note_arrival(now)
        if error is not None:
            self._unreadable.seen(now)
            self._complaint = shorten(error, _LONGEST_WORDS, placeholder=" ...")
        if sample is None:
            return
        self._follow_stamp(now, sample)
        missing = self._missing_in(now, sample, angle)
        if missing is None:
            self.readings.newest = now
        else:
            self._empty.seen(now)
            self._missing = missing

    def _follow_stamp(self, now: float, sample: Sample) -> None:
        if self._skews and now < self._skews[-1][0]:  # the clock was stepped back, stamps follow
            self._skews.clear()
            self._stamp = None
        previous, self._stamp = self._stamp, sample.time
        if sample.time == 0 or (previous is not None and sample.time <= previous):
            self._disordered.seen(now)
        if sample.time != 0:  # else it was never set
            self._skews.append((now, sample.time - sample.log_time))
        while self._skews and self._skews[0][0] < now - self._limits.averaging:
            self._skews.popleft()

    def _missing_in(self, now: float, sample: Sample, angle: float) -> str | None:
        """What of a sample is no reading, in words; None when all of it is one."""
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
            if is_reading(sample, sensor.element):
                presence.newest = now
            elif not self._thresholds.masked(sensor.side, sensor.index, angle):
                missing = missing or _range_in_words(sample, sensor)
        return missing

    # ------------------------------------------------------------------ what is wrong

    def skew(self, now: float, extreme: Callable[..., float] = max) -> float | None:
        """The largest stamp - log time of the last second, s, with its sign; None without one.

        With `min` it is the smallest: what no stray stamp decides.
        """
        recent = [skew for time, skew in self._skews if time >= now - self._limits.averaging]
        return extreme(recent, key=abs) if recent else None

    def troubles(self, status: TopicStatus | None, now: float) -> dict[Trouble, str]:
        """What is wrong at `now`, in words; empty for a healthy topic."""
        found: dict[Trouble, str] = {}
        if status is not None and status.problem:
            found[Trouble.SOURCE] = status.problem
        if status is not None and status.publishers > 1:
            found[Trouble.SEVERAL_PUBLISHERS] = f"{status.publishers} publishers: keep one"
        freshness = self.messages.freshness(now)
        if freshness is Freshness.NEVER:
            if not self.signal.optional and not found:  # else it is known why
                published = status is not None and status.publishers > 0
                why = "nothing received" if published else "nothing received: no publisher"
                found[Trouble.NEVER_SEEN] = why
            return found
        if not self.signal.optional:
            self._find_slowness(found, freshness, now)
        self._find_flood(found, now)
        self._find_content_trouble(found, now)
        return found

    def _find_slowness(self, found: dict[Trouble, str], freshness: Freshness, now: float) -> None:
        limits, rate = self._limits, self.messages.rate(now)
        if freshness is not Freshness.FRESH:
            found[Trouble.SILENT] = f"{freshness}, silent for {self.messages.age(now):.1f} s"
        elif rate is None and self.received > 1:
            found[Trouble.SLOW] = f"one message in {WINDOW:g} s instead of {limits.rate:.0f} Hz"
        elif rate is not None and rate < limits.least_rate * limits.rate:
            found[Trouble.SLOW] = f"only {rate:.0f} Hz of {limits.rate:.0f} Hz"

    def _find_flood(self, found: dict[Trouble, str], now: float) -> None:
        rate, usual = self.messages.rate(now), self._limits.rate
        if rate is not None and rate > self._limits.most_rate * usual:
            found[Trouble.FLOOD] = f"{rate:.0f} Hz, far above {usual:.0f} Hz"

    def _find_content_trouble(self, found: dict[Trouble, str], now: float) -> None:
        total = self.messages.count(now)
        if unreadable := self._unreadable.count(now):
            of = f"{unreadable} of {total} messages"
            found[Trouble.UNREADABLE] = f"{of}: {self._complaint}"
        empty = self._empty.count(now)
        if empty > (1 - self._limits.least_rate) * total:
            found[Trouble.NO_READING] = (
                f"no reading in {empty} of {total} messages: {self._missing}"
            )
        if disordered := self._disordered.count(now):
            what = "is missing (0)" if self._stamp == 0 else "repeats or goes back"
            found[Trouble.STAMPS] = f"the stamp {what} in {disordered} of {total} messages"
        skew = self.skew(now)
        if skew is not None and abs(skew) >= self._thresholds.largest_skew:
            where = "ahead of" if skew > 0 else "behind"
            found[Trouble.SKEW] = f"stamps {abs(skew):.3f} s {where} their reception"


def _no_reading(name: str, value: float, largest: float, unit: str) -> str | None:
    if abs(value) <= largest:
        return None
    if math.isfinite(value):
        return f"{name} {value:+.6g} {unit} is impossible, beyond +-{largest:g} {unit}"
    return f"{name} is {'NaN or empty' if math.isnan(value) else f'{value:+}'}"


def _range_in_words(sample: PassageSample, sensor: PassageSensor) -> str:
    if sensor.element >= len(sample.ranges):
        return f"only {len(sample.ranges)} ranges of 4"
    distance = sample.ranges[sensor.element]
    low, high = sample.range_min, sample.range_max
    what = "NaN" if math.isnan(distance) else f"{distance:g} m, outside {low:g} to {high:g} m"
    return f"range {sensor.element} is {what}"
