"""Reads a bag, finished or not: topics, records, and messages in the order of their times."""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from io import SEEK_END, BufferedReader, BytesIO
from pathlib import Path, PurePath
from typing import Any, TypeAlias

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Metadata, Schema, Statistics
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC

from recorder import RecorderError
from recorder.bag import (
    BAG_INFORMATION,
    METADATA_FILE,
    YAML_PROBLEMS,
    BagInformation,
    RawMessage,
    Topic,
    is_evidence,
    load_yaml,
    parse_qos,
)

RECOVERY_RECORD = "recovery"
"""The metadata record of a repaired bag; its `problem` says what the torn one had lost."""

RECORD_LIMIT = 128 * 1024 * 1024
"""The most bytes of a record, and of a chunk when it is unpacked; rosbag2's have 0.75 MiB."""

HELD_LIMIT = 512 * 1024 * 1024
"""The most memory of messages that are put in order."""

_OVERHEAD_BYTES = 256
"""Memory of a message beside its data."""

_TYPES_LIMIT = 16 * 1024 * 1024
"""The most bytes of types, channels and records; those of a run have some 50 KiB."""

_TOPIC_LIMIT = 1000
METADATA_LIMIT = 1024 * 1024
_NAME_LIMIT = 80

_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

_SECTOR = 512


class ForeignError(Exception):
    """The file is no recording of ROS 2 messages; says what it is instead."""


class _DamageError(Exception):
    """A part of a file cannot be read; says why."""


_BROKEN = (EOFError, LookupError, OverflowError, ValueError, McapError, struct.error)
"""What mcap raises over a record of a stranger's file."""


@dataclass(frozen=True, slots=True)
class ChunkEnd:
    """The place where a chunk ends; the order of reading goes by chunks."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that cannot be read.

    Attributes:
        words: where it is, and what is wrong.
        tail_bytes: of the file from there on, where nothing more can be read; else None.
        is_foreign: whether it may be whole, but in a way that is not known here.
    """

    words: str
    tail_bytes: int | None = None
    is_foreign: bool = False

    @property
    def outcome(self) -> str:
        """The words, and what of the file is read all the same."""
        if self.tail_bytes is None:
            return f"{self.words}; it is left out"
        return f"{self.words}; what comes before that is read"


BagItem: TypeAlias = Topic | RawMessage | Metadata | ChunkEnd | Damage


