"""Records messages to a bag: a bounded queue, and one thread that owns the file.

Nobody waits for the disk. What it refuses waits in memory, and goes on at the byte where it
stopped. The order of `put_message` is the order in the bag.
"""

from __future__ import annotations

import fcntl
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, Writer

from recorder import RecorderError
from recorder.bag import (
    MAX_NS,
    METADATA_FILE,
    BagInformation,
    Batch,
    RawMessage,
    Topic,
    bag_file_name,
    qos_text,
    topic_problem,
    write_metadata,
)

ROSBAG2_RECORD = "rosbag2"
"""The metadata record in which rosbag2 repeats `metadata.yaml`."""

CHUNK_BYTES = 768 * 1024
"""Bytes of a chunk before compression: the longest single write stays at a few milliseconds."""

_OVERHEAD_BYTES = 256
"""Memory of a queued message beside its data."""


class RecorderState(StrEnum):
    """The life of a recorder."""

    CLOSED = "closed"
    RECORDING = "recording"
    FAILED = "failed"
    """What was written before stays readable, as an unfinished bag."""
    FINISHED = "finished"


@dataclass(slots=True)
class RecorderStats:
    """A recorder at one instant; messages per topic.

    Attributes:
        received: those handed over.
        recorded: those on the disk.
        lost: those that will never be in the bag. What is neither waits in memory.
        memory_bytes: of what waits.
        seconds_since_sync: since everything received was on the disk; None before `open`.
        error: why the disk takes nothing at the moment, or why the recording ended.
    """

    folder: Path
    state: RecorderState = RecorderState.CLOSED
    received: Counter[str] = field(default_factory=Counter)
    recorded: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    memory_bytes: int = 0
    file_bytes: int = 0
    seconds_since_sync: float | None = None
    error: str | None = None


