"""`python -m madrob_console.engine.runtime.evidence_worker HANDLE`: records evidence.

It takes orders from the socket with this handle, finishes what it records and ends when the engine
closes its end. Whatever it does is of lower priority than the engine, for processor and disk.
"""

from __future__ import annotations

import math
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, listed
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.wire import frame, frames
from madrob_console.engine.runtime.evidence_file import QUEUE_BYTES, EvidenceFile
from madrob_console.engine.runtime.evidence_order import EvidenceOrder, RecordInto
from madrob_console.referee.evidence_state import EvidenceState
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntakes, TakenEvidence
from madrob_console.testbeds.ros.watches import console_name

LEAST_QUEUE_BYTES = 8_000_000
"""Memory of what waits for a file while earlier ones wait for the disk."""

FIRST_TO_GO = 800
"""Out-of-memory score (of 1000): the kernel ends this process before all others of the engine."""

NICE = 4
"""Added to its niceness: the engine and scoring come first. With 10 it loses six times as many
messages that DDS hands over in shared memory; the thread that writes has 10 all the same.
"""

REPORT_PERIOD = 0.5
"""How often the engine gets a report, s."""

DISCOVERY_TIME = 4.0
"""All topics are discovered, and send, this long after the start, s."""

END_TIME = 20.0
"""Time to finish the file when the engine has gone, s."""

_PERIOD = 0.02
_DISCOVERY = 0.5

_decoder: msgspec.msgpack.Decoder[EvidenceOrder] = msgspec.msgpack.Decoder(EvidenceOrder)


class EvidenceServer:
    """Carries out the orders that come by the `link`, and reports the state."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._received = bytearray()
        self._intakes: EvidenceIntakes | None = None
        self._files: list[EvidenceFile] = []
        self._order: EvidenceOrder | None = None
        self._recording: EvidenceFile | None = None
        self._problem: str | None = None
        self._ready_at = math.inf

    def work(self) -> None:
        """Until the engine has gone; raises `EOFError` then."""
        reported = discovered = 0.0
        finished = 0
        while True:
            orders, before = self._orders(), finished
            for order in orders:
                self._carry_out(order)
            finished = sum(file.finished for file in self._files)
            now = time.monotonic()
            if self._intakes is not None and now - discovered >= _DISCOVERY:
                self._intakes.discover(recording=self._recording is not None)
                discovered = now
            self._take_messages()
            if orders or finished > before or now - reported >= REPORT_PERIOD:
                self._report()
                reported = now
            time.sleep(_PERIOD)

    def close(self) -> None:
        deadline = time.monotonic() + END_TIME
        for file in self._files:
            file.close(deadline)
        if self._intakes is not None:
            self._intakes.close()

    def _orders(self) -> list[EvidenceOrder]:
        while select.select([self._link], [], [], 0)[0]:
            data = self._link.recv(1 << 16)
            if not data:
                raise EOFError
            self._received += data
        return [_decoder.decode(each) for each in frames(self._received)]

    def _carry_out(self, order: EvidenceOrder) -> None:
        if self._order is None:
            self._listen(order)
        elif self._recording is not None and order.recording != self._order.recording:
            self._take_messages()
            self._recording.end()
            self._report()  # before a topic that has gone is forgotten
            self._recording = None
        self._order = order
        if order.recording is not None and self._recording is None:
            self._begin(order.recording, held=order.held)
        for file in self._files:
            file.hold_writing(held=order.held)

    def _listen(self, order: EvidenceOrder) -> None:
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
        self._ready_at = time.monotonic() + DISCOVERY_TIME

    def _begin(self, order: RecordInto, *, held: bool) -> None:
        if self._intakes is None:
            return
        self._files = [file for file in self._files if not file.finished]
        room = QUEUE_BYTES - sum(file.stats.memory_bytes for file in self._files)
        self._take_messages()  # drop messages from before the recording
        self._recording = EvidenceFile(order, max(room, LEAST_QUEUE_BYTES), held=held)
        self._files.append(self._recording)
        for history in self._intakes.begin_recording():
            now = self._now_ns()
            messages = [msgspec.structs.replace(each, receive_ns=now) for each in history.messages]
            self._recording.record(TakenEvidence(history.topic, messages))

    def _take_messages(self) -> None:
        if self._intakes is None:
            return
        for taken in self._intakes.take_messages(self._now_ns):
            if self._recording is not None:
                self._recording.record(taken)

    def _now_ns(self) -> int:
        """Steady time: that of the engine while there is a recording (protocol section 8)."""
        if self._order is None or self._order.recording is None:
            return time.time_ns()
        place = self._order.recording.place
        return place.steady_ns + time.monotonic_ns() - place.monotonic_ns

    def _report(self) -> None:
        state = EvidenceState(problem=self._problem)
        if (intakes := self._intakes) is not None:
            state = EvidenceState(
                ready=time.monotonic() > self._ready_at,
                topics=intakes.topics(),
                missing=tuple(_missing(intakes)),
            )
        self._link.sendall(frame(self._files[-1].with_counts(state) if self._files else state))


def _missing(intakes: EvidenceIntakes) -> Iterator[str]:
    if unseen := intakes.unseen:
        yield f"nobody publishes {listed(unseen)}"
    if left := intakes.left_over:
        yield f"{counted(len(left), 'topic')} too many, {listed(left)}: not recorded"


def give_way() -> None:
    with suppress(OSError):
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the evidence is finished first
    give_way()
    with Path(os.devnull).open("w") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())  # what DDS prints, no program reads
    server = EvidenceServer(socket.socket(fileno=int(sys.argv[1])))
    try:
        with suppress(EOFError, ConnectionError):
            server.work()
    finally:
        server.close()


if __name__ == "__main__":
    main()