class Bag:
    """A bag on disk; no file is held open between calls.

    Attributes:
        path: of the folder or the file.
        problem: why it is not complete, also after a repair; None = it is, as far as is known.
            `messages` adds what only reading everything shows.
        records: its metadata records by name; of several with one name the last.
    """

    def __init__(self, path: Path | str, *, evidence: bool = False) -> None:
        """Open a bag folder, recorded here or by `ros2 bag record`, or one `.mcap` file.

        An unfinished or damaged bag is opened as far as it goes. `evidence` opens the folder's
        evidence instead: cameras and other topics, in files of their own; there may be none.
        Raises RecorderError if there is nothing to read.
        """
        self.path = Path(path)
        self.problem: str | None = None
        self.records: dict[str, dict[str, str]] = {}
        self._outlines: dict[Path, Outline] = {}
        self._topics: dict[str, Topic] = {}
        try:
            files = [self.path]
            if self.path.is_dir():
                files, self.problem = bag_files(self.path, evidence=evidence)
            refuse_sqlite(self.path, files)
            self._open(files)
        except ForeignError as error:
            raise not_a_bag(self.path, error) from None
        except OSError as error:
            raise RecorderError(
                f"cannot read {error.filename or path}: {error.strerror or error}; "
                "check the path and its permissions"
            ) from None

    def _open(self, files: Iterable[Path]) -> None:
        for path in files:
            try:
                with open_recording(path) as file:
                    outline = read_outline(file)
            except (ForeignError, OSError) as error:
                if not self._outlines:
                    raise
                self._note_problem(path, f"{error}; what comes before that is read")
                return
            self._outlines[path] = outline
            self.records |= outline.records
            for topic in outline.topics.values():
                self._topics.setdefault(topic.name, topic)
            lost = outline.records.get(RECOVERY_RECORD, {}).get("problem")
            if lost is not None:
                self._note_problem(path, lost)
            if outline.damages:
                self._note_problem(path, outline.damages[0].outcome)

    @property
    def complete(self) -> bool:
        """Whether every message is there, as far as is known."""
        return self.problem is None

    def topics(self) -> tuple[Topic, ...]:
        return tuple(self._topics.values())

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of time (protocol section 3); never raises.

        Files come by their first log times. If the first log times of their chunks never go back,
        messages come as they are stored; else all are sorted by log time, in memory. Damaged
        chunks are left out. `problem` tells them, and a torn end.
        """
        paths = sorted(
            self._outlines, key=lambda path: min(self._outlines[path].chunk_starts, default=0)
        )
        starts = [start for path in paths for start in self._outlines[path].chunk_starts]
        items = self._all_items(paths)
        if starts == sorted(starts):
            for item in items:
                if isinstance(item, RawMessage):
                    yield item
            return

        held: list[RawMessage] = []
        size = 0
        outline = Outline()  # of what can be read: a damaged chunk is of no order
        for item in items:
            outline.add(item)
            if isinstance(item, RawMessage):
                held.append(item)
                size += len(item.data) + _OVERHEAD_BYTES
            if size > HELD_LIMIT:
                self._note_problem(self.path, "it is too large to be put in the order of its times")
                break
        if outline.chunk_starts != sorted(outline.chunk_starts):
            held.sort(key=lambda message: message.receive_ns)
        yield from held

    def _all_items(self, paths: Iterable[Path]) -> Iterator[BagItem]:
        for path in paths:
            yield from self._items(path)

    def nearest(self, topic: str, at_ns: int, within_ns: int) -> RawMessage | None:
        """Return the message of a topic that was received nearest to an instant.

        Instant and distance are in ns; None = none is so near. What cannot be read is passed over.
        """
        for distance in (within_ns // 10, within_ns):  # most are near: little is unpacked
            window = range(at_ns - distance, at_ns + distance + 1)
            found = list(self._in_window(topic, window))
            if found:
                return min(found, key=lambda message: abs(message.receive_ns - at_ns))
        return None

    def _in_window(self, topic: str, window: range) -> Iterator[RawMessage]:
        for path, outline in self._outlines.items():
            for item in self._items(path, outline.overlapping(topic, window)):
                if not isinstance(item, RawMessage) or item.topic != topic:
                    continue
                if item.receive_ns in window:
                    yield item

    def _items(self, path: Path, only: Iterable[ChunkIndex] | None = None) -> Iterator[BagItem]:
        """Yield what is in a file, or in some of its chunks, and note what is damaged."""
        try:
            with open_recording(path) as file:
                reading = FileReading(file, self._outlines[path].channels)
                items = reading.items() if only is None else reading.items_of(only)
                for item in items:
                    if isinstance(item, Damage):
                        self._note_problem(path, item.outcome)
                    yield item
        except (ForeignError, OSError) as error:
            self._note_problem(path, f"{error}; what comes before that is read")

    def _note_problem(self, file: Path, problem: str) -> None:
        self.problem = self.problem or f"{file}: {problem}"


@dataclass(slots=True)
class Outline:
    """What a file holds beside messages, in its summary or by reading all of it.

    Attributes:
        topics: by name.
        channels: topics by the number of their channel.
        counts: messages by topic.
        start_ns, end_ns: first and last log time; None without messages.
        damages: what cannot be read.
        chunk_starts: first log time of each chunk that has messages, as they are stored.
        chunks: the index; empty where there is none that can be trusted.
    """

    topics: dict[str, Topic] = field(default_factory=dict)
    channels: dict[int, Topic] = field(default_factory=dict)
    records: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    damages: list[Damage] = field(default_factory=list)
    chunk_starts: list[int] = field(default_factory=list)
    chunks: list[ChunkIndex] = field(default_factory=list)
    _chunk_start: int | None = None

    @property
    def tail_bytes(self) -> int:
        """Bytes of the unreadable end."""
        return sum(damage.tail_bytes or 0 for damage in self.damages)

    def information(self, name: str) -> BagInformation:
        topics = list(self.topics.values())
        return BagInformation(name, topics, self.counts, self.start_ns, self.end_ns)

    def overlapping(self, topic: str, window: range) -> list[ChunkIndex] | None:
        """Return the chunks with messages of a topic in a window; None where no index tells."""
        if not self.chunks:
            return None
        numbers = {number for number, known in self.channels.items() if known.name == topic}
        return [
            chunk
            for chunk in self.chunks
            if chunk.message_start_time < window.stop
            and chunk.message_end_time >= window.start
            and not (
                chunk.message_index_offsets and numbers.isdisjoint(chunk.message_index_offsets)
            )
        ]

    def add(self, item: BagItem) -> None:
        match item:
            case RawMessage():
                time = item.receive_ns
                self.counts[item.topic] += 1
                self.start_ns = time if self.start_ns is None else min(time, self.start_ns)
                self.end_ns = time if self.end_ns is None else max(time, self.end_ns)
                start = self._chunk_start
                self._chunk_start = time if start is None else min(time, start)
            case ChunkEnd() if self._chunk_start is not None:
                self.chunk_starts.append(self._chunk_start)
                self._chunk_start = None
            case Topic():
                self.topics.setdefault(item.name, item)
            case Metadata():
                self.records[item.name] = item.metadata
            case Damage():
                self.damages.append(item)


def read_outline(file: BufferedReader) -> Outline:
    """Return what a file holds beside messages; raises ForeignError if it is no recording.

    It comes from the summary; where that is missing or damaged the whole file is read.
    """
    outline = read_summary(file)
    if outline is not None:
        return outline
    outline = Outline()
    try:
        for item in FileReading(file).items():
            outline.add(item)
    except OSError as error:
        outline.add(Damage(f"it cannot be read ({error})", 0))
    return outline


def read_items(file: BufferedReader) -> Iterator[BagItem]:
    """Yield everything in a recording; the summary tells the channels that damage hides."""
    summary = read_summary(file)
    yield from FileReading(file, None if summary is None else summary.channels).items()


def read_summary(file: BufferedReader) -> Outline | None:
    """Return what the summary of a file says; None where it cannot be trusted or is not there."""
    try:
        place = file.seek(-FOOTER_SIZE - len(MCAP0_MAGIC), SEEK_END)
        if not _has_summary(file, place):
            return None
        return _summary_outline(file)
    except ForeignError:
        raise
    except Exception:  # noqa: BLE001 - whatever is wrong with it, the file tells more
        return None


def _has_summary(file: BufferedReader, place: int) -> bool:
    """Whether a checksum in the footer there says that the summary is what was written.

    Raises _DamageError if it says that it is not.
    """
    file.seek(place + _HEAD.size)
    start, _, checksum = _FOOTER.unpack(file.read(_FOOTER.size))
    if not checksum or not start:
        return False
    if 0 < place - start <= RECORD_LIMIT:
        file.seek(start)
        if zlib.crc32(file.read(place + FOOTER_SIZE - 4 - start)) == checksum:
            return True
    raise _DamageError("the checksum of its summary is wrong")


def _summary_outline(file: BufferedReader) -> Outline | None:
    file.seek(0)
    summary = SeekingReader(file, record_size_limit=RECORD_LIMIT).get_summary()
    statistics = None if summary is None else summary.statistics
    if summary is None or statistics is None:
        return None
    chunks = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    metadata = summary.metadata_indexes
    stated = statistics.channel_count, statistics.chunk_count, statistics.metadata_count
    if stated != (len(summary.channels), len(chunks), len(metadata)):
        return None
    if statistics.message_count and not chunks:
        return None
    if sum(index.length for index in metadata) > _TYPES_LIMIT:
        return None

    reading = FileReading(file)
    outline = Outline(channels=reading.topics, chunks=chunks)
    for schema in summary.schemas.values():
        reading.add_schema(schema)
    for channel in summary.channels.values():
        outline.add(reading.add_channel(channel))
    for index in metadata:
        outline.add(Metadata.read(_stream(reading.record_at(index.offset)[1])))
    for number, count in statistics.channel_message_counts.items():
        outline.counts[reading.topics[number].name] += count
    if statistics.message_count:
        outline.start_ns = statistics.message_start_time
        outline.end_ns = statistics.message_end_time
    for chunk in chunks:
        if chunk.message_end_time:
            outline.chunk_starts.append(chunk.message_start_time)
    return outline


class FileReading:
    """Reads a recording from its beginning to its end, or some of its chunks.

    Args:
        channels: those that the summary tells: a damaged chunk may have held them.

    Attributes:
        topics: by the numbers of their channels, within the limits of a bag.
    """

    def __init__(self, file: BufferedReader, channels: dict[int, Topic] | None = None) -> None:
        self._file = file
        self._size = file.seek(0, SEEK_END)
        self.topics = dict(channels or {})
        self._schemas: dict[int, Schema] = {}
        self._types_size = 0
        self._count = 0
        self._stated: int | None = None
        self._is_chunked = False
        self._is_damaged = False

    def items(self) -> Iterator[BagItem]:
        """Yield everything in storage order, a topic before its messages, up to where it breaks.

        A damaged chunk is a `Damage`; of the chunk in which the file ends the whole messages are
        there. Raises ForeignError if it is no recording, OSError if the disk refuses.
        """
        place = len(MCAP0_MAGIC)
        self._file.seek(0)
        if self._file.read(place) != MCAP0_MAGIC:
            raise ForeignError(
                "it does not begin like an MCAP file" if self._size else "it is empty"
            )
        yield from list(self.topics.values())
        try:
            opcode = 0
            while opcode != Opcode.FOOTER:
                opcode, content, is_cut = self.record_at(place)
                yield from self._record(opcode, content, place, is_cut=is_cut)
                place += _HEAD.size + len(content)
        except _DamageError as error:
            yield Damage(str(error), self._size - place)
        except _BROKEN:
            yield Damage(f"the record at byte {place} is damaged", self._size - place)
        else:
            if self._stated not in (None, self._count) and not self._is_damaged:
                yield Damage(f"{self._count} of {self._stated} messages are left", 0)

    def items_of(self, chunks: Iterable[ChunkIndex]) -> Iterator[BagItem]:
        """Yield what is in some chunks, each where the index says."""
        for index in chunks:
            place = index.chunk_start_offset
            try:
                yield from self._chunk(self.record_at(place)[1], place)
            except (_DamageError, *_BROKEN):
                yield Damage(f"a chunk is not where it should be (byte {place})")

    def record_at(self, place: int) -> tuple[int, bytes, bool]:
        """Return opcode and content of a record, and whether it is the chunk the file ends in."""
        self._file.seek(place)
        head = self._file.read(_HEAD.size)
        if not head:
            raise _DamageError(f"it ends at byte {place} without a footer")
        if not any(head):  # left by a power cut
            raise _DamageError(f"there are only zeros from byte {place} on")
        if len(head) < _HEAD.size:
            raise _DamageError(f"it is torn at byte {place}")
        opcode, length = _HEAD.unpack(head)
        is_cut = place + _HEAD.size + length > self._size
        if is_cut and opcode != Opcode.CHUNK:
            raise _DamageError(f"it is torn at byte {place}")
        if length > RECORD_LIMIT and not is_cut:
            raise _DamageError(f"the record at byte {place} has more than {RECORD_LIMIT} bytes")
        return opcode, self._file.read(min(length, RECORD_LIMIT, self._size)), is_cut

    def _record(
        self, opcode: int, content: bytes, place: int, *, is_cut: bool
    ) -> Iterator[BagItem]:
        match opcode:
            case Opcode.CHUNK:
                self._is_chunked = True
                yield from self._chunk(content, place, is_cut=is_cut)
            case Opcode.MESSAGE if self._is_chunked:  # one flipped bit makes one of an index
                yield Damage(f"there is a message outside of the chunks (byte {place})")
            case Opcode.METADATA:
                record = Metadata.read(_stream(content))
                self._grow(len(record.name) + _text_size(record.metadata))
                yield record
            case Opcode.STATISTICS:
                self._stated = Statistics.read(_stream(content)).message_count
            case Opcode.FOOTER:
                if self._file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                    raise _DamageError(f"there is no end mark behind the footer at byte {place}")
                try:
                    _has_summary(self._file, place)
                except _DamageError as error:
                    yield Damage(str(error), 0)
            case _:
                item = self._item(opcode, content)
                if item is not None:
                    yield item
                yield ChunkEnd()

    def _chunk(self, content: bytes, place: int, *, is_cut: bool = False) -> Iterator[BagItem]:
        problem = None
        is_foreign = False
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(content)) if is_cut else _stream(content))
            is_foreign = chunk.compression not in _COMPRESSIONS
            records, problem = unpack(chunk, is_cut=is_cut)
            yield from self._items_in(records)
        except _DamageError as error:
            problem = problem or f"is of no use: {error}"
        except _BROKEN:
            problem = problem or "has a damaged record"
        yield ChunkEnd()
        if is_cut:
            raise _DamageError(f"it is torn at byte {place}")
        if problem is not None:
            self._is_damaged = True
            yield Damage(f"a chunk {problem} (byte {place})", is_foreign=is_foreign)

    def _items_in(self, records: bytes) -> Iterator[BagItem]:
        """Yield what is in an unpacked chunk."""
        end = 0
        while end < len(records):
            opcode, length = _HEAD.unpack_from(records, end)
            start = end + _HEAD.size
            end = start + length
            if end > len(records) or opcode == 0:
                raise ValueError
            item = self._item(opcode, records[start:end])
            if item is not None:
                yield item

    def _item(self, opcode: int, content: bytes) -> Topic | RawMessage | None:
        """Return the item that a record is, if it is one, and note a schema."""
        if opcode == Opcode.SCHEMA:
            self.add_schema(Schema.read(_stream(content)))
        if opcode == Opcode.CHANNEL:
            return self.add_channel(Channel.read(_stream(content)))
        if opcode != Opcode.MESSAGE:
            return None
        channel, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content)
        topic = self.topics.get(channel)
        if topic is None:
            raise _DamageError(f"it has a message of the unknown channel {channel}")
        self._count += 1
        data = content[_MESSAGE_HEAD.size :]
        return RawMessage(topic.name, topic.type, data, publish_ns, log_ns, sequence)

    def add_schema(self, schema: Schema) -> None:
        if schema.id not in self._schemas:
            self._grow(len(schema.data) + len(schema.name))
            self._schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> Topic:
        """Return the channel's topic; raises ForeignError if it is not of ROS 2."""
        if channel.id in self.topics:
            return self.topics[channel.id]
        self._grow(len(channel.topic) + _text_size(channel.metadata))
        if len(self.topics) == _TOPIC_LIMIT:
            raise _DamageError(f"it has more than {_TOPIC_LIMIT} channels")
        name = channel.topic
        if not name.isprintable() or len(name) > _NAME_LIMIT:
            name = repr(name[:_NAME_LIMIT])
        if channel.message_encoding != MessageEncoding.CDR:
            encoding = channel.message_encoding[:_NAME_LIMIT]
            raise ForeignError(f"{name} holds {encoding!r}, not CDR")
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise _DamageError(f"the type of {name} is missing")
        is_text = schema.encoding == SchemaEncoding.ROS2
        topic = Topic(
            channel.topic,
            schema.name,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get("topic_type_hash", ""),
            _parse_qos(channel.metadata.get("offered_qos_profiles", "")),
        )
        self.topics[channel.id] = topic
        return topic

    def _grow(self, size: int) -> None:
        self._types_size += size
        if self._types_size > _TYPES_LIMIT:
            raise _DamageError(f"its types and records have more than {_TYPES_LIMIT} bytes")


