"""Reads a bag, finished or not: topics, records, messages in order or by their times."""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from heapq import heappop, heappush, heapreplace
from itertools import chain
from pathlib import Path, PurePath
from typing import Any, BinaryIO, TypeAlias

from mcap.records import Channel, Message, Metadata

from recorder.bag import (
    BAG_INFORMATION,
    METADATA_FILE,
    YAML_PROBLEMS,
    RawMessage,
    Topic,
    is_evidence,
    load_yaml,
)
from recorder.catalogue import Catalogue, read_outline
from recorder.chunks import RECORD_LIMIT
from recorder.errors import RecorderError
from recorder.mcap_reader import (
    LOOSE,
    ChunkEnd,
    DamageError,
    ForeignError,
    Gap,
    chunk_places,
    indexed_places,
    read_chunk,
    read_records,
    read_summary,
    records_in,
)

RECOVERY_RECORD = "recovery"
"""The metadata record of a repaired bag; its `problem` says what the torn one had lost."""

_Chunk: TypeAlias = tuple[int | None, list[RawMessage]]
"""Messages, and their first log time; None where they have none."""

BagItem: TypeAlias = Topic | RawMessage | Metadata | Gap | ChunkEnd
"""In storage order; a topic comes before its messages, and may come again."""

METADATA_LIMIT = 1024 * 1024
"""The most bytes of `metadata.yaml` that are read; a topic takes some 600."""


_MOST_HELD = 256 * 1024 * 1024
"""Bytes of files that are put in order in memory."""


def not_a_bag(path: Path, error: ForeignError) -> RecorderError:
    return RecorderError(
        f"{path} is no bag: {error}; choose a rosbag2 bag folder or an .mcap file of ROS 2"
    )


