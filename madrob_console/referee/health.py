"""How alive a topic is: fresh, stale, lost (protocol section 3)."""

from __future__ import annotations

from collections import deque
from enum import StrEnum


class Freshness(StrEnum):
    """Age of the newest message of a topic."""

    FRESH = "fresh"
    STALE = "stale"
    LOST = "lost"
    NEVER = "never seen"


class Presence:
    """Age of the newest of something, by steady receive times (s).

    Args:
        fresh: up to this age it is fresh, s.
        lost: above this age it is lost, s.

    Attributes:
        newest: when it was seen last; None before the first.
    """

    def __init__(self, fresh: float = 0.5, lost: float = 2.0) -> None:
        self.newest: float | None = None
        self._fresh = fresh
        self._lost = lost

    def age(self, now: float) -> float | None:
        """Age of the newest, s; None before the first.

        One from the future (the clock was stepped back) is as old as it is far away: what
        cannot be judged is not fresh.
        """
        return None if self.newest is None else abs(now - self.newest)

    def freshness(self, now: float) -> Freshness:
        """The state at `now`."""
        age = self.age(now)
        if age is None:
            return Freshness.NEVER
        if age <= self._fresh:
            return Freshness.FRESH
        return Freshness.STALE if age <= self._lost else Freshness.LOST


class Health(Presence):
    """Age and rate of one topic, by steady receive times (s).

    Args:
        fresh, lost: as for `Presence`.
        window: the rate is taken over this long, s.
    """

    def __init__(self, fresh: float = 0.5, lost: float = 2.0, window: float = 2.0) -> None:
        super().__init__(fresh, lost)
        self._window = window
        self._times: deque[float] = deque()

    def seen(self, now: float) -> None:
        """A message arrived at `now`."""
        if self.newest is not None and now < self.newest:
            self._times.clear()  # the clock was stepped back
        self.newest = now
        self._times.append(now)
        self.count(now)

    def count(self, now: float) -> int:
        """How many messages came within the window."""
        times, begin = self._times, now - self._window
        while times and times[0] < begin:
            times.popleft()
        return len(times)

    def rate(self, now: float) -> float | None:
        """Messages a second over the window; None with fewer than two in it."""
        if self.count(now) < 2:
            return None
        span = now - self._times[0]
        return (len(self._times) - 1) / span if span > 0 else None
