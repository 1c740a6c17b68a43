"""The engine's clocks: of the system, virtual, and of a recording.

Two readings: *steady time* (ns since the epoch; the wall clock at the opening of a bag plus
monotonic time since, protocol section 8) labels messages and acts; *monotonic time* measures
durations.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable

from madrob_console.common.errors import MadrobError

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


# The clock of a recording: it stands, steps, jumps and runs at any speed.


TICK = 0.02
"""Seconds between two ticks: one door sample at 50 Hz."""

FASTEST = 1000.0
"""The highest replay speed, as a factor of real time."""

LONGEST = 200_000
"""Seconds; no run takes longer, for the longest timeout is a day."""

_TICK_NS = nanoseconds(TICK)
_LONGEST_LEAP = 0.1


class RecordedClock(Clock):
    """Goes from instant to instant of a recording.

    The instants are whole ticks from its beginning, and those given to `stop_at`. So pauses, steps,
    jumps and speed change nothing that is decided at them. The `speed` is a factor of real time; 0
    = as fast as possible. `ticks` is -1 before the beginning; `target` is where a jump ends.
    """

    def __init__(
        self,
        begin_ns: int,
        end_ns: int,
        speed: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._begin_ns = begin_ns
        self.last_tick = max(1, -(-(end_ns - begin_ns) // _TICK_NS))
        self._monotonic, self._wait = monotonic, wait
        self._stops: tuple[int, ...] = ()
        self.paused = False
        self.target: int | None = None
        self._rewind()
        if (refused := self.set_speed(speed)) is not None:
            raise MadrobError(refused)

    def _rewind(self) -> None:
        self.ticks = -1
        self._now_ns = self._begin_ns
        self._next_stop = 0
        self._go_on_from_here()

    def _go_on_from_here(self) -> None:
        self._due = float(max(0, self.ticks))
        self._looked = self._monotonic()

    def stop_at(self, instants: Iterable[int]) -> None:
        """Adds instants that the clock stops at, ns since the epoch, in order."""
        self._stops = tuple(instants)

    # ------------------------------------------------------------------ for the engine

    def now_ns(self) -> int:
        return self._now_ns

    def sleep(self, duration: float) -> None:
        if self._is_due(duration):
            self._move()
        if self.target is not None and self.ticks >= self.target:
            self.target = None
            self._go_on_from_here()

    @property
    def ended(self) -> bool:
        return self.ticks >= self.last_tick

    def _is_due(self, timeout: float) -> bool:
        if self.ticks < 0:
            return True
        if self.target is not None:
            return self.ticks < self.target
        stands = self.paused or self.ended
        if not stands and (self.speed == 0 or self._due >= self.ticks + 1):
            return True
        self._wait(timeout)
        now = self._monotonic()
        passed = min(now - self._looked, _LONGEST_LEAP)  # a machine that slept skips nothing
        self._looked = now
        if not stands:
            self._due += passed * self.speed / TICK
        return self._due >= self.ticks + 1

    def _move(self) -> None:
        tick_ns = self._begin_ns + (self.ticks + 1) * _TICK_NS
        while self._next_stop < len(self._stops):
            stop_ns = self._stops[self._next_stop]
            if stop_ns >= tick_ns:
                break
            self._next_stop += 1
            if stop_ns > self._now_ns:
                self._now_ns = stop_ns
                return
        self._now_ns = tick_ns
        self.ticks += 1

    # ------------------------------------------------------------------ for who looks at it

    def play_or_pause(self) -> str | None:
        if self.ended:
            return "the recording is at its end: < goes back, j jumps to a time"
        self.paused = not self.paused
        self.target = None
        self._go_on_from_here()
        return None

    def set_speed(self, speed: float) -> str | None:
        if not 0 <= speed <= FASTEST:
            return f"replay speed {speed:g} is impossible: use 0 to {FASTEST:g}"
        self.speed = speed
        self._go_on_from_here()
        return None

    def skip(self, duration: float) -> str | None:
        if not abs(duration) < LONGEST:
            return "give a number of seconds"
        self.paused = True
        self.go_to((self.ticks if self.target is None else self.target) + round(duration / TICK))
        return None

    def go_to(self, ticks: int) -> None:
        """Jumps to a tick or the nearer end; an earlier tick needs a replay from the start."""
        self.target = min(max(0, ticks), self.last_tick)
        if self.target < self.ticks:
            self._rewind()
