"""How much of a topic comes, and how much of it is let through."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from madrob_console.clock import NS
from recorder.message import RawMessage

RATE_WINDOW = 5.0
"""Over so long rates are told, s."""

_SHORTEST = 1.0
"""What has come for less than this is told as if it were spread over it, s."""


@dataclass(frozen=True, slots=True)
class TopicFlow:
    """What comes on a topic.

    Attributes:
        topic, type: its names.
        publishers: how many are matched.
        rate: messages a second of those that are recorded.
        byte_rate: bytes a second of them.
        lost: messages that were lost on the way to here since it is listened to.
        problem: what is wrong with it, in words; empty = nothing.
    """

    topic: str
    type: str
    publishers: int
    rate: float
    byte_rate: float
    lost: int
    problem: str = ""


class Thinning:
    """Lets so many messages a second pass, evenly.

    Args:
        most_rate: messages a second; None = all.
    """

    def __init__(self, most_rate: float | None) -> None:
        self._interval = 0 if most_rate is None else round(NS / most_rate)
        self._due: int | None = None

    def passes(self, at_ns: int) -> bool:
        """Whether a message that arrived then, ns, is one of them."""
        late = self._interval if self._due is None else at_ns - self._due
        if -self._interval <= late < 0:
            return False
        # a bit late: the next is due as if it had been in time; after a pause, or where the clock
        # went back, it all begins anew
        on_time = 0 <= late < self._interval
        self._due = (at_ns - late if on_time else at_ns) + self._interval
        return True


class FlowMeter:
    """Messages and bytes a second over the last `RATE_WINDOW`.

    Args:
        now: s of a monotonic clock, as in all calls.
    """

    def __init__(self, now: float) -> None:
        self._since = now
        self._passed: deque[tuple[float, int]] = deque()
        self._bytes = 0

    def count(self, messages: Iterable[RawMessage], now: float) -> None:
        """These have come."""
        for message in messages:
            self._passed.append((now, len(message.data)))
            self._bytes += len(message.data)
        self._forget(now)

    def rates(self, now: float) -> tuple[float, float]:
        """Messages and bytes a second."""
        self._forget(now)
        span = max(_SHORTEST, min(RATE_WINDOW, now - self._since))
        return len(self._passed) / span, self._bytes / span

    def _forget(self, now: float) -> None:
        while self._passed and self._passed[0][0] < now - RATE_WINDOW:
            self._bytes -= self._passed.popleft()[1]
