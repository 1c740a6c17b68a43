"""Which topics are recorded as evidence, how many of their messages, and which of them first."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from itertools import pairwise

import msgspec

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
