"""Writes an MCAP file: channels, chunks, their indexes, the summary.

The records are built by the mcap library; only the messages and their indexes, of which there are
many, and the chunks around them are put together here. The library's own writer takes five times
as long for a small message, and compresses pictures that are compressed already.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping

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
from mcap.writer import MCAP0_MAGIC

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
