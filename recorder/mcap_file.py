"""The one `.mcap` file of a bag while it is written; not thread-safe."""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER

from recorder.bag import BagInformation, Topic, qos_text
from recorder.mcap_writer import McapWriter

if TYPE_CHECKING:
    from recorder.bag import RawMessage


ROSBAG2_RECORD = "rosbag2"
"""The metadata record in which rosbag2 repeats `metadata.yaml`."""


class McapFile:
    """Puts topics, messages and records into a new file of an open folder.

    Every call raises `OSError` when the disk refuses. What was saved before then stays readable
    as an unfinished recording. The file is locked (flock) until it is closed, so that nobody
    takes it for one that was cut off. `listed_as` is its name in the bag, if it will be renamed.
    """

    def __init__(self, folder_fd: int, name: str, listed_as: str | None = None) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        self.name = listed_as or name
        self._disk = _Disk(os.open(name, flags, 0o666, dir_fd=folder_fd))
        self._writer = McapWriter(self._disk.write)
        self._topics: dict[str, tuple[Topic, int]] = {}
        self._schemas: dict[tuple[str, str], int] = {}

    @property
    def saved(self) -> Counter[str]:
        """Messages per topic name in the file; those of the chunk in memory are not counted."""
        counts = self._writer.statistics.channel_message_counts
        return Counter({n: counts[c] for n, (_, c) in self._topics.items() if c in counts})

    @property
    def start_ns(self) -> int | None:
        statistics = self._writer.statistics
        return statistics.message_start_time if statistics.message_count else None

    @property
    def end_ns(self) -> int | None:
        statistics = self._writer.statistics
        return statistics.message_end_time if statistics.message_count else None

    @property
    def size(self) -> int:
        return self._disk.size

    @property
    def pending(self) -> int:
        """Bytes that it takes to finish the file, about."""
        return self._writer.pending

    def start(self, topics: Iterable[Topic], records: Mapping[str, Mapping[str, str]]) -> None:
        """Write the header and the records, and register the topics; on disk on return."""
        self._writer.start(profile=Profile.ROS2, library=f"madrob recorder, {LIBRARY_IDENTIFIER}")
        for topic in topics:
            self.register(topic)
        for name, record in records.items():
            self.add_record(name, record)
        self.sync()

    def register(self, topic: Topic) -> None:
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
        channel = self._topics[message.topic][1]
        content = message.receive_ns, message.data, message.publish_ns, message.sequence
        self._writer.add_message(channel, *content)

    def add_record(self, name: str, record: Mapping[str, str]) -> None:
        self._writer.add_metadata(_text(name), {_text(k): _text(v) for k, v in record.items()})

    def end_chunk(self) -> None:
        self._writer.flush()

    def sync(self) -> None:
        """Bring everything to the disk; OSError also if the file was deleted."""
        self._writer.flush()
        self._disk.sync()

    def information(self) -> BagInformation:
        return BagInformation(
            self.name,
            [topic for topic, _ in self._topics.values()],
            self.saved,
            self.start_ns,
            self.end_ns,
        )

    def finish(self) -> None:
        """Add the record `rosbag2`, the indexes and the summary; on disk on return."""
        self._writer.flush()
        record = {"serialized_metadata": self.information().serialized_metadata()}
        self._writer.add_metadata(ROSBAG2_RECORD, record)
        self._writer.finish()
        self._disk.sync()

    def close(self) -> None:
        self._disk.close()


def _text(value: str) -> str:
    """Valid text: a stray byte in what a referee typed must not end the recording."""
    return value.encode("utf-8", "backslashreplace").decode()


class _Disk:
    """A file without a buffer of its own: a write is in the file when it returns, or raises."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._closed = False
        self.size = 0
        with suppress(OSError):  # not every network disk has locks
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            written = os.write(self._fd, rest)
            self.size += written
            rest = rest[written:]

    def sync(self) -> None:
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            raise FileNotFoundError("the file was deleted")

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            os.close(self._fd)
