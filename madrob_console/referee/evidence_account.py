"""What was recorded of the evidence of a run, and what was lost of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from madrob_console.amounts import counted, listed


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
class RecordedTopic:
    """One topic of the evidence of a run.

    Attributes:
        topic, type: its names.
        messages, bytes: recorded.
        left_out: messages that the settings leave out on purpose, by their rate.
        lost: messages that were lost, by reason.
        problem: what was wrong with it, in words; empty = nothing.
    """

    topic: str
    type: str
    messages: int = 0
    bytes: int = 0
    left_out: int = 0
    lost: dict[EvidenceLoss, int] = field(default_factory=dict)
    problem: str = ""

    @property
    def lost_words(self) -> str:
        """How many were lost and why; empty = none."""
        reasons = ", ".join(f"{number} {why}" for why, number in self.lost.items() if number)
        return f"{sum(self.lost.values())} lost ({reasons})" if reasons else ""

    @property
    def left_out_words(self) -> str:
        """How many were left out by which setting; empty = none."""
        return f"{self.left_out} left out by `recording.limits`" if self.left_out else ""

    @property
    def troubles(self) -> str:
        """What is wrong with it, without numbers; empty = nothing."""
        reasons = ", ".join(why for why, number in self.lost.items() if number)
        lost = f"messages are lost ({reasons})" if reasons else ""
        return ", ".join(filter(None, (lost, self.problem)))


def _as_found(told: RecordedTopic, found: int) -> RecordedTopic:
    """A topic of which so many messages are in the files; the others are lost, their bytes, too."""
    if found == told.messages:
        return told
    lost = dict(told.lost)
    if found < told.messages:
        lost[EvidenceLoss.DISK] = lost.get(EvidenceLoss.DISK, 0) + told.messages - found
    size = told.bytes * found // max(1, told.messages)
    return replace(told, messages=found, bytes=size, lost=lost)


@dataclass(frozen=True, slots=True)
class EvidenceAccount:
    """The evidence of a run, as of the end of its recording. Nothing is scored from it.

    Attributes:
        topics: by name.
        problems: what was wrong with all of it, in words.
        unwritten: how many of the messages were not in the file yet; null = nobody knows, their
            process was ended; 0 = all are there.
    """

    topics: tuple[RecordedTopic, ...] = ()
    problems: tuple[str, ...] = ()
    unwritten: int | None = 0

    @property
    def words(self) -> str:
        """How much was recorded."""
        messages = sum(one.messages for one in self.topics)
        size = sum(one.bytes for one in self.topics) / 1e6
        lost = sum(sum(one.lost.values()) for one in self.topics)
        missing = f", {lost} lost" if lost else ""
        topics, came = counted(len(self.topics), "topic"), counted(messages, "message")
        return f"{topics}, {came}, {size:.1f} MB{missing}{self._rest}"

    @property
    def _rest(self) -> str:
        """What nobody knows yet, in words; empty = nothing."""
        if self.unwritten is None:
            return ", not known how many of them are on disk"
        return f", {self.unwritten} of them still being written" if self.unwritten else ""

    def settled(
        self, counts: Mapping[str, tuple[str, int]], problems: Iterable[str] = ()
    ) -> EvidenceAccount:
        """The account of what is in the files; what is not there did not reach the disk.

        Args:
            counts: type and number of messages, by topic, in all files together.
            problems: what is wrong with the files, in words.
        """
        told = {one.topic: one for one in self.topics}
        for topic, (type_name, _) in counts.items():
            told.setdefault(topic, RecordedTopic(topic, type_name))
        topics = (_as_found(told[name], counts.get(name, ("", 0))[1]) for name in sorted(told))
        return EvidenceAccount(tuple(topics), (*self.problems, *problems))

    def remarks(self) -> list[str]:
        """What is missing, in words; empty where nothing is."""
        remarks = list(self.problems)
        for one in self.topics:
            words = ", ".join(filter(None, (one.lost_words, one.left_out_words, one.problem)))
            if words:
                remarks.append(f"{one.topic}: {words}")
        return remarks


def unseen_words(patterns: Sequence[str]) -> str:
    """That nobody publishes what patterns of the settings ask for."""
    return f"nobody publishes {listed(patterns)}"


NO_EVIDENCE = EvidenceAccount()
"""Nothing was recorded, and nothing was wrong."""
