"""Writes a run's evidence in its own thread, from a queue bounded in bytes."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from madrob_console.common.formatting import format_size
from recorder.bag import RawMessage, Topic, is_evidence
from recorder.errors import RecorderError, remedy
from recorder.mcap_writer import McapFile
from recorder.recovery import recover_evidence
from recorder.survey import put_listing, summarised

# A queue of evidence for the disk, bounded in bytes and fair to each topic.


_MEMORY_OVERHEAD = 400
"""Memory of a message beside its bytes."""

_MOST_EMPTY = 10_000


class _Place:
    __slots__ = ("message", "size")

    def __init__(self, message: RawMessage, size: int) -> None:
        self.message: RawMessage | None = message
        self.size = size


class EvidenceQueue:
    """Messages in their order, bounded in bytes of memory. Not thread-safe.

    Without room the topics of the lowest priority lose messages; among these the one that
    takes most room, the oldest first. So its last messages are kept, and no topic pays for
    a larger one.
    """

    def __init__(self, capacity: int) -> None:
        self.size = 0
        self._empty = 0
        self._capacity = capacity
        self._places: deque[_Place] = deque()
        self._topics: dict[str, deque[_Place]] = {}
        self._sizes: Counter[str] = Counter()
        self._priorities: dict[str, int] = {}

    def __len__(self) -> int:
        return sum(map(len, self._topics.values()))

    def put_message(self, message: RawMessage, priority: int) -> list[RawMessage]:
        """Add a message; returns those that were dropped for it, maybe itself."""
        topic, size = message.topic, len(message.data) + _MEMORY_OVERHEAD
        gone: list[RawMessage] = []
        self._priorities[topic] = priority
        while self.size + size > self._capacity:
            victim = self._victim(topic, size)
            if victim is None:
                return [*gone, message]
            gone.append(self._drop(victim))
        place = _Place(message, size)
        self._places.append(place)
        self._topics.setdefault(topic, deque()).append(place)
        self._sizes[topic] += size
        self.size += size
        return gone

    def take_messages(self, most: int) -> list[RawMessage]:
        """Remove and return the oldest messages: about `most` bytes, at least one."""
        taken: list[RawMessage] = []
        size = 0
        while self._places and size < most:
            place = self._places.popleft()
            if place.message is None:
                self._empty -= 1
                continue
            taken.append(place.message)
            size += place.size
            self._leave(place.message.topic)
        return taken

    def _victim(self, comes: str, size: int) -> str | None:
        """Topic that loses its oldest message; None = the coming one, which has none here."""
        sizes = {topic: taken for topic, taken in self._sizes.items() if taken}
        sizes[comes] = sizes.get(comes, 0) + size
        victim = min(sizes, key=lambda topic: (self._priorities[topic], -sizes[topic]))
        return victim if self._topics.get(victim) else None

    def _drop(self, topic: str) -> RawMessage:
        place = self._topics[topic][0]
        message, place.message = place.message, None
        self._leave(topic)
        assert message is not None
        self._empty += 1
        if self._empty > _MOST_EMPTY:
            self._places = deque(place for place in self._places if place.message is not None)
            self._empty = 0
        return message

    def _leave(self, topic: str) -> None:
        size = self._topics[topic].popleft().size
        self._sizes[topic] -= size
        self.size -= size


QUEUE_BYTES = 96_000_000
"""Memory of what waits for the disk: some seconds of four cameras."""

BATCH_BYTES = 1_000_000
"""Written between two checks whether scoring needs the disk."""

SYNC_BYTES, SYNC_PERIOD = 4_000_000, 0.5
"""Synced after so many bytes or s: syncs of the scoring then wait for little evidence."""

WRITER_NICE = 10
"""Niceness of the thread: what waits here waits in memory, what waits in DDS is lost."""

REPAIR_PERIOD = 2.0
"""Pause between two checks for room for a repair, s."""

_ROOM_PERIOD = 1.0
"""How often free space is checked, s; also before each batch."""

_OVERHEAD, _SPARE = 64, 1_000_000
"""Bytes of a message beside its data; bytes of a file beside its messages (its topic list)."""


@dataclass(frozen=True, slots=True)
class EvidenceWritten:
    """Status of an evidence recording.

    Attributes:
        messages, bytes: by topic, in the file or on their way to it.
        gave_way: by topic: dropped for lack of memory.
        refused: by topic: refused by the disk, or no room left for evidence.
        size: of the file, bytes.
        queued: bytes of memory that wait.
        silent: how long the disk has not answered, or was left to scoring, s.
        finished: whether the file is complete, or given up.
        ended: whether nothing more comes: all messages are counted.
        unwritten: messages not in the file yet; None = unknown, the file could not be finished.
        first_ns: time of the first message of each topic, steady ns.
        saved_ns: time of the last message in the file, steady ns; None = it is empty.
        unrepaired: which file of the run is damaged and what its repair waits for, in words.
    """

    messages: dict[str, int]
    bytes: dict[str, int]
    gave_way: dict[str, int]
    refused: dict[str, int]
    size: int
    queued: int
    silent: float
    problem: str
    finished: bool
    ended: bool = False
    unwritten: int | None = 0
    first_ns: dict[str, int] = field(default_factory=dict)
    saved_ns: int | None = None
    unrepaired: str = ""


class EvidenceRecorder:
    """Records into a new file of a bag that others write, too.

    Args:
        folder_fd: the open bag folder; closed when the file is finished.
        most_bytes: of the file: what is left of the budget.
        least_free: bytes that stay free on the disk, for scoring.
        capacity: bytes of memory of the queue.
    """

    def __init__(
        self,
        folder_fd: int,
        name: str,
        *,
        most_bytes: int,
        least_free: int,
        capacity: int = QUEUE_BYTES,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._fd = folder_fd
        self._name = name
        self._most_bytes = most_bytes
        self._least_free = least_free
        self._monotonic = monotonic
        self._queue = EvidenceQueue(capacity)
        self._topics: dict[str, Topic] = {}
        self._new_topics: list[Topic] = []
        self._messages: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self._gave_way: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._size = self._saved = 0
        self._first_ns: dict[str, int] = {}
        self._saved_ns: int | None = None
        self._torn = False
        self._problem = ""
        self._ending = False
        self._held = self._left = False
        self._unrepaired = ""
        self._finished = False
        self._busy_since: float | None = None
        self._changed = threading.Condition()  # guards everything above
        self._thread = threading.Thread(target=self._work, name="evidence writer", daemon=True)
        self._thread.start()

    def record_message(self, message: RawMessage, topic: Topic, priority: int) -> None:
        """Have a message recorded; never waits, and counts what finds no room."""
        with self._changed:
            if self._ending:
                return
            if self._problem:
                self._refused[message.topic] += 1
                return
            if topic.name not in self._topics:
                self._topics[topic.name] = topic
                self._new_topics.append(topic)
                self._first_ns[topic.name] = message.receive_ns
            self._add(message, 1)
            for gone in self._queue.put_message(message, priority):
                self._add(gone, -1)
                self._gave_way[gone.topic] += 1
            if self._queue.size >= BATCH_BYTES:
                self._changed.notify_all()

    def hold_writing(self, *, held: bool) -> None:
        """Write nothing while scoring waits for the disk."""
        with self._changed:
            self._held = held
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify_all()

    def leave(self) -> None:
        with self._changed:
            self._left = True
            self._changed.notify_all()

    def wait(self, limit: float) -> None:
        """Wait until the file is finished, `limit` s at most."""
        self._thread.join(limit)

    @property
    def finished(self) -> bool:
        return self._finished

    @property
    def written(self) -> EvidenceWritten:
        with self._changed:
            since = self._busy_since
            return EvidenceWritten(
                dict(self._messages),
                dict(self._bytes),
                dict(self._gave_way),
                dict(self._refused),
                self._size,
                self._queue.size,
                0.0 if since is None else self._monotonic() - since,
                self._problem,
                self._finished,
                self._ending,
                None if self._torn else self._messages.total() - self._saved,
                dict(self._first_ns),
                self._saved_ns,
                self._unrepaired,
            )

    def _add(self, message: RawMessage, number: int) -> None:
        self._messages[message.topic] += number
        self._bytes[message.topic] += number * len(message.data)

    # The writer's thread.

    def _work(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), WRITER_NICE)
        file: McapFile | None = None
        try:
            self._busy()
            file = McapFile(self._fd, self._name)
            file.start((), {})
            self._rest(file)
            while self._write(file):
                pass
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told, and the run goes on
            cause = (isinstance(error, OSError) and error.strerror) or str(error) or repr(error)
            hint = remedy(error) or "check the disk"
            saved = Counter[str]() if file is None else file.saved
            self._fail(f"no more evidence is recorded: {cause}; {hint}", saved)
        if file is not None:
            self._finish(file)
        with self._changed:
            self._finished = True
            self._busy_since = None
        self._repair()
        with suppress(OSError):
            os.close(self._fd)

    def _repair(self) -> None:
        """Repair what a killed process left of the same run; nobody waits for it.

        A repair copies the file: it waits until scoring has enough room meanwhile.
        """
        try:
            while (needed := self._largest_torn()) is not None:
                name, size = needed[0], needed[1] + _SPARE
                free = self._free()
                if free - size >= self._least_free:
                    recover_evidence(Path(f"/proc/self/fd/{self._fd}"))
                    break  # `madrob recover` says what is wrong with one that stays as it is
                told = (
                    f"{name} is not complete and waits for its repair, which takes "
                    f"{format_size(size)}: {format_size(free)} free, the score keeps "
                    f"{format_size(self._least_free)} for itself; make room by `madrob tidy`"
                )
                with self._changed:
                    self._unrepaired = told
                    if self._changed.wait_for(lambda: self._left, REPAIR_PERIOD):
                        break
        except (OSError, RecorderError):
            pass  # likewise
        with self._changed:
            self._unrepaired = ""

    def _largest_torn(self) -> tuple[str, int] | None:
        names = os.listdir(self._fd)  # noqa: PTH208  of a handle
        torn = [name for name in names if is_evidence(name) and not summarised(self._fd, name)]
        sizes = {name: os.stat(name, dir_fd=self._fd).st_size for name in torn}
        return max(sizes.items(), key=lambda one: one[1], default=None)

    def _write(self, file: McapFile) -> bool:
        synced, looked = self._monotonic(), 0.0
        unsynced = 0
        while True:
            with self._changed:
                self._busy_since = None
                self._changed.wait_for(self._is_due, max(0.0, SYNC_PERIOD / 2))
                while self._held:
                    self._busy_since = self._busy_since or self._monotonic()
                    self._changed.wait()
                batch = self._queue.take_messages(BATCH_BYTES)
                topics, self._new_topics = self._new_topics, []
                last = self._ending and not batch
                self._busy_since = self._monotonic()
            for topic in topics:
                file.register(topic)
            now = self._monotonic()
            if batch or now - looked >= _ROOM_PERIOD:
                looked = now
                if full := self._no_room_for(file, batch):
                    file.sync()  # what was taken so far is in it, and counted so
                    self._fail(full, file.saved)
                    return False
            before = file.size
            for message in batch:
                file.add_message(message)
            unsynced += file.size - before
            now = self._monotonic()
            if unsynced >= SYNC_BYTES or now - synced >= SYNC_PERIOD or last:
                file.sync()
                synced, unsynced = self._monotonic(), 0
            with self._changed:
                self._size, self._saved = file.size, file.saved.total()
                self._saved_ns = file.end_ns
            if file.size > self._most_bytes:
                file.sync()
                self._fail("the budget is used up: raise `recording.budget`", file.saved)
                return False
            if last:
                return False

    def _is_due(self) -> bool:
        return self._ending or self._held or self._queue.size >= BATCH_BYTES

    def _no_room_for(self, file: McapFile, batch: Sequence[RawMessage]) -> str:
        comes = sum(_OVERHEAD + len(message.data) for message in batch) + file.pending
        free = self._free()
        if free - comes - _SPARE >= self._least_free:
            return ""
        keeps = format_size(self._least_free)
        return (
            f"no more evidence is recorded: {format_size(free)} free, the score keeps {keeps} for "
            "itself; make room by `madrob tidy`"
        )

    def _free(self) -> int:
        at = os.fstatvfs(self._fd)
        return at.f_bavail * at.f_frsize

    def _rest(self, file: McapFile) -> None:
        with self._changed:
            self._size = file.size
            self._busy_since = None

    def _busy(self) -> None:
        with self._changed:
            self._busy_since = self._monotonic()

    def _fail(self, problem: str, saved: Counter[str]) -> None:
        with self._changed:
            self._problem = problem
            self._queue.take_messages(2 * self._queue.size)
            for topic, accepted in self._messages.items():
                lost = accepted - saved[topic]
                self._refused[topic] += lost
                self._bytes[topic] -= self._bytes[topic] * lost // max(1, accepted)
            self._messages, self._saved = saved.copy(), saved.total()

    def _finish(self, file: McapFile) -> None:
        self._busy()
        try:
            file.finish()
            with self._changed:
                self._size = file.size
            file.close()
            put_listing(self._fd)
        except Exception as error:  # noqa: BLE001 - as above
            cause = (isinstance(error, OSError) and error.strerror) or str(error) or repr(error)
            with self._changed:
                self._problem = self._problem or f"the evidence could not be finished: {cause}"
                self._torn = True
        finally:
            with suppress(OSError):
                file.close()
