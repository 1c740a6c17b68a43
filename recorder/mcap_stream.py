"""Walk the records of an MCAP file in storage order, whole or torn.

The records are parsed by the mcap library; only their framing (opcode and length) is taken apart
here. The library's own stream reader believes every length in a damaged file, decompresses a
chunk to whatever size its content claims, holds all of its messages at once, and walks a tail of
zeros, as a power cut leaves it, nine bytes at a time.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import (
    Channel,
    Chunk,
    Footer,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

RECORD_LIMIT = 256 * 1024 * 1024
"""The most bytes a record or a chunk may have, decompressed; rosbag2 makes chunks of 0.75 MiB."""

_FRAME = struct.Struct("<BQ")
_CRC_SIZE = 4
_PARSERS = {
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.STATISTICS: Statistics.read,
}


class DamageError(Exception):
    """Nothing behind this place can be read; says where and why."""


class ForeignError(DamageError):
    """The file is no recording of ROS 2 messages; says what it is instead."""


def read_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Records of a file from its beginning to its footer, chunks unpacked.

    Message indexes, attachments and unknown records are passed over.

    Raises:
        ForeignError: it is no MCAP file.
        DamageError: it is torn or damaged; everything before that place was yielded.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise ForeignError("it does not begin like an MCAP file" if size else "it is empty")
    chunked = False
    for record in _records(file, size):
        if isinstance(record, Chunk):
            chunked = True
            yield from _unpack(record)
        elif chunked and isinstance(record, Message):
            # No writer mixes the two, but one flipped bit makes a message of an index.
            raise DamageError("a message stands outside the chunks")
        else:
            yield record
        if isinstance(record, Footer):
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise DamageError("there is no end mark behind the footer")
            return
    raise DamageError(f"it ends at byte {size} without a footer")


def read_summary(file: BinaryIO) -> list[McapRecord]:
    """The records of the summary and all metadata records, found by the footer; fast.

    Raises:
        DamageError: it has no summary that could be used.
    """
    size = file.seek(0, io.SEEK_END)
    start = size - FOOTER_SIZE - len(MCAP0_MAGIC)
    if start < len(MCAP0_MAGIC):
        raise DamageError("it is too short for a footer")
    footer = _record_at(file, start, size)
    if not isinstance(footer, Footer) or file.read() != MCAP0_MAGIC:
        raise DamageError("it does not end like an MCAP file")
    if not 0 < footer.summary_start < start:
        raise DamageError("it has no summary")
    if start - footer.summary_start > RECORD_LIMIT:
        raise DamageError("its summary is too large")
    file.seek(footer.summary_start)
    summary = file.read(size - len(MCAP0_MAGIC) - _CRC_SIZE - footer.summary_start)
    if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
        raise DamageError("the checksum of its summary is wrong")
    records = list(_records(io.BytesIO(summary), start - footer.summary_start))
    indexes = [record for record in records if isinstance(record, MetadataIndex)]
    return records + [_record_at(file, index.offset, size) for index in indexes]


def _record_at(file: BinaryIO, offset: int, size: int) -> McapRecord:
    if offset >= size:
        raise DamageError(f"an index points behind its end, to byte {offset}")
    file.seek(offset)
    for record in _records(file, size):
        return record
    raise DamageError(f"there is no record at byte {offset}")


def _records(stream: BinaryIO, size: int) -> Iterator[McapRecord]:
    """Records from the stream's position to byte `size`, where one must end."""
    offset = stream.tell()
    while offset < size:
        frame = stream.read(_FRAME.size)
        if len(frame) < _FRAME.size:
            raise DamageError(f"it is torn at byte {offset}")
        opcode, length = _FRAME.unpack(frame)
        if opcode == 0:
            raise DamageError(f"there are only zeros from byte {offset} on")
        following = offset + _FRAME.size + length
        if following > size:
            raise DamageError(f"it is torn at byte {offset}")
        if opcode == Opcode.MESSAGE or opcode in _PARSERS:
            if length > RECORD_LIMIT:
                raise DamageError(f"the record at byte {offset} claims {length} bytes")
            yield _parse(opcode, stream.read(length), offset)
        else:
            stream.seek(following)
        offset = following


def _parse(opcode: int, body: bytes, offset: int) -> McapRecord:
    fields = ReadDataStream(io.BytesIO(body))
    try:
        if opcode == Opcode.MESSAGE:
            record: McapRecord = Message.read(fields, len(body))
        else:
            record = _PARSERS[Opcode(opcode)](fields)
    except (McapError, struct.error, ValueError, OverflowError):
        raise DamageError(f"the record at byte {offset} is damaged") from None
    return record


def _unpack(chunk: Chunk) -> Iterator[McapRecord]:
    if chunk.uncompressed_size > RECORD_LIMIT:
        raise DamageError(f"a chunk claims {chunk.uncompressed_size} bytes")
    try:
        data = _decompress(chunk)
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError):  # lz4 has no error of its own
        raise DamageError("a chunk cannot be decompressed") from None
    if len(data) != chunk.uncompressed_size:
        raise DamageError("a chunk has not the size that it claims")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError("the checksum of a chunk is wrong")
    for record in _records(io.BytesIO(data), len(data)):
        if isinstance(record, Schema | Channel | Message):
            yield record


def _decompress(chunk: Chunk) -> bytes:
    """At most one byte more than the chunk claims."""
    packed, limit = io.BytesIO(chunk.data), chunk.uncompressed_size + 1
    match chunk.compression:
        case "":
            return chunk.data
        case "zstd":
            return zstandard.ZstdDecompressor().stream_reader(packed).read(limit)
        case "lz4":
            data: bytes = lz4.frame.LZ4FrameFile(packed).read(limit)
            return data
        case other:
            raise DamageError(f"the compression {other!r} is unknown")
