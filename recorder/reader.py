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
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Channel, Chunk, Metadata, Schema, Statistics
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC

from recorder import RecorderError
from recorder.bag import (
    BAG_INFORMATION,
    EVIDENCE,
    METADATA_FILE,
    YAML_PROBLEMS,
    BagInformation,
    Batch,
    RawMessage,
    Topic,
    load_yaml,
    parse_qos,
)

RECOVERY_RECORD = "recovery"
"""The metadata record of a repaired bag; its `problem` says what the torn one had lost."""

RECORD_LIMIT = 128 * 1024 * 1024
"""The most bytes of a record, and of a chunk when it is unpacked; rosbag2's have 0.75 MiB."""

HELD_LIMIT = 512 * 1024 * 1024
"""The most memory of messages that are put in order."""

_METADATA_LIMIT = 1024 * 1024

_OVERHEAD_BYTES = 256
"""Memory of a message beside its data."""

_NAME_LIMIT = 80
"""Characters of a stranger's name that are shown."""

_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

_SECTOR = 512

_ENDS = "; what comes before that is read"


class ForeignError(Exception):
    """The file is no recording of ROS 2 messages; says what it is instead."""


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

        An unfinished or damaged bag is opened as far as it goes. `evidence` opens what was recorded
        beside the bag of this folder instead, cameras and other topics, in all of the bags in it;
        there may be none. Raises RecorderError if there is nothing to read.
        """
        self.path = Path(path)
        self.problem: str | None = None
        self.records: dict[str, dict[str, str]] = {}
        self._outlines: dict[Path, Outline] = {}
        self._topics: dict[str, Topic] = {}
        try:
            files = [self.path]
            if evidence:
                files = evidence_files(self.path)
            elif self.path.is_dir():
                files, self.problem = bag_files(self.path)
            refuse_sqlite(self.path, files)
            self._open(files, apart=evidence)
        except ForeignError as error:
            raise not_a_bag(self.path, error) from None
        except OSError as error:
            raise RecorderError(
                f"cannot read {error.filename or path}: {error.strerror or error}; "
                "check the path and its permissions"
            ) from None

    def _open(self, files: Iterable[Path], *, apart: bool) -> None:
        """Open files up to the first bad one, or of bags that are `apart` all that can be read."""
        for path in files:
            try:
                with open_recording(path) as file:
                    outline = read_outline(file)
            except (ForeignError, OSError) as error:
                if apart:
                    self._note_problem(path, f"{error}; it is left out")
                    continue
                if not self._outlines:
                    raise
                self._note_problem(path, f"{error}{_ENDS}")
                return
            self._outlines[path] = outline
            self.records |= outline.records
            for name, topic in outline.topics.items():
                self._topics.setdefault(name, topic)
            lost = outline.records.get(RECOVERY_RECORD, {}).get("problem")
            for problem in (lost, *outline.problems):
                self._note_problem(path, problem)

    @property
    def complete(self) -> bool:
        """Whether every message is there, as far as is known."""
        return self.problem is None

    def topics(self) -> tuple[Topic, ...]:
        return tuple(self._topics.values())

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of time (protocol section 3).

        Never raises.

        Files come by their first log times. If the first log times of their chunks never go back,
        messages come as they are stored; else all are sorted by log time, in memory. Damaged
        chunks are left out. `problem` tells them, and a torn end.
        """
        paths = sorted(self._outlines, key=lambda path: self._outlines[path].start_ns or 0)
        outlines = [self._outlines[path] for path in paths]
        if _is_in_order(outlines):
            for part in self._all_parts(paths):
                yield from part.messages
            return

        held: list[RawMessage] = []
        size = 0
        outline = Outline()  # of what can be read: a damaged chunk is of no order
        for part in self._all_parts(paths):
            outline.add(part)
            held += part.messages
            size += sum(len(message.data) + _OVERHEAD_BYTES for message in part.messages)
            if size > HELD_LIMIT:
                self._note_problem(self.path, "it is too large to be put in the order of its times")
                break
        if not _is_in_order([outline]):
            held.sort(key=lambda message: message.receive_ns)
        yield from held

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
            for part in self._parts(path, outline.places_within(window)):
                for message in part.messages:
                    if message.topic == topic and message.receive_ns in window:
                        yield message

    def _all_parts(self, paths: Iterable[Path]) -> Iterator[Part]:
        for path in paths:
            yield from self._parts(path, None)

    def _parts(self, path: Path, places: Iterable[int] | None) -> Iterator[Part]:
        """Yield the parts of a file, or those at some places of it, and note what is damaged."""
        try:
            with open_recording(path) as file:
                reader = FileReader(file, self._outlines[path].channels)
                parts = reader.parts() if places is None else map(reader.part_at, places)
                for part in parts:
                    self._note_problem(path, part.problem)
                    yield part
        except (ForeignError, OSError) as error:
            self._note_problem(path, f"{error}{_ENDS}")

    def _note_problem(self, file: Path, problem: str | None) -> None:
        if problem is not None and self.problem is None:
            self.problem = f"{file}: {problem}"


