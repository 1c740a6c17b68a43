"""What a recorder tells about itself."""

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
    """Not opened yet."""
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
    """A recorder at one instant.

    Attributes:
        state: its life.
        written: messages in the file.
        received: messages handed to `put`, per topic.
        dropped: those of them that are not and will not be in the bag, per topic.
        drop_reasons: the same, per reason.
        queued_bytes: memory of the messages on their way to the file.
        file_bytes: size of the recording.
        seconds_since_sync: since everything received had reached the disk; None before `open`.
        error: why the recording failed, with the remedy; else None.
    """

    state: RecorderState
    written: int
    received: Mapping[str, int]
    dropped: Mapping[str, int]
    drop_reasons: Mapping[DropReason, int]
    queued_bytes: int
    file_bytes: int
    seconds_since_sync: float | None
    error: str | None


@dataclass(frozen=True, slots=True)
class BagSummary:
    """What became of a recording.

    Attributes:
        folder: the bag.
        counts: messages in the file, per registered topic.
        dropped: messages handed in that are not in the file, per topic.
        start_ns: earliest log time, ns since the epoch; None without messages.
        end_ns: latest log time, ns since the epoch; None without messages.
        file_bytes: size of the recording.
        error: why the bag is unfinished, with the remedy; None when it is finished.
    """

    folder: Path
    counts: Mapping[str, int]
    dropped: Mapping[str, int]
    start_ns: int | None
    end_ns: int | None
    file_bytes: int
    error: str | None


class Account:
    """Where every message handed in has gone: received = saved + dropped + on its way."""

    def __init__(self) -> None:
        self.received: Counter[str] = Counter()
        self.saved: Counter[str] = Counter()
        self._dropped: Counter[tuple[str, DropReason]] = Counter()

    def drop(self, topic: str, reason: DropReason) -> None:
        """Count a message that will not be in the bag."""
        self._dropped[topic, reason] += 1

    def drop_rest(self) -> None:
        """Count all that is on its way as lost to a failure."""
        rest = self.received - self.saved - self.dropped()
        self._dropped.update({(topic, DropReason.FAILED): n for topic, n in rest.items()})

    def dropped(self) -> Counter[str]:
        """Dropped messages per topic."""
        return self._sum(0)

    def reasons(self) -> Counter[DropReason]:
        """Dropped messages per reason."""
        return self._sum(1)

    def _sum(self, part: int) -> Counter[Any]:
        total: Counter[Any] = Counter()
        for key, count in self._dropped.items():
            total[key[part]] += count
        return total
