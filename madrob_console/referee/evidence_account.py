"""The account of the evidence of a run: what was recorded of each topic, and what was lost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from madrob_console.common.formatting import counted


class EvidenceLoss(StrEnum):
    """Why a message of the evidence is not in the recording."""

    ON_THE_WAY = "on the way"
    """ROS did not deliver it."""
    BEHIND = "behind"
    """More came than disk or processor took."""
    TOO_LARGE = "too large"
    """Larger than the settings allow."""
    DISK = "disk"
    """The disk refused it or had no room left for evidence, or its process ended before."""


@dataclass(frozen=True, slots=True)
class EvidenceGap:
    """A time without any evidence.

    Attributes:
        begin: the last message before it, s since the start of the run; while it is recorded, s
            since the epoch.
        end: likewise, the first message after it; null = it went on to the end.
        why: in words.
    """

    begin: float
    end: float | None
    why: str

    def since(self, start: float) -> EvidenceGap:
        """The gap in s since the run's start, given as s since the epoch."""
        end = None if self.end is None else round(self.end - start, 2)
        return replace(self, begin=round(self.begin - start, 2), end=end)

    @property
    def words(self) -> str:
        end = "the end" if self.end is None else f"{self.end:+.1f} s"
        return f"from {self.begin:+.1f} s to {end}"


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """One topic of the evidence of a run.

    Attributes:
        topic, type: its names.
        messages, bytes: recorded; bytes are null where nobody has told them.
        left_out: messages that the settings leave out on purpose, by their rate.
        lost: messages that were lost, by reason.
        problem: what was wrong with it, in words; empty = nothing.
    """

    topic: str
    type: str
    messages: int = 0
    bytes: int | None = 0
    left_out: int = 0
    lost: dict[EvidenceLoss, int] = field(default_factory=dict)
    problem: str = ""

    @property
    def lost_count(self) -> int:
        return sum(self.lost.values())

    @property
    def lost_words(self) -> str:
        reasons = ", ".join(f"{number} {why}" for why, number in self.lost.items() if number)
        return f"{self.lost_count} lost ({reasons})" if reasons else ""

    @property
    def left_out_words(self) -> str:
        return f"{self.left_out} left out by `recording.limits`" if self.left_out else ""

    @property
    def troubles(self) -> str:
        reasons = ", ".join(why for why, number in self.lost.items() if number)
        lost = f"messages are lost ({reasons})" if reasons else ""
        return ", ".join(filter(None, (lost, self.problem)))

    def with_count(self, number: int) -> RecordedTopic:
        """The topic with so many messages in the files; the others are lost."""
        if number == self.messages:
            return self
        lost = dict(self.lost)
        if number < self.messages:
            lost[EvidenceLoss.DISK] = lost.get(EvidenceLoss.DISK, 0) + self.messages - number
        size = self.bytes and self.bytes * number // max(1, self.messages)
        return replace(self, messages=number, bytes=size, lost=lost)


@dataclass(frozen=True, slots=True)
class EvidenceAccount:
    """The evidence of a run, as of the end of its recording. Nothing is scored from it.

    Attributes:
        topics: by name.
        problems: what was wrong with all of it, in words.
        unwritten: how many of the messages were not in the file yet; null = nobody knows, their
            process was ended; 0 = all are there.
        gaps: times without a recording; messages of these times are not counted.
        file_bytes: size of the files, where nobody has told what the topics have of it.
    """

    topics: tuple[RecordedTopic, ...] = ()
    problems: tuple[str, ...] = ()
    unwritten: int | None = 0
    gaps: tuple[EvidenceGap, ...] = ()
    file_bytes: int | None = None

    @property
    def words(self) -> str:
        messages = sum(topic.messages for topic in self.topics)
        size = (self.file_bytes or sum(topic.bytes or 0 for topic in self.topics)) / 1e6
        lost = sum(topic.lost_count for topic in self.topics)
        missing = f", {self._at_least}{lost} lost" if lost else ""
        if self.gaps:
            missing += f", missing {self.gap_words}"
        topics, came = counted(len(self.topics), "topic"), counted(messages, "message")
        return f"{topics}, {came}, {size:.1f} MB{missing}{self._rest}"

    @property
    def gap_words(self) -> str:
        more = f" and {counted(len(self.gaps) - 1, 'time')} more" if len(self.gaps) > 1 else ""
        return f"{self.gaps[0].words}{more}" if self.gaps else ""

    @property
    def _at_least(self) -> str:
        """A prefix of losses: messages during a gap are not counted."""
        return "at least " if self.gaps else ""

    @property
    def _rest(self) -> str:
        if self.unwritten is None:
            return ", not known how many of them are on disk"
        return f", {self.unwritten} of them still being written" if self.unwritten else ""

    def settled(
        self,
        counts: Mapping[str, tuple[str, int]],
        problems: Iterable[str] = (),
        file_bytes: int | None = None,
    ) -> EvidenceAccount:
        """The account of the messages in the files; others did not reach the disk.

        `counts` has type and number of messages by topic, in all files together.
        """
        reported = {topic.topic: topic for topic in self.topics}
        for name, (type_name, _) in counts.items():
            reported.setdefault(name, RecordedTopic(name, type_name, bytes=None))
        topics = tuple(
            reported[name].with_count(counts.get(name, ("", 0))[1]) for name in sorted(reported)
        )
        if all(topic.bytes is not None for topic in topics):
            file_bytes = None
        return EvidenceAccount(topics, (*self.problems, *problems), 0, self.gaps, file_bytes)

    def remarks(self) -> list[str]:
        remarks = list(self.problems)
        if len(self.gaps) > 1:  # `words` has a single one
            remarks.append(f"missing {', '.join(gap.words for gap in self.gaps)}")
        for topic in self.topics:
            lost = topic.lost_words and self._at_least + topic.lost_words
            words = ", ".join(filter(None, (lost, topic.left_out_words, topic.problem)))
            if words:
                remarks.append(f"{topic.topic}: {words}")
        return remarks


CUT_OFF = EvidenceAccount(
    problems=("the engine was ended before it could tell: what was lost is not known",),
    unwritten=None,
)
"""For a run with evidence files but no account."""