@dataclass(slots=True)
class Part(Batch):
    """What a chunk holds, or a record outside of the chunks.

    Attributes:
        problem: what of it cannot be read, and what became of the rest; None = all was read.
        is_end: nothing behind it can be read.
        place, size: in the file, bytes.
    """

    problem: str | None = None
    is_end: bool = False
    place: int = 0
    size: int = 0


@dataclass(slots=True)
class Outline:
    """What a file holds beside messages, in its summary or by reading all of it.

    Attributes:
        topics: by name.
        channels: topics by the number of their channel.
        counts: messages by topic.
        problems: what cannot be read.
        starts, ends: first and last log times of the parts that have messages, as they are stored.
        places: of these parts in the file.
    """

    topics: dict[str, Topic] = field(default_factory=dict)
    channels: dict[int, Topic] = field(default_factory=dict)
    records: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)

    @property
    def start_ns(self) -> int | None:
        return min(self.starts, default=None)

    def information(self, name: str) -> BagInformation:
        end_ns = max(self.ends, default=None)
        return BagInformation(name, list(self.topics.values()), self.counts, self.start_ns, end_ns)

    def places_within(self, window: range) -> list[int]:
        """Return the places of the parts with messages in a window."""
        return [
            place
            for place, start, end in zip(self.places, self.starts, self.ends, strict=True)
            if start < window.stop and end >= window.start
        ]

    def add(self, part: Part) -> None:
        for topic in part.topics:
            self.topics.setdefault(topic.name, topic)
        self.records |= part.records
        if part.problem is not None:
            self.problems.append(part.problem)
        if part.messages:
            times = [message.receive_ns for message in part.messages]
            self.places.append(part.place)
            self.starts.append(min(times))
            self.ends.append(max(times))
            self.counts.update(message.topic for message in part.messages)


def _is_in_order(outlines: Iterable[Outline]) -> bool:
    starts = [start for outline in outlines for start in outline.starts]
    return starts == sorted(starts)


def read_outline(file: BufferedReader) -> Outline:
    """Return what a file holds beside messages.

    Raises ForeignError if it is no recording.

    It comes from the summary; where that is missing or damaged the whole file is read.
    """
    outline = read_summary(file)
    if outline is not None:
        return outline
    outline, is_early = _read_whole(file, {})
    if is_early:  # what comes behind a damage may tell the channels of messages before it
        outline, _ = _read_whole(file, outline.channels)
    return outline


def _read_whole(file: BufferedReader, channels: dict[int, Topic]) -> tuple[Outline, bool]:
    """Return what is in the whole file, and whether a channel came behind a damage."""
    reader = FileReader(file, channels)
    outline = Outline(channels=reader.topics)
    known: int | None = None
    try:
        for part in reader.parts():
            if part.problem is not None and known is None:
                known = len(reader.topics)
            outline.add(part)
    except OSError as error:
        outline.problems.append(f"it cannot be read ({error}){_ENDS}")
    return outline, known is not None and known < len(reader.topics)


