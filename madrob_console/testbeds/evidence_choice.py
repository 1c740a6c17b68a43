"""Which topics are recorded as evidence."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from itertools import pairwise

import msgspec

TOPIC_PATTERN = r"(/([A-Za-z0-9_]|\*)+)+"
"""Regular expression of a full topic name with wildcards."""


class TopicLimit(msgspec.Struct, frozen=True):
    """Limits for recording the topics that match a pattern.

    `most_rate` is in messages a second of each topic, None = all; messages beyond it do not count
    as lost.
    """

    topics: str
    most_rate: float | None = None


NO_LIMIT = TopicLimit("/**")


class EvidenceChoice(msgspec.Struct, frozen=True):
    """Topic patterns of the evidence; the first matching limit applies, `largest` is in bytes."""

    topics: tuple[str, ...] = ()
    excluded: tuple[str, ...] = ()
    limits: tuple[TopicLimit, ...] = ()
    largest: int = 32_000_000

    def wants(self, topic: str) -> bool:
        return any(matches(p, topic) for p in self.topics) and not any(
            matches(p, topic) for p in self.excluded
        )

    def unmatched(self, topics: Collection[str]) -> tuple[str, ...]:
        return tuple(p for p in self.topics if not any(matches(p, topic) for topic in topics))

    def limit(self, topic: str) -> TopicLimit:
        return next((each for each in self.limits if matches(each.topics, topic)), NO_LIMIT)


def matches(pattern: str, topic: str) -> bool:
    """Whether a full topic name matches a pattern.

    `*` stands for any characters between two slashes. `**` stands for any number of parts, at the
    end for at least one. Neither matches the underscore that begins a hidden topic's part.
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
