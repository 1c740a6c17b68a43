"""Reads the records of an MCAP file in storage order, whole or torn.

The records are parsed by the mcap library; only their framing (opcode and length), the chunks and
the messages in them are taken apart here. The library's own stream reader believes every length
in a damaged file, decompresses a chunk to whatever size its content claims, takes a text that
ends too early for whole, and walks a tail of zeros, as a power cut leaves it, nine bytes at a
time.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from typing import BinaryIO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import (
    Attachment,
    AttachmentIndex,
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

from recorder.chunks import CHUNK_HEAD, RECORD_LIMIT, ChunkContent, unpack

FRAME = struct.Struct("<BQ")
"""The head of a record: its opcode, and its length in bytes."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""The head of a message: channel, sequence, log time, publish time."""

_INDEX_HEAD = 6  # bytes of the channel and of the size of the entries
_INDEX_SIZE = slice(2, 6)
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, offset in the chunk

_CRC_SIZE = 4
_PARSERS = {
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.STATISTICS: Statistics.read,
}
_WANTED = frozenset({*_PARSERS, Opcode.MESSAGE, Opcode.CHUNK}) - {
    Opcode.ATTACHMENT,
    Opcode.ATTACHMENT_INDEX,
    Opcode.CHUNK_INDEX,
}
_CHUNKS = frozenset({Opcode.CHUNK})
_CHUNK_INDEXES = frozenset({Opcode.CHUNK_INDEX})
_ENDS = frozenset({Opcode.DATA_END, Opcode.FOOTER})
LOOSE = frozenset({Opcode.MESSAGE})
"""What is read of the messages outside the chunks."""
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})  # beside messages
_MESSAGE = int(Opcode.MESSAGE)


class DamageError(Exception):
    """Nothing behind this place can be read; says where and why.

    `offset` is the first byte outside whole records; None if the damage is in their content.
    """

    def __init__(self, text: str, offset: int | None = None) -> None:
        super().__init__(text)
        self.offset = offset


class ForeignError(DamageError):
    """The file is no recording of ROS 2 messages; says what it is instead."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A chunk that cannot be read while what follows it can; `reason` says where and why.

    `foreign`: it is not known to be damaged, see `ChunkContent`.
    """

    reason: str
    foreign: bool = False


@dataclass(frozen=True, slots=True)
class ChunkEnd:
    """The place where a chunk ends: the order of reading goes by chunks."""


StreamItem: TypeAlias = McapRecord | Gap | ChunkEnd


@dataclass(frozen=True, slots=True)
class StoredRecord:
    """A record as it is stored; `whole`: the file did not end before it."""

    opcode: int
    offset: int
    body: bytes
    whole: bool


