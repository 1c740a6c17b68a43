"""What was recorded of the evidence of a run, and what was lost of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class EvidenceLoss(StrEnum):
    """Why a message of the evidence is not in the recording."""

    ON_THE_WAY = "on the way"
    """ROS did not deliver it."""
    BEHIND = "behind"
    """More came than disk or processor took."""
    TOO_LARGE = "too large"
    """Larger than the settings allow."""
    DISK = "disk"
    """The disk refused it, or had no room left for evidence."""


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
    def troubles(self) -> str:
        """What is wrong with it, without numbers; empty = nothing."""
        reasons = ", ".join(why for why, number in self.lost.items() if number)
        lost = f"messages are lost ({reasons})" if reasons else ""
        return ", ".join(filter(None, (lost, self.problem)))


@dataclass(frozen=True, slots=True)
class EvidenceAccount:
    """The evidence of a run, as of the end of its recording. Nothing is scored from it.

    Attributes:
        topics: by name.
        problems: what was wrong with all of it, in words.
    """

    topics: tuple[RecordedTopic, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """How much was recorded."""
        messages = sum(one.messages for one in self.topics)
        size = sum(one.bytes for one in self.topics) / 1e6
        lost = sum(sum(one.lost.values()) for one in self.topics)
        missing = f", {lost} lost" if lost else ""
        return f"{len(self.topics)} topics, {messages} messages, {size:.1f} MB{missing}"

    def remarks(self) -> list[str]:
        """What is missing, in words; empty where nothing is."""
        remarks = list(self.problems)
        for one in self.topics:
            words = ", ".join(filter(None, (one.lost_words, one.problem)))
            if words:
                remarks.append(f"{one.topic}: {words}")
        return remarks


NO_EVIDENCE = EvidenceAccount()
"""Nothing was recorded, and nothing was wrong."""
