"""`python -m madrob_console.engine.evidence_worker HANDLE`: records evidence.

It takes orders from the socket with this handle, finishes what it records and ends when the engine
closes its end. Whatever it does is of lower priority than the engine, for processor and disk.
"""

from __future__ import annotations

import ctypes
import gc
import os
import select
import signal
import socket
import sys
import time
from collections import Counter, deque
from contextlib import suppress
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.evidence_recorder import EvidenceRecorder
from madrob_console.engine.evidence_status import (
    EvidenceNews,
    FinishFile,
    LeaveDisk,
    ListenFor,
    RecordInto,
    ToEvidence,
    order_of,
)
from madrob_console.engine.wire import frame
from madrob_console.engine.worker import frames
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntakes
from madrob_console.testbeds.ros.watches import console_name

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
_MOST_UNFINISHED = 3
"""Most recordings unfinished by a slow disk; before that no other is begun."""

_LOWEST_OF_BEST_EFFORT = (2 << 13) | 7
_IOPRIO_SET = {"x86_64": 251, "aarch64": 30}
"""Number of the system call ioprio_set(2), which the C library lacks."""


class OrderLine:
    """The connection to the engine."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._received = bytearray()
        self._waiting: deque[ToEvidence] = deque()
        self.handles: deque[int] = deque()

    def orders(self) -> list[ToEvidence]:
        while select.select([self._link], [], [], 0)[0]:
            data, handles, _, _ = socket.recv_fds(self._link, 1 << 16, 8)
            self.handles.extend(handles)
            if not data:
                raise EOFError
            self._received += data
            self._waiting.extend(order_of(each) for each in frames(self._received))
        found = list(self._waiting)
        self._waiting.clear()
        return found

    def first_order(self) -> ListenFor:
        while True:
            for number, order in enumerate(orders := self.orders()):
                if isinstance(order, ListenFor):
                    self._waiting.extend(orders[number + 1 :])
                    return order
            time.sleep(_PERIOD)

    def send_news(self, heard: EvidenceNews) -> None:
        self._link.sendall(frame(heard))


class EvidenceDesk:
    """Listens all the time, and records when ordered to."""

    def __init__(self, line: OrderLine, intakes: EvidenceIntakes) -> None:
        self._line = line
        self._intakes = intakes
        self._recorders: dict[int, EvidenceRecorder] = {}
        self._current: EvidenceRecorder | None = None
        self._anchor: tuple[int, int] | None = None
        self._held = False
        self._left_out: Counter[str] = Counter()
        self._too_large: Counter[str] = Counter()
        self._lost_before: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._problem = ""
        self._began = time.monotonic()
        self._settled = False

    def work(self) -> None:
        told = found = 0.0
        finished = 0
        while True:
            before, finished = finished, sum(one.finished for one in self._recorders.values())
            changed = finished > before  # somebody waits for it
            for order in self._line.orders():
                self._carry_out(order)
                changed = True
            now = time.monotonic()
            if now - found >= _DISCOVERY:
                self._intakes.discover(recording=self._current is not None)
                found = now
            self._take()
            if changed or now - told >= TELL_PERIOD:
                self._tell()
                told = now
            self._intakes.rest(_PERIOD)

    def close(self) -> None:
        end = time.monotonic() + END_TIME
        for recorder in self._recorders.values():
            recorder.hold_writing(held=False)
            recorder.end()
            recorder.leave()
        for recorder in self._recorders.values():
            recorder.wait(max(0.0, end - time.monotonic()))

    def _carry_out(self, order: ToEvidence) -> None:
        match order:
            case RecordInto():
                self._begin(order)
            case FinishFile(number):
                self._take()
                self._end(number)
            case LeaveDisk(held):
                self._held = held
                for recorder in self._recorders.values():
                    recorder.hold_writing(held=held)
            case ListenFor():
                raise MadrobError("listens already")

    def _begin(self, order: RecordInto) -> None:
        if not self._line.handles:
            self._problem = "the run's folder did not arrive: is there a file handle left?"
            return
        folder = self._line.handles.popleft()
        for recorder in self._recorders.values():
            recorder.leave()
        self._recorders = {n: r for n, r in self._recorders.items() if not r.written.finished}
        if len(self._recorders) >= _MOST_UNFINISHED:
            os.close(folder)
            self._problem = "the disk has not taken earlier evidence: nothing new is recorded"
            return
        self._problem = ""
        self._anchor = (order.steady_ns, order.monotonic_ns)
        self._take()  # what came before the recording is none of it
        said_before = self._intakes.begin_recording()
        self._left_out.clear()
        self._too_large.clear()
        self._lost_before = {flow.topic: flow.lost for flow in self._intakes.flows()}
        recorder = EvidenceRecorder(
            folder, order.file_name, most_bytes=order.most_bytes, least_free=order.least_free
        )
        recorder.hold_writing(held=self._held)
        self._recorders[order.number] = self._current = recorder
        for topic, limit, message in said_before:
            said = type(message)(
                message.topic, message.type, message.data, message.publish_ns, self._now_ns()
            )
            recorder.record_message(said, topic, limit.priority)

    def _end(self, number: int) -> None:
        if (recorder := self._recorders.get(number)) is not None:
            recorder.end()
            if recorder is self._current:
                self._lost = self._lost_now()
                self._current = self._anchor = None

    def _take(self) -> None:
        for taken in self._intakes.take_messages(self._now_ns):
            if self._current is None:
                continue
            name = taken.topic.name
            self._left_out[name] += taken.left_out
            self._too_large[name] += taken.too_large
            for message in taken.messages:
                self._current.record_message(message, taken.topic, taken.limit.priority)

    def _now_ns(self) -> int:
        """Steady time: that of the engine while there is a recording (protocol section 8)."""
        if self._anchor is None:
            return time.time_ns()
        steady, monotonic = self._anchor
        return steady + time.monotonic_ns() - monotonic

    def _lost_now(self) -> dict[str, int]:
        before = self._lost_before
        flows = self._intakes.flows()
        return {f.topic: lost for f in flows if (lost := f.lost - before.get(f.topic, 0)) > 0}

    def _tell(self) -> None:
        if self._current is not None:
            self._lost = self._lost_now()
        flows = self._intakes.flows()
        complete = bool(flows) and not self._intakes.unseen
        self._settled |= complete and all(flow.rate for flow in flows)
        self._settled |= time.monotonic() - self._began > SETTLING
        heard = EvidenceNews(
            settled=self._settled,
            flows=flows,
            left_over=self._intakes.left_over,
            unseen=self._intakes.unseen,
            scored=self._intakes.scored,
            recordings={number: one.written for number, one in self._recorders.items()},
            left_out=+self._left_out,
            too_large=+self._too_large,
            lost=self._lost,
            problem=self._problem,
        )
        self._line.send_news(heard)


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
    line = OrderLine(socket.socket(fileno=int(sys.argv[1])))
    with suppress(EOFError, ConnectionError):
        wanted = line.first_order()
        try:
            intakes = EvidenceIntakes(
                wanted.domain,
                wanted.choice,
                wanted.own_topics,
                ros_args=wanted.ros_args,
                environment=os.environ,
                name=console_name().replace("console", "evidence", 1),
            )
        except MadrobError as error:
            _wait_in_vain(line, str(error))
            return
        gc.freeze()  # what was imported stays
        desk = EvidenceDesk(line, intakes)
        try:
            desk.work()
        finally:
            desk.close()
            intakes.close()


def _wait_in_vain(line: OrderLine, why: str) -> None:
    """Idle: without ROS nothing can be recorded, and a restart would change nothing."""
    while True:
        for _ in line.orders():
            while line.handles:
                os.close(line.handles.popleft())
        line.send_news(EvidenceNews(problem=terminal_safe(why)))
        time.sleep(TELL_PERIOD)


if __name__ == "__main__":
    main()