def read_parts(file: BufferedReader) -> Iterator[Part]:
    """Yield everything in a recording.

    Its end may tell the channels that damage hides.
    """
    return FileReader(file, read_outline(file).channels).parts()


def read_summary(file: BufferedReader) -> Outline | None:
    """Return what the summary of a file says.

    None where it cannot be trusted or is not there.
    """
    try:
        place = file.seek(-FOOTER_SIZE - len(MCAP0_MAGIC), SEEK_END)
        if not _is_summary_sound(file, place):
            return None
        return _summary_outline(file)
    except ForeignError:
        raise
    except Exception:  # noqa: BLE001 - whatever is wrong with it, the file tells more
        return None


def _is_summary_sound(file: BufferedReader, place: int) -> bool | None:
    """Return whether the checksum of the footer there is that of the summary.

    None without one.
    """
    file.seek(place + _HEAD.size)
    start, _, checksum = _FOOTER.unpack(file.read(_FOOTER.size))
    if not checksum or not start:
        return None
    if not 0 < place - start <= RECORD_LIMIT:
        return False
    file.seek(start)
    return bool(zlib.crc32(file.read(place + FOOTER_SIZE - 4 - start)) == checksum)


def _summary_outline(file: BufferedReader) -> Outline | None:
    """Return what the summary says, unless it leaves something out."""
    file.seek(0)
    summary = SeekingReader(file, record_size_limit=RECORD_LIMIT).get_summary()
    if summary is None or summary.statistics is None:
        return None
    chunks = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    metadata = summary.metadata_indexes
    stated = summary.statistics
    counts = stated.channel_count, stated.chunk_count, stated.metadata_count
    if counts != (len(summary.channels), len(chunks), len(metadata)):
        return None
    if stated.message_count and not chunks:
        return None

    reader = FileReader(file)
    outline = Outline(channels=reader.topics)
    for schema in summary.schemas.values():
        reader.add_schema(schema)
    for channel in summary.channels.values():
        topic = reader.add_channel(channel)
        outline.topics.setdefault(topic.name, topic)
        outline.counts[topic.name] += stated.channel_message_counts.get(channel.id, 0)
    for index in metadata:
        outline.records |= reader.part_at(index.offset).records
    is_indexed = any(chunk.message_index_offsets for chunk in chunks)
    for chunk in chunks:
        if chunk.message_end_time or chunk.message_index_offsets:
            outline.starts.append(chunk.message_start_time)
            outline.ends.append(chunk.message_end_time)
            outline.places.append(chunk.chunk_start_offset)
        elif stated.message_count and not is_indexed:
            return None  # it has no messages, or all of them at time 0
    return outline


