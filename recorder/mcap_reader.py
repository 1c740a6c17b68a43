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
from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from typing import BinaryIO, TypeAlias

import lz4.frame  # type: ignore[import-untyped]
import zstandard
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
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC

from recorder.bag import Qos, Topic, parse_qos

# The content of one chunk: whole, damaged, or cut off.
#
# A whole chunk is believed if its size and its checksum are right. A cut one has lost its end, so
# no checksum can tell; what comes before the cut is what was written.


RECORD_LIMIT = 128 * 1024 * 1024
"""The most bytes a record or a chunk may have, decompressed; rosbag2 makes chunks of 0.75 MiB."""

_HEAD = struct.Struct("<QQQII")  # first time, last time, size, checksum, length of a name
_SIZE = struct.Struct("<Q")
_NAME_LIMIT = 32
_LZ4_PIECE = 64 * 1024
_ZSTD_STEP = 256
"""Bytes per step: they are at most 64 blocks, which unpack to 128 KiB each."""

_SECTOR = 512


@dataclass(frozen=True, slots=True)
class ChunkContent:
    """Records of a chunk; of a cut chunk those before the cut and a part of the next one.

    `problem` says why that is not all, as the end of a sentence; else None. `foreign`: the chunk
    may be whole, but this reader cannot decompress it.
    """

    records: bytes
    problem: str | None
    foreign: bool = False


@dataclass(frozen=True, slots=True)
class _Packed:
    size: int
    checksum: int
    compression: str
    data: bytes
    data_size: int


def unpack(body: bytes) -> ChunkContent:
    """Decompress a chunk record's body, or what is left of it.

    Memory is taken as the content grows, never for what the chunk claims.
    """
    try:
        packed = _parse_chunk(body)
    except (struct.error, ValueError):
        return ChunkContent(b"", "is damaged")
    if packed.size > RECORD_LIMIT:
        return ChunkContent(b"", f"claims {packed.size} bytes")
    if packed.compression not in _UNPACKERS:
        words = f"has the unknown compression {packed.compression!r}"
        return ChunkContent(b"", words, foreign=True)
    content = _decompress(packed, packed.data)
    cut = len(packed.data) < packed.data_size
    problem = "is cut off" if cut else _mistake(packed, content)
    if problem is None:
        return ChunkContent(content, None)
    # A power cut leaves sectors of zeros where data never came to the disk.
    solid = packed.data.rstrip(b"\0")
    if len(packed.data) - len(solid) >= _SECTOR:
        content, cut = _decompress(packed, solid), True
    return ChunkContent(content[: packed.size] if cut else b"", problem)


def _parse_chunk(body: bytes) -> _Packed:
    _, _, size, checksum, name_length = _HEAD.unpack_from(body)
    if name_length > _NAME_LIMIT:
        raise ValueError
    start = _HEAD.size + name_length
    name = body[_HEAD.size : start].decode()
    (data_size,) = _SIZE.unpack_from(body, start)
    start += _SIZE.size
    return _Packed(size, checksum, name, body[start : start + data_size], data_size)


def _mistake(packed: _Packed, content: bytes) -> str | None:
    if len(content) != packed.size:
        return "cannot be decompressed to the size that it claims"
    if packed.checksum and zlib.crc32(content) != packed.checksum:
        return "has a wrong checksum"
    return None


def _decompress(packed: _Packed, data: bytes) -> bytes:
    pieces: list[bytes] = []
    size = 0
    try:
        for piece in _UNPACKERS[packed.compression](data):
            pieces.append(piece)
            size += len(piece)
            if size > packed.size:
                break
    except (zstandard.ZstdError, RuntimeError):  # lz4 has no error of its own
        pass
    return b"".join(pieces)


def _plain(data: bytes) -> Iterator[bytes]:
    yield data


def _zstd(data: bytes) -> Iterator[bytes]:
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    for start in range(0, len(data), _ZSTD_STEP):
        if decompressor.eof:
            return
        yield decompressor.decompress(data[start : start + _ZSTD_STEP])


def _lz4(data: bytes) -> Iterator[bytes]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    while not decompressor.eof:
        piece = decompressor.decompress(data, max_length=_LZ4_PIECE)
        data = b""
        if not piece and decompressor.needs_input:
            return
        yield piece


_UNPACKERS = {"": _plain, "zstd": _zstd, "lz4": _lz4}


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


StreamItem: TypeAlias = McapRecord | Gap


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
        places.clear()
        with suppress(DamageError):
            size = file.seek(0, io.SEEK_END)
            for frame in frames_of(file, len(MCAP0_MAGIC), size, _CHUNKS, most=_HEAD.size):
                if len(frame.body) == _HEAD.size:
                    begin_ns, end_ns, *_ = _HEAD.unpack_from(frame.body)
                    places[frame.offset] = ChunkPlace(frame.offset, begin_ns, end_ns)
    return sorted(places.values(), key=lambda place: place.offset)


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


