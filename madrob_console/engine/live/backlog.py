"""Messages on their way from the testbed to what is shown and judged.

A message is recorded as soon as it is taken. Looking at it takes time, by what it holds and by how
many there are; between two of them acts are looked at, too.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from madrob_console.clock import seconds
from recorder.message import RawMessage

LATEST = 0.5
"""What has waited longer than this is not shown any more, s."""

CAPACITY = 32 * 1024 * 1024
"""Bytes that wait; more are left to the source, which counts what it cannot keep."""

_LONGEST_WORK = 0.02
"""Then its owner has a turn, s."""

_TOLD = 2.0
"""What was left out is told for so long, s: also what happened only once."""

Interrupt = Callable[[], bool]
"""Whether somebody else wants a turn now."""


class Observe(Protocol):
    """What looks at a message: `Observation.receive`."""

    def __call__(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        """See `Observation`."""
        ...


class Backlog:
    """Messages that are taken and not looked at yet, oldest first.

    What is recorded is always looked at: the result is made from all that the bag holds. What is
    late is left out of what is shown, and said.

    Args:
        observe: looks at one.
        monotonic: a clock of the machine's, s.
    """

    def __init__(self, observe: Observe, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._observe = observe
        self._monotonic = monotonic
        self._waiting: deque[tuple[float, bool, RawMessage]] = deque()
        self._bytes = 0
        self._recorded = 0
        self._left_out = 0
        self._left_out_at: float | None = None

    def __len__(self) -> int:
        """How many wait."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """Whether it should take no more."""
        return self._bytes >= CAPACITY

    @property
    def recorded(self) -> int:
        """How many of them are in the bag."""
        return self._recorded

    @property
    def behind(self) -> float:
        """How long the oldest has waited, s."""
        return self._monotonic() - self._waiting[0][0] if self._waiting else 0.0

    def seen(self, now: float) -> float:
        """Up to when all that came was looked at, s since the epoch; `now` where nothing waits."""
        return min(now, seconds(self._waiting[0][2].receive_ns)) if self._waiting else now

    @property
    def problem(self) -> str | None:
        """That what is shown lacks something, in words; None when all of it is there."""
        behind, at = self.behind, self._left_out_at
        if behind <= LATEST and (at is None or self._monotonic() - at > _TOLD):
            self._left_out = 0
            return None
        return (
            f"more comes than can be looked at: {behind:.1f} s behind, {self._left_out} messages "
            "are not shown; what is recorded and the result have them"
        )

    def add(self, messages: Sequence[RawMessage], *, recorded: bool) -> None:
        """Messages were taken.

        Args:
            messages: oldest first.
            recorded: whether they are in the bag.
        """
        now = self._monotonic()
        for message in messages:
            self._waiting.append((now, recorded, message))
            self._bytes += len(message.data)
        self._recorded += len(messages) if recorded else 0

    def work_off(self, interrupt: Interrupt | None = None) -> None:
        """Look at what waits.

        Args:
            interrupt: asked after each message; None = go through to the end, and nothing is late.
        """
        now = begin = self._monotonic()
        while self._waiting:
            taken, recorded, message = self._waiting.popleft()
            self._bytes -= len(message.data)
            self._recorded -= recorded
            late = interrupt is not None and now - taken > LATEST
            if late:
                self._left_out += 1
                self._left_out_at = now
            self._observe(message, recorded=recorded, shown=not late)
            if interrupt is not None:
                now = self._monotonic()
                if now - begin > _LONGEST_WORK or interrupt():
                    return
