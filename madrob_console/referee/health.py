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


class Health:
    """Age and rate of one topic, by steady receive times (s).

    Args:
        fresh: up to this age a topic is fresh, s.
        lost: above this age it is lost, s.
        window: the rate is taken over this long, s.
    """

    def __init__(self, fresh: float = 0.5, lost: float = 2.0, window: float = 2.0) -> None:
        self._fresh = fresh
        self._lost = lost
        self._window = window
        self._times: deque[float] = deque()

    def seen(self, now: float) -> None:
        """A message arrived at `now`."""
        if self._times and now < self._times[-1]:
            self._times.clear()  # the clock was stepped back
        self._times.append(now)
        self._forget(now)

    def _forget(self, now: float) -> None:
        while len(self._times) > 1 and self._times[0] < now - self._window:
            self._times.popleft()

    def age(self, now: float) -> float | None:
        """Age of the newest message, s; None before the first.

        A message from the future (the clock was stepped back) is as old as it is far away: what
        cannot be judged is not fresh.
        """
        return abs(now - self._times[-1]) if self._times else None

    def freshness(self, now: float) -> Freshness:
        """The state at `now`."""
        age = self.age(now)
        if age is None:
            return Freshness.NEVER
        if age <= self._fresh:
            return Freshness.FRESH
        return Freshness.STALE if age <= self._lost else Freshness.LOST

    def rate(self, now: float) -> float | None:
        """Messages a second over the window; None with fewer than two in it."""
        self._forget(now)
        if len(self._times) < 2 or self._times[0] < now - self._window:
            return None
        span = now - self._times[0]
        return (len(self._times) - 1) / span if span > 0 else None
