"""The engine's clocks: of the system, of a simulation, virtual.

Two readings: *steady time* (ns since the epoch; the wall clock at the opening of a bag plus
monotonic time since, protocol section 8) labels messages and acts; *monotonic time* measures
durations.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

NS = 1_000_000_000

_STEP = NS // 2
"""Simulated time that falls back by more was paused or set back, ns."""

_SLOWEST = 0.01
"""Lowest rate of simulated time: it never stands still, so that received messages have an order."""

_SILENT = 2 * NS
"""Timeout after which the simulation counts as paused or gone, ns."""


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


class SimulationClock(SystemClock):
    """The time of a simulation, from its topic `/clock` (protocol section 3).

    Between two messages it runs on at their pace, and 2 s after the last one at the machine's: a
    simulation that pauses or ends holds up no abort and no file. It goes back only while it is not
    held; what it ran on through a pause stays until it is released.
    """

    def __init__(self) -> None:
        super().__init__()
        self._sim_time = self._wall
        self._measured = (self._wall, self._monotonic)
        self._pace = 1.0
        self._mark = (*self._measured, self._pace)
        self._ahead = 0

    def hear(self, sim_time: int, age: int) -> None:
        """Take a message of the simulation's time, `age` ns of the machine's time old."""
        if sim_time == self._sim_time:
            return  # it is paused
        self._sim_time, now = sim_time, time.monotonic_ns()
        before, since = self._measured
        if (passed := now - age - since) >= _STEP // 3:
            self._pace = max(_SLOWEST, (sim_time - before) / passed)
            self._measured = (sim_time, now - age)
        if not self._held:
            self._ahead = 0
        there = sim_time + self._ahead + round(age * self._pace)
        back = max(0, self._at(now) - there)
        if back > _STEP and self._held:
            self._ahead += back
        elif back > _STEP:
            back = 0
        slowed = max(_SLOWEST, 1 - 4 * back / _STEP)  # until /clock is there
        self._mark = (there + back, now, self._pace * slowed)

    @property
    def silent(self) -> bool:
        """Whether the simulation is paused or gone, or was never there."""
        return time.monotonic_ns() - self._mark[1] > _SILENT

    def now_ns(self) -> int:
        """Simulated time, ns; the machine's until the simulation is heard."""
        return self._at(time.monotonic_ns())

    def _at(self, monotonic: int) -> int:
        reading, at, pace = self._mark
        passed = monotonic - at
        return reading + round(min(passed, _SILENT) * pace) + max(0, passed - _SILENT)


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
