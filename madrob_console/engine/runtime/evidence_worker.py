"""`python -m madrob_console.engine.runtime.evidence_worker HANDLE`: records evidence.

It takes orders from the socket with this handle, finishes what it records and ends when the engine
closes its end. Whatever it does is of lower priority than the engine, for processor and disk.
"""

from __future__ import annotations

import ctypes
import gc
import math
import os
import select
import signal
import socket
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import format_size
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.wire import frame, frames
from madrob_console.engine.runtime.evidence_status import (
    EvidenceNews,
    FinishFile,
    LeaveDisk,
    ListenFor,
    RecordInto,
    ToEvidence,
)
from madrob_console.referee.evidence_account import EvidenceLoss, EvidenceTopic
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntakes, TakenEvidence
from madrob_console.testbeds.ros.watches import console_name
from recorder.errors import RecorderError
from recorder.writer import BagWriter, FurtherFile, RecorderState

# One recording: a file of the recorder's writer.


QUEUE_BYTES = 96_000_000
"""Memory of what waits for the disk, of all files: some seconds of four cameras."""

LEAST_QUEUE_BYTES = 8_000_000
"""Memory of what waits for a file while earlier ones wait for the disk."""

SYNC_PERIOD = 0.5
"""s"""

WRITER_NICE = 10
"""Niceness of the writer: what waits for it waits in memory, what waits in DDS is lost."""

_SPARE = 1_000_000
"""Bytes of a file beside its messages (its topic list)."""


