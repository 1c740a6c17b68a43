"""Surveys a recording for repair."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from recorder.bag import BagInformation, RawMessage, Topic
from recorder.catalogue import Catalogue
from recorder.errors import RecorderError
from recorder.mcap_reader import DamageError, ForeignError, Gap, read_summary
from recorder.reader import end_of, left_out, read_items

_GAPS_TOLD = 3

_LARGEST_END = 100_000_000
"""A kill cuts one record, of no more bytes: a longer unreadable end is damage."""


@dataclass(slots=True)
class Survey:
    """What reading a file showed; log times in ns since the epoch, None without messages.

    Attributes:
        cut: what is wrong with it, in its order; empty if it is whole.
        lost: the part of that for a reader of the bag; None if every message is there.
        tail_bytes: bytes behind the last whole record.
        gaps: chunks that cannot be read while what follows them can.
    """

    path: Path
    topics: dict[str, Topic] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    cut: list[str] = field(default_factory=list)
    lost: str | None = None
    tail_bytes: int = 0
    gaps: int = 0

    @classmethod
    def of(cls, file: BinaryIO, path: Path) -> Survey:
        """Read a file to its end, whole or torn; RecorderError if no bag can hold its topics."""
        survey = cls(path)
        survey._read(file)
        if survey.gaps > _GAPS_TOLD:
            survey.cut.append(f"{survey.gaps - _GAPS_TOLD} more chunks are left out")
        if not survey.cut:
            survey._check_summary(file)
        return survey

    @property
    def messages(self) -> int:
        return sum(self.counts.values())

    @property
    def only_cut_off(self) -> bool:
        """Whether it lacks only its end: what was being written, and the summary."""
        return not self.gaps and self.tail_bytes <= _LARGEST_END

    def information(self) -> BagInformation:
        topics = list(self.topics.values())
        return BagInformation(self.path.name, topics, self.counts, self.start_ns, self.end_ns)

    def _read(self, file: BinaryIO) -> None:
        try:
            for item in read_items(file):
                match item:
                    case RawMessage():
                        self._count(item)
                    case Topic():
                        self._register(item)
                    case Gap():
                        if item.foreign:
                            raise RecorderError(f"{self.path}: {item.reason}; it is left as it is")
                        self.gaps += 1
                        self.lost = self.lost or left_out(item)
                        self.cut += [left_out(item)] if self.gaps <= _GAPS_TOLD else []
        except ForeignError:
            raise
        except DamageError as error:
            self.lost = self.lost or end_of(error)
            self.cut.append(str(error))
            if error.offset is not None:
                self.tail_bytes = file.seek(0, os.SEEK_END) - error.offset

    def _count(self, message: RawMessage) -> None:
        time = message.receive_ns
        self.counts[message.topic] += 1
        self.start_ns = time if self.start_ns is None else min(time, self.start_ns)
        self.end_ns = time if self.end_ns is None else max(time, self.end_ns)

    def _register(self, topic: Topic) -> None:
        if self.topics.setdefault(topic.name, topic).type != topic.type:
            raise RecorderError(
                f"{self.path}: {topic.name[:80]!r} has two types, which no bag can hold; "
                "convert it by the tool that wrote it"
            )

    def _check_summary(self, file: BinaryIO) -> None:
        """Readers trust the summary, if there is one; without checksums it may differ."""
        try:
            topics = {
                topic.name: topic for topic in reversed(Catalogue(read_summary(file)).topics())
            }
            if topics and topics != self.topics:
                self.cut.append("its summary tells of other topics")
        except ForeignError:
            self.cut.append("its summary tells of other topics")
        except DamageError as error:
            self.cut.append(str(error))