class BagWriter:
    """Records one bag; every method may be called from any thread.

    Args:
        folder: of the bag, made by `open`; its parent must exist.
        topics: known beforehand; later ones by `add_topic`.
        records: MCAP metadata records by name, written before the first message.
        flush_period: seconds of `clock` between two syncs, about the most that a crash can cost.
        memory_bytes: the most that messages take on their way to the disk.
        block_when_full: let `put_message` wait for room instead of dropping (virtual time).
        clock: monotonic time, s.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[Topic],
        records: Mapping[str, Mapping[str, str]],
        *,
        flush_period: float = 0.2,
        memory_bytes: int = 64 * 1024 * 1024,
        block_when_full: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.folder = folder
        self._first = Batch(list(topics), records={n: dict(r) for n, r in records.items()})
        self._flush_period = flush_period
        self._memory_bytes = memory_bytes
        self._block = block_when_full
        self._clock = clock
        self._folder_fd = -1
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()  # guards everything below
        self._types: dict[str, str] = {}
        self._stats = RecorderStats(self.folder)
        self._waiting = Batch()
        self._queued_bytes = 0
        self._unsaved_bytes = 0
        self._blocked = 0
        self._synced: float | None = None
        self._closing = False

    def open(self) -> None:
        """Make the bag, its header, records and `metadata.yaml` on disk, and record.

        RecorderError leaves nothing behind.
        """
        if self._stats.state is not RecorderState.CLOSED or self._closing:
            raise RecorderError(f"{self.folder} was recorded or closed before; make a new recorder")
        file = self._create()
        # A daemon: a program that ends without `close` must not hang on it.
        self._thread = threading.Thread(
            target=self._run, args=(file,), name="recorder", daemon=True
        )
        self._stats.state = RecorderState.RECORDING
        self._thread.start()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        stats = self.close()
        missing = ", ".join(f"{topic} {n}" for topic, n in sorted(stats.lost.items()))
        if kind is None and stats.error is not None:
            raise RecorderError(stats.error)
        if kind is None and missing:
            raise RecorderError(f"{self.folder}: messages are not in the bag: {missing}")

    def put_message(self, message: RawMessage) -> bool:
        """Queue a message.

        False = it is lost, and counted. Never raises, never waits.

        With `block_when_full` it waits for room.
        """
        return self.put_all((message,)) == 1

    def put_all(self, messages: Iterable[RawMessage]) -> int:
        """Do as `put_message`, oldest first, and return how many are not lost."""
        accepted = 0
        with self._changed:
            for message in messages:
                cost = len(message.data) + _OVERHEAD_BYTES
                self._stats.received[message.topic] += 1
                if self._block:
                    self._wait_for_room(cost)
                if self._can_take(message) and self._has_room(cost):
                    self._waiting.messages.append(message)
                    self._add_cost(cost)
                    accepted += 1
                else:
                    self._stats.lost[message.topic] += 1
        return accepted

    def add_topic(self, topic: Topic) -> bool:
        """Register a topic that appeared while recording.

        Returns whether it is recorded.

        It is not while not recording, if a bag cannot hold it, or if its name has another type.
        """
        with self._changed:
            if topic.name in self._types:
                return self._types[topic.name] == topic.type
            if not self._is_accepting or topic_problem(topic) is not None:
                return False
            self._types[topic.name] = topic.type
            self._waiting.topics.append(topic)
            self._add_cost(len(topic.definition) + _OVERHEAD_BYTES)
            return True

    def stats(self) -> RecorderStats:
        now = self._clock()
        with self._changed:
            return replace(
                self._stats,
                received=self._stats.received.copy(),
                recorded=self._stats.recorded.copy(),
                lost=self._stats.lost.copy(),
                memory_bytes=self._queued_bytes + self._unsaved_bytes,
                seconds_since_sync=None if self._synced is None else now - self._synced,
            )

    def close(self, timeout: float | None = 30.0) -> RecorderStats:
        """Write what is queued, finish the bag and its `metadata.yaml`.

        Safe to call twice.

        `timeout` (s) is when an unresponsive disk counts as failed; None = never.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout)
            if self._thread.is_alive():
                self._fail(TimeoutError(f"the disk did not answer within {timeout:g} s"))
        return self.stats()

    # With the lock held.

    @property
    def _is_accepting(self) -> bool:
        return self._stats.state is RecorderState.RECORDING and not self._closing

    def _can_take(self, message: RawMessage) -> bool:
        return (
            self._is_accepting
            and self._types.get(message.topic) == message.type
            and 0 <= message.receive_ns < MAX_NS
            and 0 <= message.publish_ns < MAX_NS
        )

    def _has_room(self, cost: int) -> bool:
        return self._queued_bytes + self._unsaved_bytes + cost <= self._memory_bytes

    def _wait_for_room(self, cost: int) -> None:
        """Wait while the disk takes what is in the way."""
        self._blocked += 1
        while self._is_accepting and self._stats.error is None and not self._has_room(cost):
            if self._queued_bytes + self._unsaved_bytes == 0:
                break  # it is larger than all the room
            self._changed.notify_all()
            self._changed.wait()
        self._blocked -= 1

    def _add_cost(self, cost: int) -> None:
        self._queued_bytes += cost
        if self._queued_bytes >= CHUNK_BYTES:
            self._changed.notify_all()

    def _is_due(self) -> bool:
        return self._closing or self._blocked > 0 or self._queued_bytes >= CHUNK_BYTES

    # Opening.

    def _create(self) -> BagFile:
        """Make the folder and the file, on disk on return."""
        for topic in self._first.topics:
            problem = topic_problem(topic)
            if self._types.setdefault(topic.name, topic.type) != topic.type:
                problem = f"{topic.name} is both {self._types[topic.name]} and {topic.type}"
            if problem:
                raise RecorderError(f"{problem}; correct the topic's configuration")
        try:
            self.folder.mkdir()
            file = self._make_file()
        except FileExistsError:
            raise RecorderError(
                f"{self.folder} exists already; move it away or record under another name"
            ) from None
        except OSError as error:
            raise RecorderError(
                f"cannot record to {self.folder}: {error.strerror or error}; "
                "choose a folder that exists and can be written, on a disk with room"
            ) from None
        self._stats.file_bytes = file.disk.size
        self._synced = self._clock()
        return file

    def _make_file(self) -> BagFile:
        """Make the file and `metadata.yaml`.

        Where the disk refuses, nothing is left.
        """
        path = self.folder / bag_file_name(self.folder.name)
        try:
            file = BagFile(path, self._first)
            self._folder_fd = os.open(self.folder, os.O_DIRECTORY | os.O_CLOEXEC)
            write_metadata(self._folder_fd, file.information())
        except OSError:
            path.unlink(missing_ok=True)
            (self.folder / METADATA_FILE).unlink(missing_ok=True)
            self.folder.rmdir()
            raise
        return file

    # The writer's thread.

    def _run(self, file: BagFile) -> None:
        try:
            next_sync = self._clock() + self._flush_period
            closing = False
            while not closing:
                batch, cost, closing = self._take_batch(next_sync - self._clock())
                file.add(batch)
                if self._blocked or self._clock() >= next_sync:
                    next_sync = self._clock() + self._flush_period
                    self._sync(file)
                self._report(file, cost)
            file.finish()
            write_metadata(self._folder_fd, file.information())
            self._report(file, 0)
            with self._changed:
                if self._stats.state is RecorderState.RECORDING:  # else it was given up on
                    self._stats.state = RecorderState.FINISHED
                    self._stats.error = None  # what the disk refused before is there now
        except Exception as error:  # noqa: BLE001 - whatever it is, the run goes on
            self._report(file, 0)
            self._fail(error)
        finally:
            file.close()
            os.close(self._folder_fd)

    def _take_batch(self, timeout: float) -> tuple[Batch, int, bool]:
        """Wait for work, and return what waits, its cost, and whether it is the last."""
        with self._changed:
            self._changed.wait_for(self._is_due, max(0.0, timeout))
            batch = self._waiting
            self._waiting = Batch()
            return batch, self._queued_bytes, self._closing

    def _sync(self, file: BagFile) -> None:
        """Bring all to the disk.

        What it refuses is tried again at the next sync.
        """
        now = self._clock()
        problem = None
        try:
            file.sync()
        except OSError as error:
            problem = (
                f"recording to {self.folder}: {error.strerror or error}; "
                "what comes waits in memory: make room, or see to the disk"
            )
        with self._changed:
            if self._stats.state is RecorderState.RECORDING:  # else it was given up on
                self._stats.error = problem
                self._synced = self._synced if problem else now

    def _report(self, file: BagFile, done: int) -> None:
        with self._changed:
            if self._stats.state is RecorderState.FAILED:  # given up on; the account is closed
                return
            self._stats.recorded = file.recorded
            self._stats.file_bytes = file.disk.size
            self._queued_bytes -= done
            self._unsaved_bytes = len(file.disk.waiting)
            self._changed.notify_all()

    def _fail(self, error: Exception) -> None:
        """Stop recording.

        Everything received and not on the disk is lost.
        """
        cause = (isinstance(error, OSError) and error.strerror) or str(error) or repr(error)
        outcome = "what was written stays readable, check the disk and its room"
        with self._changed:
            if self._stats.state is not RecorderState.RECORDING:
                return
            self._stats.state = RecorderState.FAILED
            if isinstance(error, _DeletedError):
                outcome = "what was written is lost, find out what deletes it before the next run"
                self._stats.recorded = Counter()
                self._stats.file_bytes = 0
            self._stats.error = f"recording to {self.folder} failed: {cause}; {outcome}"
            self._stats.lost = self._stats.received - self._stats.recorded
            self._waiting = Batch()
            self._queued_bytes = 0
            self._unsaved_bytes = 0
            self._changed.notify_all()


