"""Walk the records of an MCAP file in storage order, whole or torn.

The records are parsed by the mcap library; only their framing (opcode and length), the chunks and
the messages in them are taken apart here. The library's own stream reader believes every length in
a damaged file, decompresses a chunk to whatever size its content claims, takes a text that ends too
early for whole, and walks a tail of zeros, as a power cut leaves it, nine bytes at a time.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import BinaryIO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from recorder.mcap_chunk import RECORD_LIMIT, unpack

FRAME = struct.Struct("<BQ")
"""What stands before each record: its opcode, and its length in bytes."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""What stands before the data of a message: channel, sequence, log time, publish time."""

_CRC_SIZE = 4
_PARSERS = {
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.STATISTICS: Statistics.read,
}
_WANTED = frozenset({*_PARSERS, Opcode.MESSAGE, Opcode.CHUNK}) - {Opcode.CHUNK_INDEX}
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})  # beside messages
_MESSAGE = int(Opcode.MESSAGE)


class DamageError(Exception):
    """Nothing behind this place can be read; says where and why.

    Attributes:
        offset: the first byte of the file that does not belong to a whole record; None if the
            damage is in what the records say.
    """

    def __init__(self, text: str, offset: int | None = None) -> None:
        super().__init__(text)
        self.offset = offset


class ForeignError(DamageError):
    """The file is no recording of ROS 2 messages; says what it is instead."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A chunk that cannot be read while what follows it can.

    Attributes:
        reason: where and why, in words.
    """

    reason: str


StreamItem: TypeAlias = McapRecord | Gap


@dataclass(frozen=True, slots=True)
class _Frame:
    opcode: int
    offset: int
    body: bytes
    whole: bool


def read_records(file: BinaryIO) -> Iterator[StreamItem]:
    """Records of a file from its beginning to its footer, chunks unpacked.

    A damaged chunk is a `Gap`; of the chunk in which the file ends, the whole records are read.
    Message indexes, attachments and unknown records are passed over. The file may be read
    elsewhere between two records.

    Raises:
        ForeignError: it is no MCAP file.
        DamageError: it is torn or damaged; everything before that place was yielded.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise ForeignError("it does not begin like an MCAP file" if size else "it is empty")
    chunked = False
    for frame in _frames(file, len(MCAP0_MAGIC), size):
        if frame.opcode == Opcode.CHUNK:
            chunked = True
            yield from _chunk(frame)
        elif chunked and frame.opcode == Opcode.MESSAGE:
            # No writer mixes the two, but one flipped bit makes a message of an index.
            raise DamageError("a message stands outside the chunks", frame.offset)
        else:
            yield _parse(frame)
        if frame.opcode == Opcode.FOOTER:
            file.seek(frame.offset + FRAME.size + len(frame.body))
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise DamageError("there is no end mark behind the footer", frame.offset)
            return
    raise DamageError(f"it ends at byte {size} without a footer", size)


def read_summary(file: BinaryIO, *, chunks: bool = False) -> Iterator[McapRecord]:
    """The records of the summary and all metadata records, found by the footer; fast.

    Args:
        file: the recording.
        chunks: with its chunk indexes, of which there are very many.

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
    wanted = _WANTED | {Opcode.CHUNK_INDEX} if chunks else _WANTED
    for frame in _frames(io.BytesIO(summary), 0, start - footer.summary_start, wanted):
        if frame.opcode == Opcode.CHUNK:
            raise DamageError("a chunk stands in its summary")
        record = _parse(frame)
        yield record
        if isinstance(record, MetadataIndex):
            metadata = _record_at(file, record.offset, size)
            if not isinstance(metadata, Metadata):
                raise DamageError(f"an index points to byte {record.offset}, wrongly")
            yield metadata


def _record_at(file: BinaryIO, offset: int, size: int) -> McapRecord:
    if offset >= size:
        raise DamageError(f"an index points behind its end, to byte {offset}")
    for frame in _frames(file, offset, size):
        if frame.offset == offset and frame.opcode != Opcode.CHUNK:
            return _parse(frame)
        break
    raise DamageError(f"there is no record at byte {offset}")


def _frames(
    stream: BinaryIO, offset: int, size: int, wanted: AbstractSet[Opcode] = _WANTED
) -> Iterator[_Frame]:
    """The wanted records from `offset` to byte `size`, where one must end.

    Only a chunk is yielded when it is not whole; then it is the last frame.

    Raises:
        DamageError: another record is not whole, or there is none.
    """
    while offset < size:
        stream.seek(offset)
        frame = stream.read(FRAME.size)
        if len(frame) < FRAME.size:
            raise DamageError(f"it is torn at byte {offset}", offset)
        opcode, length = FRAME.unpack(frame)
        if opcode == 0:
            raise DamageError(f"there are only zeros from byte {offset} on", offset)
        following = offset + FRAME.size + length
        if following > size:
            if opcode == Opcode.CHUNK:
                rest = min(size - stream.tell(), RECORD_LIMIT)
                yield _Frame(opcode, offset, stream.read(rest), whole=False)
            raise DamageError(f"it is torn at byte {offset}", offset)
        if opcode in wanted:
            if length > RECORD_LIMIT:
                raise DamageError(f"the record at byte {offset} claims {length} bytes", offset)
            yield _Frame(opcode, offset, stream.read(length), whole=True)
        offset = following


def _chunk(frame: _Frame) -> Iterator[StreamItem]:
    content = unpack(frame.body)
    problem = content.problem
    try:
        yield from records_in(content.records)
    except DamageError:
        problem = problem or "has a damaged record"
    if problem is not None and frame.whole:
        yield Gap(f"a chunk {problem} (byte {frame.offset})")


def records_in(records: bytes) -> Iterator[McapRecord]:
    """The records of a chunk; messages, of which there are many, are parsed on the spot.

    Raises:
        DamageError: one is damaged or not whole, or there are only zeros.
    """
    end, size = 0, len(records)
    while end < size:
        start = end + FRAME.size
        if start > size:
            raise DamageError("it is torn")
        opcode, length = FRAME.unpack_from(records, end)
        end = start + length
        if opcode == 0 or end > size:
            raise DamageError("it is torn")
        if opcode == _MESSAGE:
            if length < MESSAGE_HEAD.size:
                raise DamageError("a message is damaged")
            channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(records, start)
            data = records[start + MESSAGE_HEAD.size : end]
            yield Message(channel, log_time, data, publish_time, sequence)
        elif opcode in _IN_CHUNKS:
            yield _parse(_Frame(opcode, start, records[start:end], whole=True))


class _Fields(ReadDataStream):
    """The fields of a record; one that claims to be longer than the record is an error."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _parse(frame: _Frame) -> McapRecord:
    fields = _Fields(io.BytesIO(frame.body))
    try:
        if frame.opcode == Opcode.MESSAGE:
            record: McapRecord = Message.read(fields, len(frame.body))
        else:
            record = _PARSERS[Opcode(frame.opcode)](fields)
    except (McapError, struct.error, ValueError, OverflowError):
        raise DamageError(f"the record at byte {frame.offset} is damaged", frame.offset) from None
    return record
