"""The health of a topic: fresh, stale or lost, and within which limits (protocol section 3)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum


class Freshness(StrEnum):
    """Age of the newest message of a topic."""

    FRESH = "fresh"
    STALE = "stale"
    LOST = "lost"
    NEVER = "never seen"


class Presence:
    """Age of the newest item, by steady receive times (s).

    It is fresh up to the age `fresh` and lost above the age `lost`, in s.
    """

    def __init__(self, fresh: float = 0.5, lost: float = 2.0) -> None:
        self.newest: float | None = None
        self._fresh = fresh
        self._lost = lost

    def age(self, now: float) -> float | None:
        """Age of the newest, s, as an absolute value: the clock may have been stepped back."""
        return None if self.newest is None else abs(now - self.newest)

    def freshness(self, now: float) -> Freshness:
        age = self.age(now)
        if age is None:
            return Freshness.NEVER
        if age <= self._fresh:
            return Freshness.FRESH
        return Freshness.STALE if age <= self._lost else Freshness.LOST


class Health(Presence):
    """Age and rate of one topic, by steady receive times; the rate is taken over `window` s."""

    def __init__(self, fresh: float = 0.5, lost: float = 2.0, window: float = 2.0) -> None:
        super().__init__(fresh, lost)
        self._window = window
        self._times: deque[float] = deque()

    def add(self, now: float) -> None:
        if self.newest is not None and now < self.newest:
            self._times.clear()  # the clock was stepped back
        self.newest = now
        self._times.append(now)
        self.count(now)

    def count(self, now: float) -> int:
        times, begin = self._times, now - self._window
        while times and times[0] < begin:
            times.popleft()
        return len(times)

    def rate(self, now: float) -> float | None:
        if self.count(now) < 2:
            return None
        span = now - self._times[0]
        return (len(self._times) - 1) / span if span > 0 else None


@dataclass(frozen=True, slots=True)
class SensorLimits:
    """What counts as healthy.

    Attributes:
        fresh: up to this age a topic is fresh, s.
        lost: above this age it is lost, s.
        rate: the testbed's rate, Hz.
        least_rate, most_rate: healthy fractions of it.
        averaging: the handle zero is the mean over this long, s.
    """

    fresh: float = 0.5
    lost: float = 2.0
    rate: float = 50.0
    least_rate: float = 0.8
    most_rate: float = 3.0
    averaging: float = 1.0
