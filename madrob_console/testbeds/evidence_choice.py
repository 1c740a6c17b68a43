"""Which topics are recorded as evidence, and how many of their messages."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import msgspec

from madrob_console.common.clock import NS
from recorder.bag import RawMessage

TOPIC_PATTERN = r"(/([A-Za-z0-9_]|\*)+)+"
"""Of a full topic name with wildcards."""


class TopicLimit(msgspec.Struct, frozen=True):
    """What is recorded of some topics.

    Attributes:
        topics: their pattern; see `matches`.
        most_rate: messages a second of each of them; None = all. What is beyond is no loss.
        priority: where not everything can be recorded, the topics with the higher one are.
    """

    topics: str
    most_rate: float | None = None
    priority: int = 0


NO_LIMIT = TopicLimit("/**")
"""Holds for topics of which nothing is said."""


class EvidenceChoice(msgspec.Struct, frozen=True):
    """What the hall wants as evidence.

    Attributes:
        topics: patterns of the topics that are recorded.
        excluded: patterns of those that are not, although they match.
        limits: the first one that matches a topic holds for it.
        largest: a larger message is not recorded, bytes.
    """

    topics: tuple[str, ...] = ()
    excluded: tuple[str, ...] = ()
    limits: tuple[TopicLimit, ...] = ()
    largest: int = 32_000_000

    def wants(self, topic: str) -> bool:
        """Whether a topic is recorded."""
        return any(matches(p, topic) for p in self.topics) and not any(
            matches(p, topic) for p in self.excluded
        )

    def unmatched(self, topics: Collection[str]) -> tuple[str, ...]:
        """The patterns of wanted topics that none of these matches."""
        return tuple(p for p in self.topics if not any(matches(p, topic) for topic in topics))

    def limit(self, topic: str) -> TopicLimit:
        """What holds for a topic."""
        return next((each for each in self.limits if matches(each.topics, topic)), NO_LIMIT)


def matches(pattern: str, topic: str) -> bool:
    """Whether a full topic name matches a pattern.

    `*` stands for any characters between two slashes, `**` for any number of parts, at the end for
    one at least. Neither stands for the underscore that begins a part: such topics are hidden in
    ROS, and have to be named.
    """
    return _compiled(pattern).fullmatch(topic) is not None


@cache
def _compiled(pattern: str) -> re.Pattern[str]:
    parts = pattern.split("/")[1:]
    parts = [p for p, following in pairwise((*parts, "")) if not p == following == "**"]
    text = ""
    for number, part in enumerate(parts):
        if part == "**":
            text += r"(/(?!_)[^/]+)" + ("+" if number == len(parts) - 1 else "*")
            continue
        hidden = "(?!_)" if part.startswith("*") else ""
        text += "/" + hidden + re.sub(r"\*+", "[^/]*", re.escape(part).replace(r"\*", "*"))
        if set(part) == {"*"}:
            text = text.removesuffix("*") + "+"
    return re.compile(text)


# How much of a topic comes, and how much of it is let through.


RATE_WINDOW = 5.0
"""Over so long rates are told, s."""

SILENT_AFTER = 2.0
"""A topic that came steadily is silent when nothing has come for longer, s."""

MOST_PAUSES = 20
"""Of a topic in one recording, told one by one."""

_SHORTEST = 1.0
"""What has come for less than this is told as if it were spread over it, s."""

_UNEVEN, _MORE = 1.0, 1.02
"""So much earlier than at even distances a message may come, s, and so much faster a topic may be
than its limit."""


@dataclass(frozen=True, slots=True)
class TopicPause:
    """A time in which nothing came on a topic that came steadily.

    Attributes:
        begin_ns, end_ns: its last message before and its first one after, steady ns; null = none
            has come yet.
        number: how many pauses these are, with some messages between them.
    """

    begin_ns: int
    end_ns: int | None = None
    number: int = 1


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
        kept: whether its publishers keep for late joiners what they said: it need not come again.
        pauses: of this recording, the last one may go on.
    """

    topic: str
    type: str
    publishers: int
    rate: float
    byte_rate: float
    lost: int
    problem: str = ""
    kept: bool = False
    pauses: tuple[TopicPause, ...] = ()

    @property
    def silent(self) -> bool:
        """Whether nothing comes now that should."""
        return not self.publishers or not (self.rate or self.kept)


class SilenceWatch:
    """Notices when a topic that came steadily stops; what comes now and then may be silent.

    Steady is what has come for `SILENT_AFTER` without as long a pause. Times are steady ones
    (protocol section 8), ns since the epoch.

    Args:
        named: whether the settings name the topic itself: then it may not be silent from the first.
    """

    def __init__(self, *, named: bool = False) -> None:
        self._named = named
        self._listens: int | None = None
        self._first: int | None = None  # of what came without a pause
        self._last = 0
        self._steady = False
        self._pauses: list[TopicPause] = []

    def listen(self, at_ns: int) -> None:
        """It is listened to, from the first call on."""
        self._listens = at_ns if self._listens is None else self._listens

    def begin(self) -> None:
        """A recording begins: what was before is none of it."""
        self._pauses.clear()

    def came(self, at_ns: int) -> None:
        """A message has come."""
        if self._first is None:
            self._first = at_ns
        elif at_ns - self._last > SILENT_AFTER * NS:
            if self._steady:
                self._pauses = [*self._with(self._last, at_ns)]
            self._first = at_ns
        self._last = at_ns
        self._steady |= at_ns - self._first >= SILENT_AFTER * NS

    def problem(self, now_ns: int) -> str:
        """That nothing has come at all, in words; empty = something has, or need not."""
        if not self._named or self._first is not None or self._listens is None:
            return ""
        return "nothing has come" if now_ns - self._listens > SILENT_AFTER * NS else ""

    def pauses(self, now_ns: int) -> tuple[TopicPause, ...]:
        """The silences since `begin`, and the one that goes on."""
        if self._steady and now_ns - self._last > SILENT_AFTER * NS:
            return self._with(self._last, None)
        return tuple(self._pauses)

    def _with(self, begin_ns: int, end_ns: int | None) -> tuple[TopicPause, ...]:
        """One more silence; the last one that is told has all that came later."""
        if len(self._pauses) < MOST_PAUSES:
            return *self._pauses, TopicPause(begin_ns, end_ns)
        *before, last = self._pauses
        return *before, replace(last, end_ns=end_ns, number=last.number + 1)


class RateLimit:
    """Lets so many messages a second pass, evenly, and all of a topic that is no faster.

    Messages come neither evenly nor exactly as often as a camera is set to: one that is up to half
    of `_UNEVEN` off its time, at a rate up to `_MORE` of the limit, is no message too many.

    Args:
        most_rate: messages a second; None = all.
    """

    def __init__(self, most_rate: float | None) -> None:
        self._interval = 0 if most_rate is None else round(NS / (most_rate * _MORE))
        self._due: int | None = None

    def passes(self, at_ns: int) -> bool:
        """Whether a message that arrived then, ns, is one of them."""
        early = 0 if self._due is None else self._due - at_ns
        if early > _UNEVEN * NS + self._interval:
            early = 0  # the clock went back: it all begins anew
        if early > _UNEVEN * NS:
            return False
        self._due = at_ns + max(0, early) + self._interval
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