class Bag:
    """A bag on disk; no file is held open between calls.

    `problem` says why it is not complete, also after a repair. Damage that only reading everything
    shows is added by `messages`. Of several `records` with one name the last counts.
    """

    def __init__(self, path: Path | str, *, evidence: bool = False) -> None:
        """Open a bag folder, recorded here or by `ros2 bag record`, or one `.mcap` file.

        An unfinished or damaged bag is opened as far as it goes. `evidence` opens the folder's
        evidence instead: cameras and other topics, in files of their own. A bag without it then
        has no files. Raises RecorderError if there is nothing to read.
        """
        self.path = path = Path(path)
        self.problem: str | None = None
        self.records: dict[str, dict[str, str]] = {}
        self._files: list[Path] = []
        self._topics: dict[str, Topic] = {}
        try:
            path.stat()
            files = [path]
            if path.is_dir():
                files, self.problem = bag_files(path, evidence=evidence)
            refuse_sqlite(path, files)
            self._open(files)
        except ForeignError as error:
            raise not_a_bag(path, error) from None
        except OSError as error:
            raise RecorderError(
                f"cannot read {error.filename or path}: {error.strerror or error}; "
                "check the path and its permissions"
            ) from None

    def _open(self, files: Iterable[Path]) -> None:
        for file in files:
            try:
                catalogue, damage = read_catalogue(file)
                topics = catalogue.topics()
            except (DamageError, OSError) as error:
                if not self._files:
                    raise
                self._note_problem(file, end_of(error))
                break
            self._files.append(file)
            self.records |= catalogue.records
            for topic in topics:
                self._topics.setdefault(topic.name, topic)
            lost = catalogue.records.get(RECOVERY_RECORD, {}).get("problem")
            for text in (lost, damage):
                if text is not None:
                    self._note_problem(file, text)

    @property
    def complete(self) -> bool:
        """As far as is known."""
        return self.problem is None

    def topics(self) -> tuple[Topic, ...]:
        return tuple(self._topics.values())

    def messages(self) -> Iterator[RawMessage]:
        """Messages in the order of time (protocol section 3); never raises.

        Files come by their first log times. If the first log times of their chunks never go back,
        messages come as they are stored; else all are merged by log time, in the memory of the
        chunks that overlap. Damaged chunks are skipped. `problem` tells them, and a torn end.
        A file without an index that can be trusted is held in memory, if it has less than 256 MB.
        """
        times = {path: _first_times(path) for path in self._files}
        if not all(times.values()):
            return self._through_memory()
        files = sorted(self._files, key=lambda path: min(times[path]))
        stored = [time for path in files for time in times[path]]
        return self._as_stored(files) if stored == sorted(stored) else self._by_time(files)

    def _as_stored(self, files: Iterable[Path]) -> Iterator[RawMessage]:
        for path in files:
            for item in self._items(path):
                if isinstance(item, RawMessage):
                    yield item

    def _items(self, path: Path) -> Iterator[RawMessage | ChunkEnd]:
        try:
            with open_recording(path) as file:
                for item in read_items(file):
                    if isinstance(item, RawMessage | ChunkEnd):
                        yield item
                    elif isinstance(item, Gap):
                        self._note_problem(path, left_out(item))
        except (DamageError, OSError) as error:
            self._note_problem(path, end_of(error))

    def _through_memory(self) -> Iterator[RawMessage]:
        """Messages of files of which no index says the times: what repair keeps of them."""
        if sum(path.stat().st_size for path in self._files if path.exists()) > _MOST_HELD:
            yield from self._as_stored(self._files)
            return
        files = [list(self._chunks(path)) for path in self._files]
        files.sort(key=lambda chunks: min(_starts(chunks), default=0))
        chunks = [chunk for file in files for chunk in file]
        starts = _starts(chunks)
        held = [message for _, messages in chunks for message in messages]
        if starts != sorted(starts):
            held.sort(key=lambda message: message.receive_ns)
        yield from held

    def _chunks(self, path: Path) -> Iterator[_Chunk]:
        """Each chunk with its first log time; at the end the messages behind the last one."""
        chunk: list[RawMessage] = []
        for item in self._items(path):
            if isinstance(item, RawMessage):
                chunk.append(item)
            elif chunk:
                times = [message.receive_ns for message in chunk]
                yield min(times) if any(times) else None, chunk
                chunk = []
        if chunk:
            yield chunk[0].receive_ns, chunk

    def _by_time(self, files: Iterable[Path]) -> Iterator[RawMessage]:
        seekers = []
        for path in files:
            try:
                seekers.append(Seeker(path))
            except (DamageError, OSError) as error:
                self._note_problem(path, end_of(error))
        parts = (part for seeker in seekers for part in seeker.parts())
        yield from _merged(parts)
        for seeker in seekers:
            if seeker.problem is not None:
                self._note_problem(seeker.path, seeker.problem)

    def _note_problem(self, file: Path, problem: str) -> None:
        self.problem = self.problem or f"{file}: {problem}"


def _starts(chunks: Iterable[_Chunk]) -> list[int]:
    return [start for start, _ in chunks if start is not None]


def _first_times(path: Path) -> list[int]:
    """First log times of the chunks of a file in stored order; none without a sound index."""
    with suppress(DamageError, OSError), open_recording(path) as file:
        return [chunk.begin_ns for chunk in indexed_places(file) if chunk.end_ns]
    return []


_Part: TypeAlias = tuple[int, Iterator[RawMessage]]
"""A part of a recording, with its first log time."""


def _merged(parts: Iterable[_Part]) -> Iterator[RawMessage]:
    """Messages by log time, equal ones by part; a part is opened at its first log time."""
    started: list[tuple[int, int, RawMessage, Iterator[RawMessage]]] = []
    placed = sorted((begin_ns, number, part) for number, (begin_ns, part) in enumerate(parts))
    for begin_ns, number, part in (*placed, (math.inf, 0, iter(()))):
        while started and started[0][0] < begin_ns:
            _, place, message, rest = started[0]
            yield message
            if (following := next(rest, None)) is None:
                heappop(started)
            else:
                heapreplace(started, (following.receive_ns, place, following, rest))
        if (first := next(part, None)) is not None:
            heappush(started, (first.receive_ns, number, first, part))


def end_of(error: DamageError | OSError) -> str:
    return f"{error}; what comes before that is read"


def left_out(gap: Gap) -> str:
    return f"{gap.reason}; it is left out"


