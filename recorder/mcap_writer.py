"""Writes an MCAP file: channels, chunks, their indexes, the summary.

The records are built by the mcap library; only the messages and their indexes, of which there are
many, and the chunks around them are put together here. The library's own writer takes five times
as long for a small message, and compresses pictures that are compressed already.
"""

from __future__ import annotations

import fcntl
import os
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC

from recorder.bag import BagInformation, Topic, qos_text

if TYPE_CHECKING:
    from recorder.bag import RawMessage

CHUNK_BYTES = 768 * 1024
"""Bytes of a chunk before compression: the longest single write stays at a few milliseconds."""

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_MESSAGE_FIELDS = _MESSAGE.size - 9
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of the entries
_CHUNK = struct.Struct("<BQQQQI")  # opcode, length, first time, last time, size, checksum
_FOOTER = struct.Struct("<BQQQ")

_WORTH = 0.95
"""A chunk is compressed if that leaves less than this fraction of it."""
_SLICES, _SLICE = 4, 8 * 1024
_FIRST = 0.618
"""Where each lies in its share: away from the start of a picture, whose heads are alike."""


class McapWriter:
    """Puts records one after the other through `write`; not thread-safe.

    What `write` raises passes through; what was written before is a readable torn file.
    `statistics` leaves out the messages of the current chunk.
    """

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self.statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts=defaultdict(int),
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        self._write = write
        self._offset = 0
        self._chunk: list[bytes] = []
        self._chunk_bytes = 0
        self._entries: list[list[int]] = []  # log time, offset, log time, ... by channel
        self._counts: list[int] = []  # messages by channel, those of the chunk at hand as well
        self._compressor = zstandard.ZstdCompressor()
        self._summary: defaultdict[Opcode, RecordBuilder] = defaultdict(RecordBuilder)

    @property
    def pending(self) -> int:
        """Bytes still to come without another message, about: current chunk and summary."""
        summary = sum(builder.count for builder in self._summary.values())
        return self._chunk_bytes + 8 * sum(map(len, self._entries)) + summary

    def start(self, profile: str, library: str) -> None:
        self._put(MCAP0_MAGIC)
        self._put(record_bytes(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        self.statistics.schema_count += 1
        number = self.statistics.schema_count
        self._introduce(Opcode.SCHEMA, Schema(number, data, encoding, name))
        return number

    def register_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        self.statistics.channel_count += 1
        number = self.statistics.channel_count
        self._introduce(Opcode.CHANNEL, Channel(number, topic, encoding, dict(metadata), schema))
        self._entries.append([])
        self._counts.append(0)
        return number

    def add_message(
        self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> None:
        """Append a message; a full chunk goes to the file."""
        self._entries[channel - 1] += log_time, self._chunk_bytes
        self._counts[channel - 1] += 1
        size = len(data)
        head = _MESSAGE.pack(
            _MESSAGE_OPCODE,
            _MESSAGE_FIELDS + size,
            channel,
            sequence & 0xFFFF_FFFF,
            log_time,
            publish_time,
        )
        self._chunk += head, data
        self._chunk_bytes += _MESSAGE.size + size
        if self._chunk_bytes > CHUNK_BYTES:
            self.flush()

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        self.flush()
        record = record_bytes(Metadata(name, dict(content)))
        MetadataIndex(self._offset, len(record), name).write(self._summary[Opcode.METADATA_INDEX])
        self.statistics.metadata_count += 1
        self._put(record)

    def flush(self) -> None:
        times = [time for entries in self._entries for time in entries[::2]]
        if not times:
            return
        data = b"".join(self._chunk)
        first, last, offset = min(times), max(times), self._offset
        compression, packed = self._pack(data)
        name = compression.encode()
        tail = struct.pack(f"<I{len(name)}sQ", len(name), name, len(packed))
        length = _CHUNK.size - 9 + len(tail) + len(packed)
        head = _CHUNK.pack(Opcode.CHUNK, length, first, last, len(data), zlib.crc32(data))
        self._put(head + tail)
        self._put(packed)
        end = self._offset
        places, indexes = self._indexes()
        self._put(indexes)
        ChunkIndex(
            chunk_length=end - offset,
            chunk_start_offset=offset,
            compression=compression,
            compressed_size=len(packed),
            message_end_time=last,
            message_index_length=len(indexes),
            message_index_offsets=places,
            message_start_time=first,
            uncompressed_size=len(data),
        ).write(self._summary[Opcode.CHUNK_INDEX])
        self._written(first, last, len(times))

    def finish(self) -> None:
        self.flush()
        self._put(record_bytes(DataEnd(0)))
        self.statistics.write(self._summary[Opcode.STATISTICS])
        groups = {opcode: _content(builder) for opcode, builder in self._summary.items()}
        self._put(file_end(self._offset, groups))

    def _introduce(self, opcode: Opcode, record: McapRecord) -> None:
        """What a message needs to be read is in a chunk before it, and in the summary."""
        record.write(self._summary[opcode])
        self._chunk.append(record_bytes(record))
        self._chunk_bytes += len(self._chunk[-1])

    def _pack(self, data: bytes) -> tuple[str, bytes]:
        """Compressed only where that is worth it; returns by what."""
        if len(data) > 2 * _SLICES * _SLICE:
            starts = [int(len(data) * (n + _FIRST) / _SLICES) for n in range(_SLICES)]
            sample = b"".join([data[start : start + _SLICE] for start in starts])
            if len(self._compressor.compress(sample)) >= _WORTH * len(sample):
                return "", data
        packed = self._compressor.compress(data)
        return ("zstd", packed) if len(packed) < _WORTH * len(data) else ("", data)

    def _indexes(self) -> tuple[dict[int, int], bytes]:
        places: dict[int, int] = {}
        indexes: list[bytes] = []
        at = self._offset
        for channel, entries in enumerate(self._entries, 1):
            if entries:
                body = struct.pack(f"<{len(entries)}Q", *entries)
                head = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(body), channel, len(body))
                places[channel] = at
                indexes += head, body
                at += len(head) + len(body)
        return places, b"".join(indexes)

    def _written(self, first: int, last: int, count: int) -> None:
        statistics = self.statistics
        if not statistics.message_count:
            statistics.message_start_time, statistics.message_end_time = first, last
        statistics.message_start_time = min(statistics.message_start_time, first)
        statistics.message_end_time = max(statistics.message_end_time, last)
        statistics.message_count += count
        statistics.chunk_count += 1
        for channel, entries in enumerate(self._entries, 1):
            if entries:
                statistics.channel_message_counts[channel] += len(entries) // 2
                entries.clear()
        self._chunk.clear()
        self._chunk_bytes = 0

    def _put(self, data: bytes) -> None:
        self._write(data)
        self._offset += len(data)


def file_end(begin: int, groups: Mapping[Opcode, bytes]) -> bytes:
    """Summary and footer of a file: from byte `begin` on the records of the summary by opcode."""
    at, offsets = begin, RecordBuilder()
    for opcode, records in groups.items():
        SummaryOffset(opcode, at, len(records)).write(offsets)
        at += len(records)
    summary = b"".join((*groups.values(), _content(offsets)))
    footer = _FOOTER.pack(Opcode.FOOTER, 20, begin, at)
    checksum = zlib.crc32(footer, zlib.crc32(summary))
    return summary + record_bytes(Footer(begin, at, checksum)) + MCAP0_MAGIC


def record_bytes(record: McapRecord) -> bytes:
    """The record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return _content(builder)


def _content(builder: RecordBuilder) -> bytes:
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content


# The one `.mcap` file of a bag while it is written; not thread-safe.


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
