"""The one `.mcap` file of a bag while it is written; not thread-safe."""

from __future__ import annotations

import fcntl
import io
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import IO, TYPE_CHECKING, cast

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from recorder.bag import BagInformation, Topic, qos_text

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

    from recorder.message import RawMessage

CHUNK_BYTES = 768 * 1024
"""Bytes of a chunk before compression: the longest single write stays at a few milliseconds."""

ROSBAG2_RECORD = "rosbag2"
"""The metadata record in which rosbag2 repeats `metadata.yaml`."""


class McapFile:
    """Puts topics, messages and records into a new file of an open folder.

    Every call raises `OSError` when the disk refuses. What was saved before then stays readable
    as an unfinished recording. The file is locked (flock) until it is closed, so that nobody
    takes it for one that was cut off.

    Args:
        folder_fd: the open folder.
        name: the new file's name.
        listed_as: the name by which the bag lists it, if it will be renamed.

    Attributes:
        saved: messages per topic name that the file holds; those of the chunk still in memory
            are not counted.
        start_ns: earliest log time of the saved messages, None before the first.
        end_ns: latest log time of the saved messages, None before the first.
    """

    def __init__(self, folder_fd: int, name: str, listed_as: str | None = None) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        self.name = listed_as or name
        self.saved: Counter[str] = Counter()
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._disk = _Disk(os.open(name, flags, 0o666, dir_fd=folder_fd))
        self._writer = Writer(cast(IO[bytes], self._disk), chunk_size=CHUNK_BYTES)
        self._topics: dict[str, tuple[Topic, int]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._count: Counter[str] = Counter()
        self._unsaved_times: list[int] = []

    @property
    def size(self) -> int:
        """Bytes handed to the file."""
        return self._disk.size

    def start(self, topics: Iterable[Topic], records: Mapping[str, Mapping[str, str]]) -> None:
        """Write the header and the records, register the topics, and reach the disk."""
        self._writer.start(profile=Profile.ROS2, library=f"madrob recorder, {LIBRARY_IDENTIFIER}")
        for topic in topics:
            self.register(topic)
        for name, record in records.items():
            self.add_record(name, record)
        self.sync()

    def register(self, topic: Topic) -> None:
        """Open a channel; one already open under this name stays as it is."""
        if topic.name in self._topics:
            return
        key = (topic.type, topic.definition)
        if key not in self._schemas:
            encoding = SchemaEncoding.ROS2 if topic.definition else ""
            self._schemas[key] = self._writer.register_schema(
                topic.type, encoding, topic.definition.encode()
            )
        metadata = {
            "offered_qos_profiles": qos_text(topic.qos),
            "topic_type_hash": topic.type_hash,
        }
        channel = self._writer.register_channel(
            topic.name, MessageEncoding.CDR, self._schemas[key], metadata
        )
        self._topics[topic.name] = (topic, channel)

    def add_message(self, message: RawMessage) -> None:
        """Append a message of a registered topic; full chunks go to the file by themselves."""
        topic, time = message.topic, message.receive_ns
        self._count[topic] = number = self._count[topic] + 1
        self._unsaved_times.append(time)
        size = self._disk.size
        self._writer.add_message(
            self._topics[topic][1], time, message.data, message.publish_ns, number & 0xFFFF_FFFF
        )
        if self._disk.size != size:
            self._saved()

    def add_record(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record behind every message so far."""
        self._flush()
        self._writer.add_metadata(_text(name), {_text(k): _text(v) for k, v in record.items()})

    def sync(self) -> None:
        """Bring everything to the disk.

        Raises:
            OSError: it cannot be, or the file was deleted.
        """
        self._flush()
        self._disk.sync()

    def information(self) -> BagInformation:
        """What `metadata.yaml` has to say about what is saved."""
        return BagInformation(
            self.name,
            [topic for topic, _ in self._topics.values()],
            self.saved,
            self.start_ns,
            self.end_ns,
        )

    def finish(self) -> None:
        """Add the record `rosbag2`, the indexes and the summary; on the disk on return."""
        self._flush()
        record = {"serialized_metadata": self.information().serialized_metadata()}
        self._writer.add_metadata(ROSBAG2_RECORD, record)
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._disk.sync()

    def close(self) -> None:
        """Let go of the file, as it is."""
        self._disk.close()

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._saved()

    def _saved(self) -> None:
        """Take what was unsaved as saved: its chunk is in the file."""
        if not self._unsaved_times:
            return
        first, last = min(self._unsaved_times), max(self._unsaved_times)
        self.start_ns = first if self.start_ns is None else min(first, self.start_ns)
        self.end_ns = last if self.end_ns is None else max(last, self.end_ns)
        self.saved = self._count.copy()
        self._unsaved_times.clear()


def _text(value: str) -> str:
    """Valid text: a stray byte in what a referee typed must not end the recording."""
    return value.encode("utf-8", "backslashreplace").decode()


class _Disk(io.BufferedIOBase):
    """A file without a buffer of its own: a write is in the file when it returns, or raises."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.size = 0
        with suppress(OSError):  # not every network disk has locks
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, data: ReadableBuffer) -> int:
        rest = memoryview(data).cast("B")
        length = len(rest)
        while rest:
            written = os.write(self._fd, rest)
            self.size += written
            rest = rest[written:]
        return length

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Nothing is held back."""

    def sync(self) -> None:
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            raise FileNotFoundError("the file was deleted")

    def close(self) -> None:
        if not self.closed:
            os.close(self._fd)
        super().close()
