"""Messages that wait to be shown and judged.

A message is recorded as soon as it is taken. Looking at it takes time, so acts have their turn
between two messages.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from madrob_console.common.clock import seconds
from recorder.bag import RawMessage

LATEST = 0.5
"""A message that has waited longer than this is not shown, s."""

CAPACITY = 32 * 1024 * 1024
"""Bytes that wait; the source keeps the rest and counts what it cannot keep."""

_LONGEST_WORK = 0.02
"""Then the owner has a turn, s."""

_REPORTED = 2.0
"""Left-out messages are reported this long, s: also those that happened only once."""

Interrupt = Callable[[], bool]


class Observe(Protocol):
    """Processes a message: `Observation.receive`."""

    def __call__(self, message: RawMessage, *, recorded: bool, shown: bool) -> None: ...


class Backlog:
    """Messages that are not processed yet, oldest first.

    Recorded messages are always processed, `recorded` counts those that wait: the result is made
    from all that the bag holds. Late ones are left out of what is shown, which is reported.
    """

    def __init__(self, observe: Observe, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._observe = observe
        self._monotonic = monotonic
        self._waiting: deque[tuple[float, bool, RawMessage]] = deque()
        self._bytes = 0
        self.recorded = 0
        self._left_out = 0
        self._left_out_at: float | None = None
        self._pause, self._pause_at = 0.0, -math.inf

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def full(self) -> bool:
        return self._bytes >= CAPACITY

    @property
    def behind(self) -> float:
        """How long the oldest has waited, s."""
        return self._monotonic() - self._waiting[0][0] if self._waiting else 0.0

    def judged_until(self, now: float) -> float:
        """Time up to which all messages were processed, s since the epoch; `now` if none waits."""
        return min(now, seconds(self._waiting[0][2].receive_ns)) if self._waiting else now

    def note_pause(self, pause: float) -> None:
        """Note the time between two looks at the source, s."""
        if pause > LATEST:
            self._pause, self._pause_at = pause, self._monotonic()

    @property
    def problem(self) -> str | None:
        if self._monotonic() - self._pause_at <= _REPORTED:
            return f"the engine stood still for {self._pause:.1f} s"
        behind, at = self.behind, self._left_out_at
        if behind <= LATEST and (at is None or self._monotonic() - at > _REPORTED):
            self._left_out = 0
            return None
        left_out = f"{self._left_out} messages are recorded but not shown"
        return f"the engine is {behind:.1f} s behind: {left_out}"

    def add_messages(self, messages: Sequence[RawMessage], *, recorded: bool) -> None:
        now = self._monotonic()
        for message in messages:
            self._waiting.append((now, recorded, message))
            self._bytes += len(message.data)
        self.recorded += len(messages) if recorded else 0

    def work_off(self, interrupt: Interrupt | None = None) -> None:
        """Process what waits; `interrupt` is asked after each message, without it none is late."""
        now = begin = self._monotonic()
        while self._waiting:
            taken, recorded, message = self._waiting.popleft()
            self._bytes -= len(message.data)
            self.recorded -= recorded
            late = interrupt is not None and now - taken > LATEST
            if late:
                self._left_out += 1
                self._left_out_at = now
            self._observe(message, recorded=recorded, shown=not late)
            if interrupt is not None:
                now = self._monotonic()
                if now - begin > _LONGEST_WORK or interrupt():
                    return