class EvidenceFile:
    """One file of a recording.

    Its thread makes the file and finishes it. All else is called by one thread, and waits for no
    disk.
    """

    def __init__(self, order: RecordInto, queue_bytes: int, *, held: bool) -> None:
        place = order.place
        self.number = order.number
        self.finished = False
        self._folder = Path(place.folder)
        self._folder_fd = -1
        self._most_bytes = place.most_bytes
        self._least_free = place.least_free
        self._held = held
        self._ending = False
        self._began = time.monotonic()
        self._problem = ""
        self._early: list[TakenEvidence] = []
        self._came: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self._left_out: Counter[str] = Counter()
        self._too_large: Counter[str] = Counter()
        self._behind: Counter[str] = Counter()
        self._first: dict[str, float] = {}
        self._writer = BagWriter(
            FurtherFile(self._folder, order.file, self._refusal),
            (),
            {},
            flush_period=SYNC_PERIOD,
            queue_bytes=queue_bytes,
        )
        self._is_open, self._ended = threading.Event(), threading.Event()
        self._changed = threading.Condition()  # guards `_held`
        self._thread = threading.Thread(target=self._work, name="evidence", daemon=True)
        self._thread.start()

    @property
    def takes(self) -> bool:
        """Whether messages find room: until the file is there they wait in memory, then in DDS."""
        return self._is_open.is_set() or self._bytes.total() < QUEUE_BYTES

    @property
    def queued_bytes(self) -> int:
        return self._writer.stats().queued_bytes

    def record(self, taken: TakenEvidence) -> None:
        """Have messages of a topic recorded; counts those that are left out or find no room."""
        name = taken.topic.name
        self._left_out[name] += taken.left_out
        self._too_large[name] += taken.too_large
        if taken.messages:
            self._first.setdefault(name, taken.messages[0].receive_ns / NS)
            self._came[name] += len(taken.messages)
            self._bytes[name] += sum(len(message.data) for message in taken.messages)
            self._early.append(taken)
        self.advance()

    def advance(self) -> None:
        """Hand on what came, once the file is there; call it many times a second."""
        if not self._is_open.is_set():
            return
        for taken in self._early:
            self._writer.add_topic(taken.topic)
            refused = len(taken.messages) - self._writer.put_all(taken.messages)
            if refused and not self.problem:
                self._behind[taken.topic.name] += refused
        self._early.clear()
        if self._ending:
            self._ended.set()

    def hold_writing(self, *, held: bool) -> None:
        """Write nothing while scoring waits for the disk."""
        with self._changed:
            self._held = held
            self._changed.notify_all()

    def end(self) -> None:
        self._ending = True
        self.advance()

    def close(self, deadline: float) -> None:
        """Finish the file at once, by the `deadline` (monotonic s)."""
        self.hold_writing(held=False)
        self._is_open.wait(max(0.0, deadline - time.monotonic()))
        self.end()
        self._thread.join(max(0.0, deadline - time.monotonic()))

    @property
    def problem(self) -> str:
        return self._problem or self._writer.stats().error or ""

    def told(self, news: EvidenceNews) -> EvidenceNews:
        """The report with the status of this file, and with what was recorded of the topics."""
        stats = self._writer.stats()
        unsynced, end = stats.seconds_since_sync, stats.end_ns
        unwritten = self._came.total() - sum(stats.dropped.values()) - stats.written
        return msgspec.structs.replace(
            news,
            number=self.number,
            topics=tuple(
                self._counted(one, stats.dropped.get(one.topic, 0)) for one in news.topics
            ),
            failed=terminal_safe(self.problem),
            size=stats.file_bytes,
            queued=stats.queued_bytes,
            unsynced=time.monotonic() - self._began if unsynced is None else unsynced,
            unwritten=None if stats.state is RecorderState.FAILED else unwritten,
            saved=None if end is None else end / NS,
            ended=self._ending,
            finished=self.finished,
        )

    def _counted(self, topic: EvidenceTopic, dropped: int) -> EvidenceTopic:
        name, came = topic.topic, self._came[topic.topic]
        lost = {
            EvidenceLoss.BEHIND: self._behind[name],
            EvidenceLoss.TOO_LARGE: self._too_large[name],
            EvidenceLoss.DISK: dropped - self._behind[name],
        }
        return replace(
            topic,
            messages=came - dropped,
            bytes=self._bytes[name] * (came - dropped) // max(1, came),
            left_out=self._left_out[name],
            lost=topic.lost | {why: number for why, number in lost.items() if number > 0},
            first=self._first.get(name),
        )

    # Its thread, and that of the writer.

    def _work(self) -> None:
        with suppress(OSError):  # the writer's thread, made here, has it from this one
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), WRITER_NICE)
        try:
            self._folder_fd = os.open(self._folder, os.O_DIRECTORY | os.O_CLOEXEC)
            self._writer.open()
        except (OSError, RecorderError) as error:
            self._problem = f"no evidence is recorded: {error}"
        self._is_open.set()
        self._ended.wait()
        self._writer.close(timeout=None)
        self.finished = True
        with suppress(OSError):
            os.close(self._folder_fd)

    def _refusal(self, size: int, coming: int) -> str | None:
        with self._changed:
            self._changed.wait_for(lambda: not self._held)
        if size > self._most_bytes:
            return "the budget is used up: raise `recording.budget`"
        if (free := self._free()) - coming - _SPARE >= self._least_free:
            return None
        return (
            f"no more evidence is recorded: {format_size(free)} free, the score keeps "
            f"{format_size(self._least_free)} for itself; make room by `madrob tidy`"
        )

    def _free(self) -> int:
        disk = os.fstatvfs(self._folder_fd)
        return disk.f_bavail * disk.f_frsize


# The process: it listens all the time, and records when ordered to.


FIRST_TO_GO = 800
"""Out-of-memory score (of 1000): the kernel ends this process before all others of the engine."""

NICE = 4
"""Added to its niceness: the engine and scoring come first. With 10 it loses six times as many
messages that DDS hands over in shared memory; the thread that writes has 10 all the same.
"""

TELL_PERIOD = 0.5
"""How often the engine gets a status report, s."""

SETTLING = 4.0
"""Topics without a message for this long after the start count as silent, s."""

END_TIME = 20.0
"""Time to finish the file when the engine has gone, s."""

_PERIOD = 0.02
_DISCOVERY = 0.5

_decoder: msgspec.msgpack.Decoder[ToEvidence] = msgspec.msgpack.Decoder(ToEvidence)

_LOWEST_OF_BEST_EFFORT = (2 << 13) | 7
_IOPRIO_SET = {"x86_64": 251, "aarch64": 30}
"""Number of the system call ioprio_set(2), which the C library lacks."""


