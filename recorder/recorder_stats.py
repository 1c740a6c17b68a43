"""Statistics of a recorder: the fate of every message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class RecorderState(StrEnum):
    """The life of a recorder."""

    CLOSED = "closed"
    RECORDING = "recording"
    FAILED = "failed"
    """The disk refused; the bag is unfinished, what was written before stays readable."""
    FINISHED = "finished"


class DropReason(StrEnum):
    """Why a message is not in the bag."""

    NOT_RECORDING = "not recording"
    FAILED = "recording failed"
    QUEUE_FULL = "queue full"
    TOO_LARGE = "larger than the queue"
    UNKNOWN_TOPIC = "topic not registered"
    OTHER_TYPE = "type differs from the topic's"
    BAD_TIME = "time outside 1970..2262"


@dataclass(frozen=True, slots=True)
class RecorderStats:
    """A recorder at one instant; messages per topic.

    Attributes:
        counts: those in the file.
        dropped: those handed over that are not and will not be in the bag.
        queued_bytes: memory of the messages on their way to the file.
        seconds_since_sync: since everything received had reached the disk; None before `open`.
        start_ns, end_ns: first and last log time in the file, ns since the epoch; None without.
        error: why the recording failed, or evidence was refused, with the remedy.
    """

    folder: Path
    state: RecorderState
    counts: Mapping[str, int]
    received: Mapping[str, int]
    dropped: Mapping[str, int]
    drop_reasons: Mapping[DropReason, int]
    queued_bytes: int
    file_bytes: int
    seconds_since_sync: float | None
    start_ns: int | None
    end_ns: int | None
    error: str | None

    @property
    def written(self) -> int:
        return sum(self.counts.values())


def missing_words(stats: RecorderStats) -> str:
    """Which messages are not in the bag, and why; empty if all are."""
    missing = ", ".join(f"{topic} {n}" for topic, n in sorted(stats.dropped.items()) if n)
    reasons = ", ".join(reason.value for reason in stats.drop_reasons)
    return missing and f"{stats.folder}: messages are not in the bag: {missing} ({reasons})"


class Account:
    """The fate of every message handed in: received = saved + dropped + on its way."""

    def __init__(self) -> None:
        self.received: Counter[str] = Counter()
        self.saved: Counter[str] = Counter()
        self._dropped: Counter[tuple[str, DropReason]] = Counter()

    def drop(self, topic: str, reason: DropReason) -> None:
        self._dropped[topic, reason] += 1

    def drop_rest(self) -> None:
        rest = self.received - self.saved - self.dropped()
        self._dropped.update({(topic, DropReason.FAILED): n for topic, n in rest.items()})

    def dropped(self) -> Counter[str]:
        return self._sum(0)

    def reasons(self) -> Counter[DropReason]:
        return self._sum(1)

    def _sum(self, part: int) -> Counter[Any]:
        total: Counter[Any] = Counter()
        for key, count in self._dropped.items():
            total[key[part]] += count
        return total