class FileReader:
    """Reads a recording from its beginning to its end, or some of its parts.

    Args:
        topics: by the numbers of their channels, as an outline has them: a damaged chunk may have
            held them.
    """

    def __init__(self, file: BufferedReader, topics: dict[int, Topic] | None = None) -> None:
        self._file = file
        self._size = file.seek(0, SEEK_END)
        self.topics = dict(topics or {})
        self._schemas: dict[int, Schema] = {}
        self._count = 0
        self._stated: int | None = None
        self._has_chunks = False
        self._has_gaps = False

    def parts(self) -> Iterator[Part]:
        """Yield everything in storage order, a topic before its messages, up to where it breaks.

        A damaged chunk is left out; of the chunk in which the file ends the whole messages are
        there. Raises ForeignError if it is no recording, OSError if the disk refuses.
        """
        place = len(MCAP0_MAGIC)
        self._file.seek(0)
        if self._file.read(place) != MCAP0_MAGIC:
            raise ForeignError(
                "it does not begin like an MCAP file" if self._size else "it is empty"
            )
        part = Part(list(self.topics.values()))
        while not part.is_end:
            yield part
            part = self.part_at(place)
            place += part.size
        yield part

    def part_at(self, place: int) -> Part:
        """Return what the record at a place of the file holds.

        OSError if the disk refuses.
        """
        torn = f"it is torn at byte {place} of {self._size}{_ENDS}"
        self._file.seek(place)
        head = self._file.read(_HEAD.size)
        if len(head) < _HEAD.size or not head[0]:  # a power cut leaves zeros
            return Part(problem=torn, is_end=True)
        opcode, length = _HEAD.unpack(head)
        if length > RECORD_LIMIT:
            problem = f"the record at byte {place} has more than {RECORD_LIMIT} bytes{_ENDS}"
            return Part(problem=problem, is_end=True)
        content = self._file.read(min(length, self._size))
        is_cut = len(content) < length
        if is_cut and opcode != Opcode.CHUNK:
            return Part(problem=torn, is_end=True)

        is_end = is_cut or opcode == Opcode.FOOTER
        part = Part(is_end=is_end, place=place, size=_HEAD.size + length)
        try:
            damage = self._add_record(part, opcode, content, is_cut=is_cut)
        except ForeignError:
            raise
        except Exception:  # noqa: BLE001 - whatever a stranger's bytes do, they are damaged
            damage = "a chunk is damaged" if opcode == Opcode.CHUNK else "a record is damaged"
        if is_cut:
            part.problem = torn
        elif damage is not None:
            self._has_gaps = True
            part.problem = f"{damage} (byte {place}); it is left out"
        elif opcode == Opcode.FOOTER:
            part.problem = self._end_problem(place)
        return part

    def _add_record(
        self, part: Part, opcode: int, content: bytes, *, is_cut: bool = False
    ) -> str | None:
        """Add what is in a record of the file, and return what is wrong with it, or raise."""
        if opcode == Opcode.CHUNK:
            self._has_chunks = True
            chunk = Chunk.read(ReadDataStream(BytesIO(content)) if is_cut else _stream(content))
            records, problem = unpack(chunk, is_cut=is_cut)
            self._add_items(part, records)
            return problem
        if opcode == Opcode.MESSAGE and self._has_chunks:  # one flipped bit makes one of an index
            return "a message stands outside of the chunks"
        if opcode == Opcode.METADATA:
            record = Metadata.read(_stream(content))
            part.records[record.name] = record.metadata
        elif opcode == Opcode.STATISTICS:
            self._stated = Statistics.read(_stream(content)).message_count
        else:
            self._add_items(part, _HEAD.pack(opcode, len(content)) + content)
        return None

    def _add_items(self, part: Part, records: bytes) -> None:
        """Add schemas, channels and messages.

        Raises where a record breaks.
        """
        end = 0
        while end < len(records):
            opcode, length = _HEAD.unpack_from(records, end)
            start = end + _HEAD.size
            end = start + length
            if end > len(records) or not opcode:
                raise ValueError
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(records, start)
                if length < _MESSAGE_HEAD.size:
                    raise ValueError
                topic = self.topics[channel]
                data = records[start + _MESSAGE_HEAD.size : end]
                part.messages.append(
                    RawMessage(topic.name, topic.type, data, publish_ns, log_ns, sequence)
                )
                self._count += 1
            elif opcode == Opcode.SCHEMA:
                self.add_schema(Schema.read(_stream(records[start:end])))
            elif opcode == Opcode.CHANNEL:
                part.topics.append(self.add_channel(Channel.read(_stream(records[start:end]))))

    def add_schema(self, schema: Schema) -> None:
        self._schemas.setdefault(schema.id, schema)

    def add_channel(self, channel: Channel) -> Topic:
        """Return the channel's topic.

        ForeignError if it is not of ROS 2, KeyError without type.
        """
        if channel.id in self.topics:
            return self.topics[channel.id]
        if channel.message_encoding != MessageEncoding.CDR:
            name = repr(channel.topic[:_NAME_LIMIT])
            encoding = repr(channel.message_encoding[:_NAME_LIMIT])
            raise ForeignError(f"{name} holds {encoding}, not CDR")
        schema = self._schemas[channel.schema_id]
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

    def _end_problem(self, place: int) -> str | None:
        """Return what the footer, the end mark or the statistics find missing."""
        if self._file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return f"there is no end mark behind the footer{_ENDS}"
        if self._file.tell() < self._size:
            return f"its end mark is at byte {self._file.tell()} of {self._size}{_ENDS}"
        if _is_summary_sound(self._file, place) is False:
            return f"the checksum of its summary is wrong{_ENDS}"
        if self._stated not in (None, self._count) and not self._has_gaps:
            return f"{self._count} of {self._stated} messages are left{_ENDS}"
        return None