class EvidenceDesk:
    """Carries out the orders that come by the `link`, and reports."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._received = bytearray()
        self._intakes: EvidenceIntakes | None = None
        self._files: list[EvidenceFile] = []
        self._recording: EvidenceFile | None = None
        self._anchor: tuple[int, int] | None = None
        self._held = self._settled = False
        self._problem = ""
        self._settles = math.inf

    def work(self) -> None:
        """Until the engine has gone; raises `EOFError` then."""
        told = found = 0.0
        finished = 0
        while True:
            orders, before = self._orders(), finished
            for order in orders:
                self._carry_out(order)
            finished = sum(one.finished for one in self._files)
            now = time.monotonic()
            if self._intakes is not None and now - found >= _DISCOVERY:
                self._intakes.discover(recording=self._recording is not None)
                found = now
            self._take()
            for file in self._files:
                file.advance()
            if orders or finished > before or now - told >= TELL_PERIOD:
                self._tell()
                told = now
            time.sleep(_PERIOD)

    def close(self) -> None:
        deadline = time.monotonic() + END_TIME
        for file in self._files:
            file.close(deadline)
        if self._intakes is not None:
            self._intakes.close()

    def _orders(self) -> list[ToEvidence]:
        while select.select([self._link], [], [], 0)[0]:
            data = self._link.recv(1 << 16)
            if not data:
                raise EOFError
            self._received += data
        return [_decoder.decode(each) for each in frames(self._received)]

    def _carry_out(self, order: ToEvidence) -> None:
        match order:
            case ListenFor():
                self._listen(order)
            case RecordInto() if self._intakes is not None:
                self._begin(order, self._intakes)
            case FinishFile() if self._recording is not None:
                self._take()
                self._recording.end()
                self._tell()  # before a topic that has gone is forgotten
                self._recording = self._anchor = None
            case LeaveDisk(held):
                self._held = held
                for file in self._files:
                    file.hold_writing(held=held)

    def _listen(self, order: ListenFor) -> None:
        try:
            self._intakes = EvidenceIntakes(
                order.domain,
                order.choice,
                order.own_topics,
                ros_args=order.ros_args,
                environment=os.environ,
                name=console_name().replace("console", "evidence", 1),
            )
        except MadrobError as error:  # a new process could do no more
            self._problem = terminal_safe(str(error))
        self._settles = time.monotonic() + SETTLING
        gc.freeze()  # what was imported stays

    def _begin(self, order: RecordInto, intakes: EvidenceIntakes) -> None:
        self._files = [file for file in self._files if not file.finished]
        room = QUEUE_BYTES - sum(file.queued_bytes for file in self._files)
        self._anchor = (order.place.steady_ns, order.place.monotonic_ns)
        self._take()  # what came before the recording is none of it
        self._recording = EvidenceFile(order, max(room, LEAST_QUEUE_BYTES), held=self._held)
        self._files.append(self._recording)
        for kept in intakes.begin_recording():
            now = self._now_ns()
            said = [msgspec.structs.replace(message, receive_ns=now) for message in kept.messages]
            self._recording.record(TakenEvidence(kept.topic, said))

    def _take(self) -> None:
        recording = self._recording
        if self._intakes is None or not (recording is None or recording.takes):
            return
        for taken in self._intakes.take_messages(self._now_ns):
            if recording is not None:
                recording.record(taken)

    def _now_ns(self) -> int:
        """Steady time: that of the engine while there is a recording (protocol section 8)."""
        if self._anchor is None:
            return time.time_ns()
        steady, monotonic = self._anchor
        return steady + time.monotonic_ns() - monotonic

    def _tell(self) -> None:
        news = EvidenceNews(problem=self._problem)
        if (intakes := self._intakes) is not None:
            topics = intakes.topics()
            complete = bool(topics) and not intakes.unseen and all(one.rate for one in topics)
            self._settled |= complete or time.monotonic() > self._settles
            news = EvidenceNews(
                settled=self._settled,
                topics=topics,
                left_over=intakes.left_over,
                unseen=intakes.unseen,
            )
        self._link.sendall(frame(self._files[-1].told(news) if self._files else news))


def give_way() -> None:
    with suppress(OSError):
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))
    if (number := _IOPRIO_SET.get(os.uname().machine)) is not None:
        ctypes.CDLL(None).syscall(number, 1, 0, _LOWEST_OF_BEST_EFFORT)


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the evidence is finished first
    give_way()
    with Path(os.devnull).open("w") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())  # what DDS says there is of no program's
    desk = EvidenceDesk(socket.socket(fileno=int(sys.argv[1])))
    try:
        with suppress(EOFError, ConnectionError):
            desk.work()
    finally:
        desk.close()


if __name__ == "__main__":
    main()
