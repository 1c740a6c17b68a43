"""Single messages of a bag, found by their time through its chunk indexes."""

from __future__ import annotations

import os
import struct
from bisect import bisect_left
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Self

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Message
from mcap.writer import MCAP0_MAGIC

from recorder.bag import RawMessage, Topic
from recorder.errors import RecorderError
from recorder.mcap_reader import (
    FRAME,
    MESSAGE_HEAD,
    RECORD_LIMIT,
    Catalogue,
    DamageError,
    ForeignError,
    read_summary,
    records_in,
    unpack,
)
from recorder.reader import bag_files, open_recording

# The chunks of one recording, and their contents, without reading them.
#
# A finished recording lists them at its end. In a recording that was cut off, the heads of the
# chunks and the indexes behind them are walked.


MOST_RECORDS = 1_000_000
"""The most records walked of a cut-off recording: a camera at 30 Hz for hours has fewer."""

MOST_UNPACKED = 64
"""Chunks that are unpacked to learn what no index says."""

_CHUNK_HEAD = struct.Struct("<QQQII")  # first time, last time, size, checksum, length of a name
_COUNT = struct.Struct("<HI")  # channel, bytes of entries
_ENTRY = struct.Struct("<QQ")  # log time, offset
_SIZE = struct.Struct("<Q")
_NAME_LIMIT = 32
_KINDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
_INDEX_LIMIT = 16 * 1024 * 1024
_KEPT = 48 * 1024 * 1024  # bytes of unpacked chunks: neighbours are often in one chunk


