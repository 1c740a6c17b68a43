"""The engine's clocks: of the system, virtual.

Two readings: *steady time* (ns since the epoch; the wall clock at the opening of a bag plus
monotonic time since, protocol section 8) labels messages and acts; *monotonic time* measures
durations.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

NS = 1_000_000_000


def seconds(ns: int) -> float:
    """Nanoseconds as seconds, correctly rounded."""
    return ns / NS


def nanoseconds(s: float) -> int:
    return round(s * NS)


class Clock(ABC):
    """Time for the engine and its sources; without steps, unless it follows the wall clock."""

    @abstractmethod
    def now_ns(self) -> int:
        """Steady time, ns since the epoch."""

    @abstractmethod
    def sleep(self, duration: float) -> None:
        """Let `duration` seconds of this clock's time pass."""

    def hold_steady(self) -> None:  # noqa: B027  without steps
        """From now on run on monotonic time alone (a bag is open)."""

    def release(self) -> None:  # noqa: B027  without steps
        """Follow the wall clock again (the bag is closed)."""


class SystemClock(Clock):
    """The machine's time, optionally running `speed` times as fast.

    While held, a step of the machine's clock does not move it.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._wall = time.time_ns()
        self._monotonic = time.monotonic_ns()
        self._held = speed != 1.0  # a scaled clock has left the wall clock for good

    def now_ns(self) -> int:
        if not self._held:
            return time.time_ns()
        return self._wall + round((time.monotonic_ns() - self._monotonic) * self.speed)

    def sleep(self, duration: float) -> None:
        time.sleep(max(0.0, duration) / self.speed)

    def hold_steady(self) -> None:
        if not self._held:
            self._wall, self._monotonic, self._held = time.time_ns(), time.monotonic_ns(), True

    def release(self) -> None:
        self._held = self.speed != 1.0


class VirtualClock(Clock):
    """Time that moves only when told to: a two-minute run takes milliseconds."""

    def __init__(self, start_ns: int) -> None:
        self._now = start_ns

    def now_ns(self) -> int:
        return self._now

    def sleep(self, duration: float) -> None:
        self.advance_to(self._now + nanoseconds(max(0.0, duration)))

    def advance_to(self, now_ns: int) -> None:
        """Move to `now_ns`; never back."""
        self._now = max(self._now, now_ns)