_parse_qos = lru_cache(maxsize=100)(parse_qos)


def _text_size(metadata: dict[str, str]) -> int:
    return sum(len(key) + len(value) for key, value in metadata.items())


class _Content(BytesIO):
    """The content of a record; it may claim no more than there is."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if len(data) < (size or 0):
            raise EOFError
        return data


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(_Content(content))


# The content of a chunk.

_COMPRESSIONS = ("", "zstd", "lz4")


def unpack(chunk: Chunk, *, is_cut: bool = False) -> tuple[bytes, str | None]:
    """Return the records of a chunk, and what is wrong with it, as the end of a sentence.

    A chunk is believed if its size and its checksum are right. Of one that `is_cut`, or ends in
    sectors that a power cut left empty, what comes before that is there.
    """
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        return b"", f"claims {size} bytes"
    if chunk.compression not in _COMPRESSIONS:
        return b"", f"has the unknown compression {chunk.compression[:_NAME_LIMIT]!r}"
    content = _decompress(chunk.compression, chunk.data, size)
    if is_cut:
        problem = "is cut off"
    elif len(content) != size:
        problem = "cannot be decompressed to the size that it claims"
    elif chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        problem = "has a wrong checksum"
    else:
        return content, None

    solid = chunk.data.rstrip(b"\0")
    if len(chunk.data) - len(solid) >= _SECTOR:
        return _decompress(chunk.compression, solid, size), problem
    return content if is_cut else b"", problem


def _decompress(compression: str, data: bytes, size: int) -> bytes:
    """Return what data hold, up to where they are cut, at most a byte more than `size`."""
    content = data[: size + 1]
    try:
        if compression == "zstd":
            content = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        elif compression == "lz4":
            content = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    except Exception:  # noqa: BLE001 - the libraries raise errors of many kinds
        return b""
    return content


# The files of a bag.


def open_recording(path: str | Path, folder_fd: int | None = None) -> BufferedReader:
    """Open a file to read; raises ForeignError for a pipe or a folder, OSError for a link.

    A link is refused in an open folder only.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe must not block
    if folder_fd is not None:
        flags |= os.O_NOFOLLOW
    number = os.open(path, flags, dir_fd=folder_fd)
    if stat.S_ISREG(os.fstat(number).st_mode):
        return os.fdopen(number, "rb")
    os.close(number)
    raise ForeignError(f"{PurePath(path).name} is not a file")


