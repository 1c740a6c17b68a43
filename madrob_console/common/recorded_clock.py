"""The clock of a recording: it stands, steps, jumps and runs at any speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from madrob_console.common.clock import Clock, nanoseconds
from madrob_console.common.errors import MadrobError

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
