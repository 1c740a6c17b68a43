"""What was recorded beside the run, as recorder, journal, screen and result have it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from madrob_console.common.formatting import counted, time_of_day


@dataclass(frozen=True, slots=True)
class EvidenceTopic:
    """One topic that was recorded beside the run.

    Attributes:
        recorded: messages in the bag.
        lost: messages that are not in it, as far as is known.
        silent_since: when the last message came, or the recording began without one, s since the
            epoch; null = messages come.
    """

    recorded: int = 0
    lost: int = 0
    silent_since: float | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """What was recorded beside the run, cameras and other topics; nothing is scored from it.

    Attributes:
        topics: by name.
        problem: why nothing, or not everything, is recorded now, in words; empty = all is.
    """

    topics: dict[str, EvidenceTopic] = field(default_factory=dict)
    problem: str = ""

    @property
    def words(self) -> str:
        recorded = sum(topic.recorded for topic in self.topics.values())
        lost = sum(topic.lost for topic in self.topics.values())
        words = f"{counted(len(self.topics), 'topic')}, {counted(recorded, 'message')}"
        return f"{words}, {lost} lost" if lost else words

    def remarks(self, start: float | None) -> Iterator[str]:
        """Say what is wrong with it, a line each.

        Times count from the `start` of the run, s since the epoch; without it they are of the day.
        """
        if self.problem:
            yield self.problem
        for name, topic in self.topics.items():
            if topic.lost:
                yield f"{name}: {counted(topic.lost, 'message')} lost"
            since = topic.silent_since
            if since is not None:
                at = time_of_day(since) if start is None else f"{since - start:+.1f} s"
                yield f"{name}: silent since {at}"

    def added_to(self, earlier: Evidence) -> Evidence:
        """Return this with the counts of an earlier recording of the same run."""
        topics = dict(earlier.topics)
        for name, topic in self.topics.items():
            before = topics.get(name, EvidenceTopic())
            recorded = before.recorded + topic.recorded
            topics[name] = EvidenceTopic(recorded, before.lost + topic.lost, topic.silent_since)
        return Evidence(topics, self.problem)