def read_items(file: BinaryIO) -> Iterator[BagItem]:
    """Everything in a recording, in storage order; raises as `read_records`."""
    catalogue = Catalogue()
    count, gaps = 0, 0
    for record in read_records(file):
        match record:
            case Message():
                topic = catalogue.topic(record.channel_id)
                count += 1
                yield _raw(record, topic)
            case Gap():
                gaps += 1
                yield record
                if gaps == 1:  # it may have held channels of later chunks; the summary has all
                    with suppress(DamageError):
                        for description in read_summary(file):
                            catalogue.add_record(description)
                    yield from catalogue.topics()
            case ChunkEnd():
                yield record
            case _:
                catalogue.add_record(record)
                if isinstance(record, Channel):
                    yield from catalogue.topics([record.id])
                elif isinstance(record, Metadata):
                    yield record
    statistics = catalogue.statistics
    if not gaps and statistics is not None and statistics.message_count != count:
        raise DamageError(f"{count} of {statistics.message_count} messages are left")


def _raw(record: Message, topic: Topic) -> RawMessage:
    return RawMessage(
        topic.name,
        topic.type,
        record.data,
        record.publish_time,
        record.log_time,
        record.sequence,
    )


def read_catalogue(path: Path) -> tuple[Catalogue, str | None]:
    """What a file holds beside messages, and why it may not be all."""
    with open_recording(path) as file:
        with suppress(DamageError):  # unfinished, or a writer that makes no summary
            return read_outline(file), None
        catalogue = Catalogue()
        problem: str | None = None
        try:
            for record in read_records(file):
                if isinstance(record, Gap):
                    problem = problem or left_out(record)
                elif not isinstance(record, ChunkEnd):
                    catalogue.add_record(record)
        except ForeignError:
            raise
        except DamageError as error:
            problem = problem or end_of(error)
        return catalogue, problem


def open_recording(path: str | Path, folder_fd: int | None = None) -> BinaryIO:
    """Raises ForeignError for a pipe or a folder, and OSError for a link in an open folder."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe must not block
    number = os.open(path, flags | (os.O_NOFOLLOW if folder_fd else 0), dir_fd=folder_fd)
    if stat.S_ISREG(os.fstat(number).st_mode):
        return os.fdopen(number, "rb")
    os.close(number)
    raise ForeignError(f"{PurePath(path).name} is not a file")


def bag_files(folder: Path, *, evidence: bool = False) -> tuple[list[Path], str | None]:
    """The recordings of a bag in their order, and why they may not be all.

    Evidence is found by its name, whether `metadata.yaml` lists it yet or not. Raises ForeignError
    without a recording, and RecorderError if they are compressed as a whole.
    """
    if evidence:
        return sorted(filter(_is_evidence, folder.iterdir()), key=_natural_path), None
    try:
        listed = _listed_files(folder)
        return [path for path in listed if not _is_evidence(path)], None
    except FileNotFoundError:
        problem = f"{folder} has no {METADATA_FILE}, so its recording was not finished"
    except YAML_PROBLEMS:
        problem = f"{folder / METADATA_FILE} is damaged"
    recordings = [
        path
        for path in folder.iterdir()
        if path.suffix in {".mcap", ".db3"} and not _is_evidence(path)
    ]
    if not recordings:
        raise ForeignError("the folder holds no recording")
    return sorted(recordings, key=_natural_path), problem


def bag_information(folder: Path) -> dict[str, Any]:
    """Unchecked; raises YAML_PROBLEMS if damaged, ForeignError if it is not a file."""
    with open_recording(folder / METADATA_FILE) as file:
        return information_in(file.read(METADATA_LIMIT))


def information_in(metadata: bytes) -> dict[str, Any]:
    document: Any = load_yaml(metadata.decode())
    information: dict[str, Any] = document[BAG_INFORMATION]
    return information


def listed_names(information: dict[str, Any]) -> list[str]:
    """From `metadata.yaml`; raises YAML_PROBLEMS if there are none."""
    # Early versions put the folder's name before the file's.
    names = [PurePath(name).name for name in information["relative_file_paths"]]
    if not names or not all(name.isprintable() for name in names) or len(set(names)) < len(names):
        raise ValueError
    return names


def _listed_files(folder: Path) -> list[Path]:
    information = bag_information(folder)
    if str(information.get("compression_mode", "")).lower() in {"file", "message"}:
        raise RecorderError(
            f"{folder} is compressed by rosbag2 as a whole; unpack it by `ros2 bag convert`"
        )
    return [folder / name for name in listed_names(information)]


def refuse_sqlite(path: Path, files: Iterable[Path]) -> None:
    if any(file.suffix == ".db3" for file in files):
        raise RecorderError(f"{path} is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`")


def _is_evidence(path: Path) -> bool:
    return is_evidence(path.name)


def natural_order(name: str) -> list[int | str]:
    """By the numbers in a name: `bag_10.mcap` comes after `bag_9.mcap`."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def _natural_path(path: Path) -> list[int | str]:
    return natural_order(path.name)