_parse_qos = lru_cache(maxsize=100)(parse_qos)


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


def unpack(chunk: Chunk, *, is_cut: bool = False) -> tuple[bytes, str | None]:
    """Return the records of a chunk, and what is wrong with it.

    A chunk is believed if its size and its checksum are right. Of one that `is_cut`, or ends in
    sectors that a power cut left empty, what comes before that is there.
    """
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        return b"", f"a chunk claims {size} bytes"
    if chunk.compression not in ("", "zstd", "lz4"):
        return b"", f"a chunk has the unknown compression {chunk.compression[:_NAME_LIMIT]!r}"
    content = _decompress(chunk.compression, chunk.data, size)
    is_sound = not chunk.uncompressed_crc or zlib.crc32(content) == chunk.uncompressed_crc
    if len(content) == size and is_sound and not is_cut:
        return content, None

    problem = "a chunk has a wrong size or checksum"
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


def open_recording(path: Path) -> BufferedReader:
    """Open a file to read.

    Raises ForeignError for a pipe or a folder.
    """
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe must not block
    if stat.S_ISREG(os.fstat(number).st_mode):
        return os.fdopen(number, "rb")
    os.close(number)
    raise ForeignError(f"{path.name} is not a file")


def not_a_bag(path: Path, error: ForeignError) -> RecorderError:
    return RecorderError(
        f"{path} is no bag: {error}; choose a rosbag2 bag folder or an .mcap file of ROS 2"
    )


def bag_files(folder: Path) -> tuple[list[Path], str | None]:
    """Return the recordings of a bag in their order, and why they may not be all.

    Raises ForeignError without a recording, RecorderError if they are compressed as a whole.
    """
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
        return [folder / name for name in names], None
    there = sorted(folder.iterdir(), key=natural_order)
    recordings = [path for path in there if path.suffix in {".mcap", ".db3"}]
    if not recordings:
        raise ForeignError("the folder holds no recording")
    return recordings, problem


def evidence_files(folder: Path) -> list[Path]:
    """Return the recordings of the bags in a run's folder, which hold its evidence."""
    return sorted(folder.glob(f"*{EVIDENCE}*/*.mcap"), key=natural_order)


def bag_information(folder: Path) -> dict[str, Any]:
    """Return the content of `metadata.yaml`, unchecked.

    Raises YAML_PROBLEMS if it is damaged, ForeignError if it is not a file.
    """
    with open_recording(folder / METADATA_FILE) as file:
        document: Any = load_yaml(file.read(_METADATA_LIMIT).decode())
    information: dict[str, Any] = document[BAG_INFORMATION]
    return information


def listed_names(information: dict[str, Any]) -> list[str]:
    """Return the files that `metadata.yaml` lists.

    Raises YAML_PROBLEMS if there are none.
    """
    # Early versions put the folder's name before the file's.
    names = [PurePath(name).name for name in information["relative_file_paths"]]
    if not names or not all(name.isprintable() for name in names) or len(set(names)) < len(names):
        raise ValueError
    return names


def refuse_sqlite(path: Path, files: Iterable[Path]) -> None:
    if any(file.suffix == ".db3" for file in files):
        raise RecorderError(f"{path} is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`")


def natural_order(path: Path) -> list[int | str]:
    """Return a key that sorts by the numbers in names: `bag_10.mcap` comes after `bag_9.mcap`."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if part.isdecimal() else part for part in parts]