def read_records(file: BinaryIO, wanted: AbstractSet[Opcode] = _WANTED) -> Iterator[StreamItem]:
    """Records of a file from its beginning to its footer, chunks unpacked.

    A damaged chunk is a `Gap`; of the chunk in which the file ends, the whole records are read.
    Message indexes, attachments and unknown records are skipped. The file may be read elsewhere
    between two records. Raises ForeignError for no MCAP file, and DamageError where it is torn,
    after everything before that place was yielded.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise ForeignError("it does not begin like an MCAP file" if size else "it is empty")
    ended = False
    for frame in frames_of(file, len(MCAP0_MAGIC), size, wanted | _ENDS):
        if frame.opcode == Opcode.CHUNK:
            yield from _chunk(frame)
        elif frame.opcode == Opcode.DATA_END:
            ended = True
        elif frame.opcode == Opcode.MESSAGE and (ended or _is_index(frame.body)):
            raise DamageError(f"the index at byte {frame.offset} is damaged", frame.offset)
        else:
            yield parse(frame)
        if frame.opcode == Opcode.FOOTER:
            file.seek(frame.offset + FRAME.size + len(frame.body))
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise DamageError("there is no end mark behind the footer", frame.offset)
            return
    raise DamageError(f"it ends at byte {size} without a footer", size)


def _is_index(body: bytes) -> bool:
    """Whether one flipped bit made a message of a message index: no message is laid out so."""
    entries = body[_INDEX_HEAD:]
    size = int.from_bytes(body[_INDEX_SIZE], "little")
    if size != len(entries) or size % _INDEX_ENTRY.size:
        return False
    return all(offset < RECORD_LIMIT for _, offset in _INDEX_ENTRY.iter_unpack(entries))


def read_summary(file: BinaryIO, more: AbstractSet[Opcode] = frozenset()) -> Iterator[McapRecord]:
    """The records of the summary and all metadata records, found by the footer; fast.

    `more`: indexes that are wanted, too; those of chunks are very many. A file may have no
    summary: then there are no records. Raises DamageError where it is unfinished or its summary
    is damaged.
    """
    _, summary = summary_of(file)
    size = file.seek(0, io.SEEK_END)
    for frame in frames_of(io.BytesIO(summary), 0, len(summary), _WANTED | more):
        if frame.opcode == Opcode.CHUNK:
            raise DamageError("a chunk stands in its summary")
        record = parse(frame)
        yield record
        if isinstance(record, MetadataIndex):
            metadata = record_at(file, record.offset, size)
            if not isinstance(metadata, Metadata):
                raise DamageError(f"an index points to byte {record.offset}, wrongly")
            yield metadata


def summary_of(file: BinaryIO) -> tuple[int, bytes]:
    """Where the summary begins, and its records; none where there is no summary.

    Raises DamageError where the file is unfinished or its summary is damaged.
    """
    size = file.seek(0, io.SEEK_END)
    start = size - FOOTER_SIZE - len(MCAP0_MAGIC)
    if start < len(MCAP0_MAGIC):
        raise DamageError("it is too short for a footer")
    footer = record_at(file, start, size)
    if not isinstance(footer, Footer) or file.read() != MCAP0_MAGIC:
        raise DamageError("it does not end like an MCAP file")
    if not footer.summary_start:
        return start, b""  # it may have none
    if not max(len(MCAP0_MAGIC), start - RECORD_LIMIT) <= footer.summary_start < start:
        raise DamageError("its summary is not where it should be")
    file.seek(footer.summary_start)
    summary = file.read(size - len(MCAP0_MAGIC) - _CRC_SIZE - footer.summary_start)
    if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
        raise DamageError("the checksum of its summary is wrong")
    return footer.summary_start, summary[: start - footer.summary_start]


def record_at(file: BinaryIO, offset: int, size: int) -> McapRecord:
    """The record at a place in a file of `size` bytes; raises DamageError where there is none."""
    if offset >= size:
        raise DamageError(f"an index points behind its end, to byte {offset}")
    wanted = _WANTED | {Opcode.ATTACHMENT}
    for frame in frames_of(file, offset, size, wanted):
        if frame.offset == offset and frame.opcode != Opcode.CHUNK:
            return parse(frame)
        break
    raise DamageError(f"there is no record at byte {offset}")


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """A chunk on disk; log times in ns since the epoch. No `channels` = they are unknown."""

    offset: int
    begin_ns: int
    end_ns: int
    channels: frozenset[int] = frozenset()

    def distance(self, at_ns: int) -> int:
        return max(self.begin_ns - at_ns, at_ns - self.end_ns, 0)


def chunk_places(file: BinaryIO) -> list[ChunkPlace]:
    """In stored order, by the summary; without it by the heads of the chunks.

    It is missing while a file is written; without a checksum it may be damaged anywhere.
    """
    return indexed_places(file) or _found_places(file)


def indexed_places(file: BinaryIO) -> list[ChunkPlace]:
    """By a summary with a checksum, in stored order; none where it lacks a chunk."""
    places: dict[int, ChunkPlace] = {}
    chunk_count = None
    with suppress(DamageError):
        for record in read_summary(file, _CHUNK_INDEXES):
            if isinstance(record, Statistics):
                chunk_count = record.chunk_count
            elif isinstance(record, ChunkIndex):
                offset, channels = record.chunk_start_offset, record.message_index_offsets
                places[offset] = ChunkPlace(
                    offset, record.message_start_time, record.message_end_time, frozenset(channels)
                )
        file.seek(-len(MCAP0_MAGIC) - _CRC_SIZE, io.SEEK_END)
        chunk_count = chunk_count if any(file.read(_CRC_SIZE)) else None
    if len(places) != chunk_count:
        return []
    return sorted(places.values(), key=lambda place: place.offset)


def _found_places(file: BinaryIO) -> list[ChunkPlace]:
    """By the heads of the chunks, in stored order."""
    places = []
    with suppress(DamageError):
        size = file.seek(0, io.SEEK_END)
        for frame in frames_of(file, len(MCAP0_MAGIC), size, _CHUNKS, most=CHUNK_HEAD.size):
            if len(frame.body) == CHUNK_HEAD.size:
                begin_ns, end_ns, *_ = CHUNK_HEAD.unpack_from(frame.body)
                places.append(ChunkPlace(frame.offset, begin_ns, end_ns))
    return places


def read_chunk(file: BinaryIO, offset: int) -> ChunkContent:
    with suppress(DamageError):
        for frame in frames_of(file, offset, file.seek(0, io.SEEK_END), _CHUNKS):
            if frame.offset == offset:
                return unpack(frame.body)
            break
    return ChunkContent(b"", "is not where it should be")


def frames_of(
    stream: BinaryIO,
    offset: int,
    size: int,
    wanted: AbstractSet[Opcode] = _WANTED,
    most: int = RECORD_LIMIT,
) -> Iterator[StoredRecord]:
    """The wanted records from `offset` to byte `size`, where one must end; `most` bytes of each.

    A chunk may be cut, as the last frame; any other record that is not whole is a DamageError.
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
            if opcode == Opcode.CHUNK and opcode in wanted:
                rest = min(size - stream.tell(), most)
                yield StoredRecord(opcode, offset, stream.read(rest), whole=False)
            raise DamageError(f"it is torn at byte {offset}", offset)
        if opcode in wanted:
            if length > RECORD_LIMIT:
                raise DamageError(f"the record at byte {offset} claims {length} bytes", offset)
            yield StoredRecord(opcode, offset, stream.read(min(length, most)), whole=True)
        offset = following


def _chunk(frame: StoredRecord) -> Iterator[StreamItem]:
    content = unpack(frame.body)
    problem = content.problem
    try:
        yield from records_in(content.records)
    except DamageError:
        problem = problem or "has a damaged record"
    yield ChunkEnd()
    if problem is not None and frame.whole:
        yield Gap(f"a chunk {problem} (byte {frame.offset})", content.foreign)


def records_in(records: bytes) -> Iterator[McapRecord]:
    """Messages, of which there are many, are parsed on the spot. Raises DamageError."""
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
            yield parse(StoredRecord(opcode, start, records[start:end], whole=True))


class _Fields(ReadDataStream):
    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(frame: StoredRecord) -> McapRecord:
    fields = _Fields(io.BytesIO(frame.body))
    try:
        if frame.opcode == Opcode.MESSAGE:
            record: McapRecord = Message.read(fields, len(frame.body))
        else:
            record = _PARSERS[Opcode(frame.opcode)](fields)
    except (McapError, struct.error, ValueError, OverflowError):
        raise DamageError(f"the record at byte {frame.offset} is damaged", frame.offset) from None
    return record