_MOST_UNPACKED = 2 * RECORD_LIMIT
"""Bytes that are unpacked to find a message: two raw cameras fill as many in two seconds."""


class Seeker:
    """A recording in which messages are looked for; no file is held open between calls.

    `problem` says why it is not complete, as far as is known; else None. Raises DamageError or
    OSError if there is nothing to read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._catalogue, self.problem = read_catalogue(path)
        self.topics = tuple(self._catalogue.topics())
        with open_recording(path) as file:
            self._chunks = chunk_places(file)
        self._unpacked = 0

    def nearest(self, name: str, at_ns: int, within_ns: int) -> RawMessage | None:
        """The message of a topic that was received nearest to an instant, ns since the epoch.

        None = none within so many ns. A damaged chunk is passed over, and `problem` tells it.
        Raises RecorderError if the disk refuses.
        """
        channels = self._catalogue.channels_of(name)
        near = [chunk for chunk in self._chunks if chunk.distance(at_ns) <= within_ns]
        nearest: Message | None = None
        self._unpacked = 0
        try:
            with open_recording(self.path) as file:
                for chunk in sorted(near, key=lambda chunk: chunk.distance(at_ns)):
                    if chunk.distance(at_ns) > within_ns or self._unpacked > _MOST_UNPACKED:
                        break
                    if not chunk.channels or chunk.channels & channels:
                        for message in self._messages(file, chunk.offset, channels):
                            if abs(message.log_time - at_ns) <= within_ns:
                                nearest, within_ns = message, abs(message.log_time - at_ns) - 1
            if nearest is None:
                return None
            topic = self._catalogue.topic(nearest.channel_id)
        except (DamageError, OSError) as error:
            raise RecorderError(f"{name}: cannot be read ({error}); look at the disk") from None
        return _raw(nearest, topic)

    def parts(self) -> Iterator[_Part]:
        """Each chunk, its messages by log time, and the messages outside the chunks, as stored."""
        for chunk in self._chunks:
            yield chunk.begin_ns, self._in_chunk(chunk.offset)
        loose = self._loose()
        if (first := next(loose, None)) is not None:
            yield first.receive_ns, chain([first], loose)

    def _in_chunk(self, offset: int) -> Iterator[RawMessage]:
        try:
            with open_recording(self.path) as file:
                messages = list(self._messages(file, offset))
            for message in sorted(messages, key=lambda message: message.log_time):
                yield _raw(message, self._catalogue.topic(message.channel_id))
        except (DamageError, OSError) as error:
            self.problem = self.problem or str(error)

    def _loose(self) -> Iterator[RawMessage]:
        try:
            with open_recording(self.path) as file:
                for message in read_records(file, LOOSE):
                    if isinstance(message, Message):
                        yield _raw(message, self._catalogue.topic(message.channel_id))
        except (DamageError, OSError) as error:
            self.problem = self.problem or end_of(error)

    def _messages(
        self, file: BinaryIO, offset: int, channels: set[int] | None = None
    ) -> Iterator[Message]:
        content = read_chunk(file, offset)
        self._unpacked += len(content.records)
        if content.problem is not None and self.problem is None:
            self.problem = f"a chunk {content.problem} (byte {offset})"
        with suppress(DamageError):
            for record in records_in(content.records):
                if isinstance(record, Message) and (
                    channels is None or record.channel_id in channels
                ):
                    yield record