class _DeletedError(Exception):
    """The file was deleted while it was recorded."""


class BagFile:
    """A new `.mcap` file, with its first content on disk; not thread-safe.

    Nothing but `sync` and `finish` touches the disk. The file is locked until it is closed, so
    that nobody takes it for one that was cut off. `listed_as` is its name, if it will be renamed.
    Raises OSError where the disk refuses.

    Attributes:
        recorded: messages on the disk, by topic.
    """

    def __init__(self, path: Path, first: Batch, listed_as: str | None = None) -> None:
        self._name = listed_as or path.name
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._topics: dict[str, Topic] = {}
        self._counts: Counter[str] = Counter()
        self.recorded: Counter[str] = Counter()
        self._start_ns: int | None = None
        self._end_ns: int | None = None
        self.disk = Disk(path)
        output: Any = self.disk
        self._writer = Writer(output, CHUNK_BYTES, CompressionType.ZSTD)
        try:
            self._writer.start(Profile.ROS2, f"madrob recorder, {LIBRARY_IDENTIFIER}")
            self.add(first)
            self.sync()
        except OSError:
            self.close()
            path.unlink()
            raise

    def add(self, batch: Batch) -> None:
        """Append topics, messages of these or earlier ones, and records."""
        for topic in batch.topics:
            if topic.name not in self._channels:
                self._register(topic)
        for message in batch.messages:
            time_ns = message.receive_ns
            self._writer.add_message(
                self._channels[message.topic],
                time_ns,
                message.data,
                message.publish_ns,
                message.sequence & 0xFFFF_FFFF,
            )
            self._counts[message.topic] += 1
            self._start_ns = time_ns if self._start_ns is None else min(time_ns, self._start_ns)
            self._end_ns = time_ns if self._end_ns is None else max(time_ns, self._end_ns)
        for name, record in batch.records.items():
            self.end_chunk()  # it stands behind what came before it
            self._writer.add_metadata(_text(name), {_text(k): _text(v) for k, v in record.items()})

    def _register(self, topic: Topic) -> None:
        key = (topic.type, topic.definition)
        if key not in self._schemas:
            encoding = SchemaEncoding.ROS2 if topic.definition else ""
            definition = topic.definition.encode()
            self._schemas[key] = self._writer.register_schema(topic.type, encoding, definition)
        told = {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": topic.type_hash}
        self._topics[topic.name] = topic
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, MessageEncoding.CDR, self._schemas[key], told
        )

    def end_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]

    def sync(self) -> None:
        """Bring everything to the disk.

        Raises also if the file was deleted.
        """
        self.end_chunk()
        self.disk.carry()
        self.recorded = self._counts.copy()

    def information(self) -> BagInformation:
        topics = list(self._topics.values())
        return BagInformation(self._name, topics, self._counts, self._start_ns, self._end_ns)

    def finish(self) -> None:
        """Add the record `rosbag2`, the indexes and the summary.

        On disk on return.
        """
        record = {"serialized_metadata": self.information().serialized_metadata()}
        self.add(Batch(records={ROSBAG2_RECORD: record}))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.sync()

    def close(self) -> None:
        """Close it.

        What waits for the disk is lost.
        """
        self.disk.close()


