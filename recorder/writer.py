"""Record messages to a bag: a queue bounded in bytes, and one thread that owns the file.

The caller never waits for the disk, and the order of `put_message` is the order in the bag.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from recorder.bag import MAX_NS, RawMessage, Topic, topic_problem
from recorder.bag_folder import BagFolder, FurtherFile
from recorder.errors import RecorderError, remedy
from recorder.mcap_file import McapFile
from recorder.mcap_writer import CHUNK_BYTES
from recorder.recorder_stats import Account, DropReason, RecorderState, RecorderStats, missing_words

_OVERHEAD_BYTES = 256
"""Memory of a queued message beside its data, so that many small ones are bounded as well."""

SYNC_BYTES = 4_000_000
"""Evidence is synced after so many bytes: a sync of what is scored then waits for no more."""

_RECORDING, _FULL = RecorderState.RECORDING, DropReason.QUEUE_FULL
"""Used for each message; Python 3.11 takes 0.2 us to look up a member."""


@dataclass(frozen=True, slots=True)
class _Record:
    name: str
    content: Mapping[str, str]


_Item = RawMessage | Topic | _Record


class BagWriter:
    """Records one bag; every method may be called from any thread.

    Args:
        place: the bag folder, made by `open`, whose parent must exist; or a file of evidence.
        topics: known beforehand; later ones by `add_topic`.
        records: MCAP metadata records by name, written before the first message.
        flush_period: seconds of `clock` between two syncs, about the most that a crash can cost.
        queue_bytes: memory that messages may take on their way to the file.
        block_when_full: let `put_message` wait for room instead of dropping (virtual time).
        clock: monotonic time, s.
    """

    def __init__(
        self,
        place: Path | FurtherFile,
        topics: Sequence[Topic],
        records: Mapping[str, Mapping[str, str]],
        *,
        flush_period: float = 0.2,
        queue_bytes: int = 64 * 1024 * 1024,
        block_when_full: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._place = place
        self.folder = place.folder if isinstance(place, FurtherFile) else place
        self._topics: dict[str, Topic] = {}
        self._first_topics = tuple(topics)
        self._records = dict(records)
        self._flush_period = flush_period
        self._queue_bytes = queue_bytes
        self._batch_bytes = min(CHUNK_BYTES, queue_bytes // 2)
        self._block = block_when_full
        self._clock = clock
        self._lock = threading.Lock()  # guards everything below
        self._changed = threading.Condition(self._lock)
        self._state = RecorderState.CLOSED
        self._closing = False
        self._blocked = 0
        self._queue: deque[_Item] = deque()
        self._queued = 0
        self._account = Account()
        self._span: tuple[int | None, int | None] = (None, None)
        self._file_bytes = 0
        self._synced: float | None = None
        self._synced_bytes = 0
        self._asked_bytes = sys.maxsize
        self._error: str | None = None
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Make the bag, its header, records and `metadata.yaml` on disk, and record.

        RecorderError leaves nothing behind.
        """
        if self._state is not RecorderState.CLOSED or self._closing:
            raise RecorderError(f"{self.folder} was recorded or closed before; make a new recorder")
        self._register_first_topics()
        bag = BagFolder(self._place, self._topics.values(), self._records)
        self._file_bytes = bag.file.size
        self._synced = self._clock()
        # A daemon: a program that ends without `close` must not hang on it.
        thread = threading.Thread(target=self._run, args=(bag,), name="recorder", daemon=True)
        self._state = RecorderState.RECORDING
        try:
            thread.start()
        except RuntimeError as error:
            self._state = RecorderState.CLOSED
            bag.remove()
            raise RecorderError(
                f"cannot record to {self.folder}: {error}; end other programs"
            ) from None
        self._thread = thread

    def start(self, niceness: int) -> None:
        """As `open`, in the writer's thread: nobody waits for the disk.

        Messages wait in memory until the file is there. If it cannot be made, they are dropped and
        `stats` has the error.
        """
        self._register_first_topics()
        target = partial(self._open_and_run, niceness)
        self._state = RecorderState.RECORDING
        self._thread = threading.Thread(target=target, name="recorder", daemon=True)
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
        if kind is None and (problem := stats.error or missing_words(stats)):
            raise RecorderError(problem)

    def put_message(self, message: RawMessage) -> bool:
        """Queue a message; False = it is dropped and counted. Never raises, never waits.

        With `block_when_full` it waits for room.
        """
        return self.put_all((message,)) == 1

    def put_all(self, messages: Iterable[RawMessage]) -> int:
        """As `put_message`, oldest first; returns how many were not dropped."""
        accepted, received = 0, self._account.received
        with self._lock:
            for message in messages:
                cost = len(message.data) + _OVERHEAD_BYTES
                received[message.topic] += 1
                reason = self._refusal(message, cost)
                while reason is _FULL and self._block:
                    self._wait_for_room()
                    reason = self._refusal(message, cost)
                if reason is None:
                    self._enqueue(message, cost)
                    accepted += 1
                else:
                    self._account.drop(message.topic, reason)
        return accepted

    def add_topic(self, topic: Topic) -> bool:
        """Register a topic that appeared while recording; returns whether it is recorded.

        It is not while not recording, if a bag cannot hold it, or if its name has another type.
        """
        with self._changed:
            if not self._accepting or topic_problem(topic) is not None:
                return False
            if topic.name in self._topics:
                return self._topics[topic.name].type == topic.type
            self._topics[topic.name] = topic
            self._enqueue(topic, len(topic.definition) + _OVERHEAD_BYTES)
            return True

    def add_record(self, name: str, record: Mapping[str, str]) -> bool:
        """False when not recording."""
        with self._changed:
            if not self._accepting:
                return False
            self._enqueue(_Record(name, dict(record)), _OVERHEAD_BYTES)
            return True

    def stats(self) -> RecorderStats:
        with self._changed:
            return RecorderStats(
                folder=self.folder,
                state=self._state,
                counts={name: self._account.saved[name] for name in self._topics},
                received=dict(self._account.received),
                dropped=dict(self._account.dropped()),
                drop_reasons=dict(self._account.reasons()),
                queued_bytes=self._queued,
                file_bytes=self._file_bytes,
                seconds_since_sync=None if self._synced is None else self._clock() - self._synced,
                start_ns=self._span[0],
                end_ns=self._span[1],
                error=self._error,
            )

    def finish(self) -> None:
        """As `close`, without waiting for it."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def close(self, timeout: float | None = 30.0) -> RecorderStats:
        """Write what is queued, finish the bag and its `metadata.yaml`; safe to call twice.

        `timeout` (s) is when an unresponsive disk counts as failed; None = never.
        """
        self.finish()
        if self._thread is not None:
            self._thread.join(timeout)
            if self._thread.is_alive():
                self._fail(TimeoutError(f"the disk did not answer within {timeout:g} s"))
        return self.stats()

    # Called with the lock held.

    @property
    def _accepting(self) -> bool:
        return self._state is RecorderState.RECORDING and not self._closing

    def _refusal(self, message: RawMessage, cost: int) -> DropReason | None:
        if self._state is not _RECORDING or self._closing:
            return DropReason.FAILED if self._error is not None else DropReason.NOT_RECORDING
        topic = self._topics.get(message.topic)
        if topic is None:
            return DropReason.UNKNOWN_TOPIC
        if topic.type != message.type:
            return DropReason.OTHER_TYPE
        if not (0 <= message.receive_ns < MAX_NS and 0 <= message.publish_ns < MAX_NS):
            return DropReason.BAD_TIME
        if cost > self._queue_bytes:
            return DropReason.TOO_LARGE
        return _FULL if self._queued + cost > self._queue_bytes else None

    def _enqueue(self, item: _Item, cost: int) -> None:
        self._queue.append(item)
        self._queued += cost
        if self._queued >= self._batch_bytes:
            self._changed.notify_all()

    def _wait_for_room(self) -> None:
        self._blocked += 1
        self._changed.notify_all()
        self._changed.wait()
        self._blocked -= 1

    def _work_is_due(self) -> bool:
        return self._closing or self._blocked > 0 or self._queued >= self._batch_bytes

    # Opening.

    def _register_first_topics(self) -> None:
        for topic in self._first_topics:
            problem = topic_problem(topic)
            first_topic = self._topics.setdefault(topic.name, topic)
            if first_topic.type != topic.type:
                problem = f"{topic.name} is both {first_topic.type} and {topic.type}"
            if problem is not None:
                raise RecorderError(f"{problem}; correct the topic's configuration")

    # The writer thread.

    def _open_and_run(self, niceness: int) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)
        try:
            bag = BagFolder(self._place, self._first_topics, self._records)
        except Exception as error:  # noqa: BLE001 - whatever it is, the program goes on
            self._fail(error)
        else:
            self._run(bag)

    def _run(self, bag: BagFolder) -> None:
        try:
            while self._write_batch(bag.file):
                pass
            bag.finish()
            self._report(bag.file)
            self._finish()
        except Exception as error:  # noqa: BLE001 - whatever it is, the run goes on
            with suppress(MemoryError):
                self._report(bag.file)
            self._fail(error)
        finally:
            bag.close()

    def _write_batch(self, file: McapFile) -> bool:
        """Write what is queued; False when it was the last."""
        timeout = self._until_sync()
        with self._changed:
            self._changed.wait_for(self._work_is_due, timeout)
            batch, self._queue = self._queue, deque()
            size, last = self._queued, self._closing
        if isinstance(self._place, FurtherFile):
            self._asked_bytes = 0
        for item in batch:
            if file.size > self._asked_bytes and not self._has_room(file, item):
                return False
            match item:
                case RawMessage():
                    file.add_message(item)
                case Topic():
                    file.register(item)
                case _Record():
                    file.add_record(item.name, item.content)
        if self._until_sync() <= 0:
            self._sync(file)
        self._report(file, size)
        return not last

    def _sync(self, file: McapFile) -> None:
        now = self._clock()
        file.sync()
        self._synced, self._synced_bytes = now, file.size

    def _has_room(self, file: McapFile, item: _Item) -> bool:
        """Ask before each chunk whether evidence may go on; syncs what would hold others up."""
        assert isinstance(self._place, FurtherFile)
        if file.size - self._synced_bytes >= SYNC_BYTES:
            self._sync(file)
        self._asked_bytes = file.size
        size = len(item.data) if isinstance(item, RawMessage) else _OVERHEAD_BYTES
        refusal = self._place.refusal(file.size, file.pending + size)
        if refusal is None:
            return True
        file.sync()
        self._report(file)
        with self._changed:
            self._closing, self._error = True, refusal
            self._give_up_rest()
        return False

    def _until_sync(self) -> float:
        """Seconds until the next sync is due, negative when overdue."""
        since = 0.0 if self._synced is None else self._clock() - self._synced
        return self._flush_period - since

    def _report(self, file: McapFile, done_bytes: int = 0) -> None:
        with self._changed:
            if self._state is RecorderState.FAILED:  # given up on; the account is closed
                return
            self._account.saved = file.saved
            self._span = (file.start_ns, file.end_ns)
            self._file_bytes = file.size
            self._queued -= done_bytes
            self._changed.notify_all()

    def _finish(self) -> None:
        with self._changed:
            if self._state is RecorderState.RECORDING:
                self._state = RecorderState.FINISHED

    def _fail(self, error: Exception) -> None:
        """Stop recording; everything received and not saved counts as dropped."""
        cause = (isinstance(error, OSError) and error.strerror) or str(error) or repr(error)
        hint = remedy(error) or "check the disk and its free space before the next run"
        outcome = f"what was written stays readable, {hint}"
        with self._changed:
            if self._state is not RecorderState.RECORDING:
                return
            self._state = RecorderState.FAILED
            if isinstance(error, FileNotFoundError):  # the file or its folder was deleted
                outcome = "what was written is lost, find out what deletes it before the next run"
                self._account.saved.clear()
                self._span, self._file_bytes = (None, None), 0
            failed = f"recording to {self.folder} failed: {cause}; {outcome}"
            self._error = str(error) if isinstance(error, RecorderError) else failed
            self._give_up_rest()

    def _give_up_rest(self) -> None:
        """With the lock held."""
        self._account.drop_rest()
        self._queue.clear()
        self._queued = 0
        self._changed.notify_all()