def not_a_bag(path: Path, error: ForeignError) -> RecorderError:
    return RecorderError(
        f"{path} is no bag: {error}; choose a rosbag2 bag folder or an .mcap file of ROS 2"
    )


def bag_files(folder: Path, *, evidence: bool = False) -> tuple[list[Path], str | None]:
    """Return the recordings of a bag in their order, and why they may not be all.

    Evidence is found by its name, whether `metadata.yaml` lists it yet or not. Raises ForeignError
    without a recording, and RecorderError if they are compressed as a whole.
    """
    there = sorted(folder.iterdir(), key=natural_order)
    if evidence:
        return [path for path in there if is_evidence(path.name)], None
    try:
        information = bag_information(folder)
        names = listed_names(information)
    except FileNotFoundError:
        problem = f"{folder} has no {METADATA_FILE}, so its recording was not finished"
    except YAML_PROBLEMS:
        problem = f"{folder / METADATA_FILE} is damaged"
    else:
        if str(information.get("compression_mode", "")).lower() in {"file", "message"}:
            raise RecorderError(
                f"{folder} is compressed by rosbag2 as a whole; unpack it by `ros2 bag convert`"
            )
        return [folder / name for name in names if not is_evidence(name)], None
    recordings = [path for path in there if path.suffix in {".mcap", ".db3"}]
    recordings = [path for path in recordings if not is_evidence(path.name)]
    if not recordings:
        raise ForeignError("the folder holds no recording")
    return recordings, problem