def _text(value: str) -> str:
    """Make valid text: a stray byte in what a referee typed must not end the recording."""
    return value.encode("utf-8", "backslashreplace").decode()


class Disk:
    """A new file for mcap's writer that never refuses; `carry` takes its bytes to the disk.

    Attributes:
        waiting: bytes that the disk has not taken yet.
        size: bytes on the disk.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._fd = os.open(path, flags, 0o666)
        with suppress(OSError):  # not every network disk has locks
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._written = 0
        self.waiting = bytearray()
        self.size = 0

    def write(self, data: bytes) -> int:
        self.waiting += data
        return len(data)

    def tell(self) -> int:
        return self.size + len(self.waiting)

    def flush(self) -> None:
        """Do nothing: `carry` does it."""

    def carry(self) -> None:
        """Write what waits, on from the byte where the disk stopped.

        OSError where it stops.
        """
        while self._written < len(self.waiting):
            piece = bytes(self.waiting[self._written : self._written + CHUNK_BYTES])
            self._written += os.pwrite(self._fd, piece, self.size + self._written)
        try:
            os.fdatasync(self._fd)
        except OSError:
            self._written = 0  # nobody knows what of it the disk has: all is written again
            raise
        if os.fstat(self._fd).st_nlink == 0:
            raise _DeletedError("the file was deleted")
        self.size += self._written
        self._written = 0
        self.waiting.clear()

    def close(self) -> None:
        with suppress(OSError):  # what counts was synced
            os.close(self._fd)