@dataclass(frozen=True, slots=True, eq=False)
class ChunkPlace:
    """A chunk on disk; log times in ns since the epoch.

    `offset` is that of its record, `indexes` that of each channel's index, bytes.
    """

    offset: int
    begin_ns: int
    end_ns: int
    indexes: Mapping[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class MessagePlace:
    """A message on disk; `offset` (bytes) is that of its record in the unpacked chunk."""

    log_ns: int
    chunk: ChunkPlace
    offset: int


class ChunkTable:
    """The chunks of an open recording; only what is asked for is read.

    `problem` says why there may be more. Raises ForeignError and OSError, its methods OSError.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.catalogue = Catalogue()
        self.problem: str | None = None
        self._fd = file.fileno()
        self._size = os.fstat(self._fd).st_size
        self._unpacked: OrderedDict[int, bytes] = OrderedDict()
        self._found: dict[tuple[int, int], list[MessagePlace]] = {}
        self._to_unpack = MOST_UNPACKED
        if os.pread(self._fd, len(MCAP0_MAGIC), 0) != MCAP0_MAGIC:
            raise ForeignError(
                "it does not begin like an MCAP file" if self._size else "it is empty"
            )
        try:
            self._chunks = self._by_summary(file)
        except DamageError:  # it is unfinished
            self.catalogue = Catalogue()
            self._chunks = self._by_walking()
        self._chunks = [self._indexed(chunk) for chunk in self._chunks]
        self._of_channel: dict[int, list[ChunkPlace]] = defaultdict(list)
        for chunk in self._chunks:
            for channel in chunk.indexes:
                self._of_channel[channel].append(chunk)
        self.channels = tuple(sorted(self._of_channel))
        self._learn_channels()

    def places(self, channel: int, begin_ns: int, end_ns: int) -> Iterator[MessagePlace]:
        """Between two log times, chunk by chunk."""
        for chunk in self._of_channel.get(channel, ()):
            if chunk.begin_ns <= end_ns and chunk.end_ns >= begin_ns:
                for place in self._entries(chunk, channel):
                    if begin_ns <= place.log_ns <= end_ns:
                        yield place

    def first(self, channel: int) -> Iterator[MessagePlace]:
        """The messages of the first chunk that has any."""
        for chunk in self._of_channel.get(channel, ())[:1]:
            yield from self._entries(chunk, channel)

    def head(self, place: MessagePlace, size: int) -> bytes:
        """Read only these bytes if the chunk is not packed. DamageError without a message."""
        return self._message(place, size).data

    def message(self, place: MessagePlace, limit: int) -> Message:
        """DamageError without a message, or with one of more than `limit` bytes."""
        message = self._message(place, limit + 1)
        if len(message.data) > limit:
            raise DamageError(f"it has more than {limit / 1e6:.0f} MB")
        return message

    def _message(self, place: MessagePlace, most: int) -> Message:
        head = FRAME.size + MESSAGE_HEAD.size
        record = self._part(place.chunk, place.offset, head)
        if len(record) < head:
            raise DamageError("its index points behind its chunk")
        opcode, length = FRAME.unpack_from(record)
        if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD.size:
            raise DamageError("its index points to something else")
        size = min(length - MESSAGE_HEAD.size, most)
        data = self._part(place.chunk, place.offset + head, size)
        if len(data) < size:
            raise DamageError("it is cut off")
        channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(record, FRAME.size)
        return Message(channel, log_time, data, publish_time, sequence)

    # ------------------------------------------------------------------ chunks

    def _by_summary(self, file: BinaryIO) -> list[ChunkPlace]:
        chunks: list[ChunkPlace] = []
        for record in read_summary(file, chunks=True):
            if isinstance(record, ChunkIndex):
                place = _place(record)
                if max(place.offset, *place.indexes.values(), 0) >= self._size:
                    raise DamageError("an index points behind its end")
                chunks.append(place)
            else:
                self.catalogue.add_record(record)
        told = self.catalogue.statistics
        if told is None or not self.catalogue.whole or told.chunk_count != len(chunks):
            raise DamageError("its summary is not complete")
        return sorted(chunks, key=lambda chunk: chunk.offset)

    def _by_walking(self) -> list[ChunkPlace]:
        chunks: list[ChunkPlace] = []
        indexes: dict[int, int] = {}
        offset = len(MCAP0_MAGIC)
        for _ in range(MOST_RECORDS):
            frame = os.pread(self._fd, FRAME.size, offset)
            if len(frame) < FRAME.size:
                break
            opcode, length = FRAME.unpack(frame)
            body, following = offset + FRAME.size, offset + FRAME.size + length
            cut = following > self._size
            if opcode == Opcode.CHUNK:
                head = os.pread(self._fd, _CHUNK_HEAD.size, body)
                if len(head) == _CHUNK_HEAD.size:
                    begin_ns, end_ns, *_ = _CHUNK_HEAD.unpack(head)
                    indexes = {}
                    chunks.append(ChunkPlace(offset, begin_ns, end_ns, indexes))
            if opcode == 0 or cut:
                break
            if opcode == Opcode.FOOTER:
                return chunks
            if opcode == Opcode.MESSAGE_INDEX and length >= _COUNT.size:
                channel, _ = _COUNT.unpack(os.pread(self._fd, _COUNT.size, body))
                indexes[channel] = offset
            elif opcode in _KINDS and length <= RECORD_LIMIT:
                self._take(frame + os.pread(self._fd, length, body))
            offset = following
        else:
            self.problem = f"it was not finished; its first {MOST_RECORDS} records are looked at"
            return chunks
        self.problem = "it was not finished"
        indexes.clear()  # those of the last chunk may not be all
        return chunks

    def _indexed(self, chunk: ChunkPlace) -> ChunkPlace:
        """A chunk without an index is unpacked to make it."""
        if chunk.indexes:
            return chunk
        found = self._look_into(chunk)
        self._found |= {(chunk.offset, channel): places for channel, places in found.items()}
        return ChunkPlace(chunk.offset, chunk.begin_ns, chunk.end_ns, dict.fromkeys(found, 0))

    def _entries(self, chunk: ChunkPlace, channel: int) -> list[MessagePlace]:
        known = self._found.get((chunk.offset, channel))
        if known is not None:
            return known
        offset = chunk.indexes[channel]
        if not offset:
            return []
        head = os.pread(self._fd, FRAME.size + _COUNT.size, offset)
        if len(head) < FRAME.size + _COUNT.size:
            return []
        opcode, _ = FRAME.unpack_from(head)
        there, size = _COUNT.unpack_from(head, FRAME.size)
        if opcode != Opcode.MESSAGE_INDEX or there != channel or size > _INDEX_LIMIT:
            return []
        entries = os.pread(self._fd, size, offset + len(head))
        whole = len(entries) - len(entries) % _ENTRY.size
        return [MessagePlace(at, chunk, where) for at, where in _ENTRY.iter_unpack(entries[:whole])]

    # ------------------------------------------------------------------ what is in them

    def _part(self, chunk: ChunkPlace, offset: int, size: int) -> bytes:
        if offset >= RECORD_LIMIT:
            return b""
        if chunk.offset not in self._unpacked:
            start = chunk.offset + FRAME.size
            head = os.pread(self._fd, _CHUNK_HEAD.size + _NAME_LIMIT + _SIZE.size, start)
            if len(head) < _CHUNK_HEAD.size + _SIZE.size:
                return b""
            *_, name = _CHUNK_HEAD.unpack_from(head)
            if name == 0:
                (length,) = _SIZE.unpack_from(head, _CHUNK_HEAD.size)
                begin = start + _CHUNK_HEAD.size + _SIZE.size
                return os.pread(self._fd, max(0, min(size, length - offset)), begin + offset)
        return self._content(chunk)[offset : offset + size]

    def _content(self, chunk: ChunkPlace) -> bytes:
        """Unpacked; empty where it is damaged."""
        if chunk.offset in self._unpacked:
            self._unpacked.move_to_end(chunk.offset)
            return self._unpacked[chunk.offset]
        frame = os.pread(self._fd, FRAME.size, chunk.offset)
        content = b""
        if len(frame) == FRAME.size:
            opcode, length = FRAME.unpack(frame)
            if opcode == Opcode.CHUNK and length <= RECORD_LIMIT:
                body = os.pread(self._fd, length, chunk.offset + FRAME.size)
                content = unpack(body).records  # of one that is cut what is left, else nothing
        self._unpacked[chunk.offset] = content
        while len(self._unpacked) > 1 and sum(map(len, self._unpacked.values())) > _KEPT:
            self._unpacked.popitem(last=False)
        return content

    def _look_into(self, chunk: ChunkPlace) -> dict[int, list[MessagePlace]]:
        if self._to_unpack == 0:
            self.problem = "it has no index; its first chunks are looked at"
            return {}
        self._to_unpack -= 1
        content = self._content(chunk)
        found: dict[int, list[MessagePlace]] = defaultdict(list)
        offset = 0
        while offset + FRAME.size <= len(content):
            opcode, length = FRAME.unpack_from(content, offset)
            start, end = offset + FRAME.size, offset + FRAME.size + length
            if opcode == 0 or end > len(content):
                break
            if opcode == Opcode.MESSAGE and length >= MESSAGE_HEAD.size:
                channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content, start)
                found[channel].append(MessagePlace(log_ns, chunk, offset))
            elif opcode in _KINDS:
                self._take(content[offset:end])
            offset = end
        return found

    def _learn_channels(self) -> None:
        """Looks into the chunks where channels without a type come first, and before them."""
        for channel in self.channels:
            first = self._of_channel[channel][0]
            number = bisect_left(self._chunks, first.offset, key=lambda chunk: chunk.offset)
            while number >= 0 and not self._knows(channel) and self._to_unpack:
                self._look_into(self._chunks[number])
                number -= 1

    def _knows(self, channel: int) -> bool:
        try:
            self.catalogue.topic(channel)
        except ForeignError:
            return True
        except DamageError:
            return False
        return True

    def _take(self, record: bytes) -> None:
        """A damaged type or channel is unknown."""
        try:
            for parsed in records_in(record):
                self.catalogue.add_record(parsed)
        except DamageError as error:
            self.problem = self.problem or str(error)


def _place(index: ChunkIndex) -> ChunkPlace:
    return ChunkPlace(
        index.chunk_start_offset,
        index.message_start_time,
        index.message_end_time,
        dict(index.message_index_offsets),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A message that was found, and not read yet; `topic` has the type of this message."""

    topic: Topic
    log_ns: int
    place: MessagePlace
    table: ChunkTable

    @property
    def key(self) -> tuple[int, int, int]:
        """Equal for the same message, however often it is found."""
        return id(self.table), self.place.chunk.offset, self.place.offset


class Seeker:
    """The files of a bag, open to look for single messages; a context manager.

    Files that are no recordings are skipped; `problems` names them. `evidence` looks at the
    folder's evidence instead of what is scored. It raises RecorderError, as do its methods.
    """

    def __init__(self, path: Path, *, evidence: bool = False) -> None:
        self.problems: list[str] = []
        self._tables: list[tuple[ChunkTable, dict[int, Topic]]] = []
        with ExitStack() as undo:
            try:
                files = bag_files(path, evidence=evidence)[0] if path.is_dir() else [path]
            except (ForeignError, OSError) as error:
                raise RecorderError(f"cannot read {path}: {error}; choose a bag") from None
            for file in files:
                try:
                    table = ChunkTable(undo.enter_context(open_recording(file)))
                except (DamageError, OSError) as error:
                    self.problems.append(f"{file.name}: {error}")
                    continue
                self._tables.append((table, dict(_topics(table))))
                if table.problem is not None:
                    self.problems.append(f"{file.name}: {table.problem}")
            self._open = undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._open.close()

    def topics(self) -> tuple[Topic, ...]:
        known: dict[str, Topic] = {}
        for _, topics in self._tables:
            for topic in topics.values():
                known.setdefault(topic.name, topic)
        return tuple(known.values())

    def between(self, name: str, begin_ns: int, end_ns: int) -> list[Found]:
        """The messages between two log times (ns since the epoch), by log time."""
        return self._found(name, lambda table, channel: table.places(channel, begin_ns, end_ns))

    def first(self, name: str) -> list[Found]:
        """The messages of the first chunk of each file, by log time."""
        return self._found(name, lambda table, channel: table.first(channel))

    def head(self, found: Found, size: int) -> bytes:
        try:
            return found.table.head(found.place, size)
        except (DamageError, OSError) as error:
            raise _unreadable(found, error) from None

    def message(self, found: Found, limit: int) -> RawMessage:
        try:
            message = found.table.message(found.place, limit)
        except (DamageError, OSError) as error:
            raise _unreadable(found, error) from None
        topic = found.topic
        times = message.publish_time, message.log_time
        return RawMessage(topic.name, topic.type, message.data, *times)

    def _found(
        self, name: str, look: Callable[[ChunkTable, int], Iterator[MessagePlace]]
    ) -> list[Found]:
        found: list[Found] = []
        try:
            for table, topics in self._tables:
                for channel, topic in topics.items():
                    if topic.name == name:
                        places = look(table, channel)
                        found += [Found(topic, place.log_ns, place, table) for place in places]
        except OSError as error:
            raise RecorderError(
                f"{name}: cannot be read ({error.strerror}); look at the disk"
            ) from None
        return sorted(found, key=lambda one: one.log_ns)


def _topics(table: ChunkTable) -> Iterator[tuple[int, Topic]]:
    for channel in table.channels:
        try:
            yield channel, table.catalogue.topic(channel)
        except DamageError as error:
            table.problem = table.problem or str(error)


def _unreadable(found: Found, error: DamageError | OSError) -> RecorderError:
    return RecorderError(f"{found.topic.name}: {error}")