def bag_information(folder: Path) -> dict[str, Any]:
    """Return the content of `metadata.yaml`, unchecked.

    Raises YAML_PROBLEMS if it is damaged, ForeignError if it is not a file.
    """
    with open_recording(folder / METADATA_FILE) as file:
        return information_in(file.read(METADATA_LIMIT))


def information_in(metadata: bytes) -> dict[str, Any]:
    document: Any = load_yaml(metadata.decode())
    information: dict[str, Any] = document[BAG_INFORMATION]
    return information


def listed_names(information: dict[str, Any]) -> list[str]:
    """Return the files that `metadata.yaml` lists; raises YAML_PROBLEMS if there are none."""
    # Early versions put the folder's name before the file's.
    names = [PurePath(name).name for name in information["relative_file_paths"]]
    if not names or not all(name.isprintable() for name in names) or len(set(names)) < len(names):
        raise ValueError
    return names


def refuse_sqlite(path: Path, files: Iterable[Path]) -> None:
    if any(file.suffix == ".db3" for file in files):
        raise RecorderError(f"{path} is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`")


def natural_order(path: Path | str) -> list[int | str]:
    """Return a key that sorts by the numbers in names: `bag_10.mcap` comes after `bag_9.mcap`."""
    parts = re.split(r"(\d+)", PurePath(path).name)
    return [int(part) if part.isdecimal() else part for part in parts]