# The schemas, channels and metadata records of one file, and the topics that they make.


CATALOGUE_LIMIT = 16 * 1024 * 1024
"""The most bytes of types, channels and records; those of a run have some 50 KiB."""

TOPIC_LIMIT = 1000
"""The most channels; a run has some twenty."""

QOS_LIMIT = 256 * 1024
"""The most bytes of differing QoS texts; a publisher's has about 400, and most are equal."""

_SHOWN = 80


class Catalogue:
    """Gathers the records of a file in any order, within a bag's limits."""

    def __init__(self, records: Iterable[McapRecord] = ()) -> None:
        self.records: dict[str, dict[str, str]] = {}
        self.statistics: Statistics | None = None
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._by_channel: dict[int, Topic] = {}
        self._qos: dict[str, Qos] = {}
        self._qos_size = 0
        self._size = 0
        for record in records:
            self.add_record(record)

    def add_record(self, record: McapRecord) -> None:
        """Records of other kinds are ignored. Raises DamageError beyond the limits."""
        match record:
            case Schema() if record.id not in self._schemas:
                self._grow(len(record.data) + len(record.name) + len(record.encoding))
                self._schemas[record.id] = record
            case Channel() if record.id not in self._channels:
                self._grow(len(record.topic) + _text_size(record.metadata))
                if len(self._channels) == TOPIC_LIMIT:
                    raise DamageError(f"it has more than {TOPIC_LIMIT} channels")
                self._channels[record.id] = record
            case Metadata():
                self._grow(len(record.name) + _text_size(record.metadata))
                self.records[record.name] = record.metadata
            case Statistics():
                self.statistics = record

    @property
    def whole(self) -> bool:
        """Whether, taken from a summary, it is all that the file holds."""
        return (
            self.statistics is not None
            and self.statistics.channel_count == len(self._channels)
            and bool(self.records) == bool(self.statistics.metadata_count)
            and all(channel.schema_id in self._schemas for channel in self._channels.values())
        )

    def channels_of(self, topic: str) -> set[int]:
        return {number for number, channel in self._channels.items() if channel.topic == topic}

    def topics(self, channel_ids: Iterable[int] | None = None) -> list[Topic]:
        """Of some channels, or all. Raises ForeignError if one is not of ROS 2."""
        topics = []
        for channel_id in self._channels if channel_ids is None else channel_ids:
            try:
                topics.append(self.topic(channel_id))
            except ForeignError:
                raise
            except DamageError:  # its messages cannot be read either, and then say so
                continue
        return topics

    def topic(self, channel_id: int) -> Topic:
        """Raises ForeignError if it is not of ROS 2, DamageError if it is not in the file."""
        if channel_id not in self._by_channel:
            self._by_channel[channel_id] = self._make_topic(channel_id)
        return self._by_channel[channel_id]

    def _make_topic(self, channel_id: int) -> Topic:
        channel = self._channels.get(channel_id)
        if channel is None:
            raise DamageError(f"a message belongs to the unknown channel {channel_id}")
        name = _shown(channel.topic)
        if channel.message_encoding != MessageEncoding.CDR:
            raise ForeignError(f"{name} holds {channel.message_encoding[:_SHOWN]!r}, not CDR")
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise DamageError(f"the type of {name} is missing")
        is_text = schema.encoding == SchemaEncoding.ROS2
        return Topic(
            channel.topic,
            schema.name,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get("topic_type_hash", ""),
            self._parsed_qos(channel.metadata.get("offered_qos_profiles", "")),
        )

    def _parsed_qos(self, text: str) -> Qos:
        if text not in self._qos:
            self._qos_size += len(text)
            if self._qos_size > QOS_LIMIT:
                raise DamageError(f"its topics have more than {QOS_LIMIT} bytes of QoS")
            self._qos[text] = parse_qos(text)
        return self._qos[text]

    def _grow(self, size: int) -> None:
        self._size += size
        if self._size > CATALOGUE_LIMIT:
            raise DamageError(f"its types and records have more than {CATALOGUE_LIMIT} bytes")


def _text_size(metadata: dict[str, str]) -> int:
    return sum(len(key) + len(value) for key, value in metadata.items())


def _shown(name: str) -> str:
    return name if name.isprintable() and len(name) <= _SHOWN else repr(name[:_SHOWN])


def read_outline(file: BinaryIO) -> Catalogue:
    """What a file holds beside messages, by its summary; DamageError where that is not all."""
    catalogue = Catalogue(read_summary(file))
    if not catalogue.whole:
        raise DamageError("its summary is not complete")
    return catalogue
