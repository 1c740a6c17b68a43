"""The rate of a topic, and the share of its messages that is let through."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

from madrob_console.common.clock import NS

if TYPE_CHECKING:
    from recorder.bag import RawMessage


RATE_WINDOW = 5.0
"""Seconds over which rates are averaged."""

SILENT_AFTER = 2.0
"""Seconds without a message after which a steady topic is silent."""

_SHORTEST = 1.0
"""The shortest time, s, over which a rate is averaged."""

_UNEVEN, _MORE = 1.0, 1.02
"""How early a message may come, s, and by what factor a topic may exceed its limit."""


class SilenceWatch:
    """Notices when a steady topic stops; an irregular topic may be silent.

    A topic is steady after `SILENT_AFTER` without as long a silence. Times are steady ones
    (protocol section 8), ns since the epoch. A topic `named` in the settings may never be silent.
    """

    def __init__(self, *, named: bool = False) -> None:
        self._named = named
        self._listens: int | None = None
        self._first: int | None = None  # message since the last silence
        self._last = 0
        self._steady = False

    def listen(self, at_ns: int) -> None:
        self._listens = at_ns if self._listens is None else self._listens

    def came(self, at_ns: int) -> None:
        if self._first is None or at_ns - self._last > SILENT_AFTER * NS:
            self._first = at_ns
        self._last = at_ns
        self._steady |= at_ns - self._first >= SILENT_AFTER * NS

    def problem(self, now_ns: int) -> str:
        if not self._named or self._first is not None or self._listens is None:
            return ""
        return "nothing has come" if now_ns - self._listens > SILENT_AFTER * NS else ""

    def silent_since(self, now_ns: int) -> float | None:
        """The last message of a steady topic on which nothing comes now, s since the epoch."""
        silent = self._steady and now_ns - self._last > SILENT_AFTER * NS
        return self._last / NS if silent else None


class RateLimit:
    """Thins a topic evenly to so many messages a second; a slower topic passes whole.

    Cameras are neither even nor exact: a message may be up to half of `_UNEVEN` off its time, at a
    rate up to `_MORE` of the limit.
    """

    def __init__(self, most_rate: float | None) -> None:
        self._interval = 0 if most_rate is None else round(NS / (most_rate * _MORE))
        self._due: int | None = None

    def passes(self, at_ns: int) -> bool:
        early = 0 if self._due is None else self._due - at_ns
        if early > _UNEVEN * NS + self._interval:
            early = 0  # the clock went back: it all begins anew
        if early > _UNEVEN * NS:
            return False
        self._due = at_ns + max(0, early) + self._interval
        return True


class FlowMeter:
    """Messages and bytes a second over the last `RATE_WINDOW`; times in monotonic s."""

    def __init__(self, now: float) -> None:
        self._since = now
        self._passed: deque[tuple[float, int]] = deque()
        self._bytes = 0

    def count(self, messages: Iterable[RawMessage], now: float) -> None:
        for message in messages:
            self._passed.append((now, len(message.data)))
            self._bytes += len(message.data)
        self._forget(now)

    def rates(self, now: float) -> tuple[float, float]:
        self._forget(now)
        span = max(_SHORTEST, min(RATE_WINDOW, now - self._since))
        return len(self._passed) / span, self._bytes / span

    def _forget(self, now: float) -> None:
        while self._passed and self._passed[0][0] < now - RATE_WINDOW:
            self._bytes -= self._passed.popleft()[1]
