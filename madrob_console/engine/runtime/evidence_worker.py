"""`python -m madrob_console.engine.runtime.evidence_worker HANDLE`: records topics beside a run.

It takes one order from the socket with this handle, and records until the socket says anything
more, or ends with the engine: then it finishes its bag and ends. It has a lower priority than the
engine, for processor and memory.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import socket
import sys
import time
from collections import Counter
from contextlib import suppress
from itertools import count
from pathlib import Path

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import format_size
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.wire import frame, frames
from madrob_console.referee.evidence import Evidence, EvidenceTopic
from madrob_console.testbeds.ros.evidence_topics import SILENT_AFTER, EvidenceTopics
from recorder import BagWriter, RecorderError
from recorder.bag import EVIDENCE

FIRST_TO_GO = 800
"""Out-of-memory score (of 1000): the kernel ends this process before all others of the engine."""

NICE = 4
"""Added to its niceness; with 10 it loses six times as many messages that come by shared memory."""

REPORT_PERIOD = 0.5
"""How often the engine gets a report, s."""

_PERIOD = 0.02


class EvidenceOrder(msgspec.Struct, frozen=True):
    """What is recorded, and where.

    Attributes:
        folder: of the run; the bag is a folder in it.
        steady_ns: steady time of the engine (protocol section 8), ns since the epoch.
        monotonic_ns: the machine's monotonic time at the same moment.
        least_free: bytes that stay free on the disk, for the run.
    """

    domain: int
    topics: tuple[str, ...]
    folder: str
    steady_ns: int
    monotonic_ns: int
    least_free: int

    def now_ns(self) -> int:
        """Return the steady time of now."""
        return self.steady_ns + time.monotonic_ns() - self.monotonic_ns


class EvidenceRecorder:
    """Records the topics of an order into a new bag, and counts them."""

    def __init__(self, order: EvidenceOrder, listened: EvidenceTopics) -> None:
        self._order = order
        self._listened = listened
        self._heard_ns = dict.fromkeys(order.topics, order.steady_ns)
        self._problem = ""
        self._writer = BagWriter(_free_folder(Path(order.folder)), [], {})
        self._writer.open()

    def record(self) -> None:
        """Record what has come since the last call."""
        messages = self._listened.take_messages(self._order.now_ns())
        for topic in self._listened.topics:
            self._writer.add_topic(topic)
        for message in messages:
            self._heard_ns[message.topic] = message.receive_ns
        if not self._problem:
            self._writer.put_all(messages)

    def report(self) -> Evidence:
        """Return what was recorded; from now on nothing is if the disk has too little room."""
        order = self._order
        if shutil.disk_usage(order.folder).free < order.least_free and not self._problem:
            size = format_size(order.least_free)
            self._problem = f"the disk has less than {size} left: nothing more is recorded"
        stats = self._writer.stats()
        lost = Counter(self._listened.lost()) + stats.lost
        late = self._listened.kept_for_late
        topics = {}
        for name, heard_ns in self._heard_ns.items():
            is_silent = order.now_ns() - heard_ns > SILENT_AFTER * NS and name not in late
            since = heard_ns / NS if is_silent else None
            topics[name] = EvidenceTopic(stats.recorded[name], lost[name], since)
        unusable = [f"{name}: {why}" for name, why in self._listened.problems.items()]
        return Evidence(topics, self._problem or stats.error or "; ".join(unusable))

    def finish(self) -> Evidence:
        """Finish the bag, and return what is in it."""
        self.record()
        self._writer.close()
        return self.report()


def _free_folder(run: Path) -> Path:
    for number in count(1):
        folder = run / f"{run.name}{EVIDENCE}{'' if number == 1 else f'_{number}'}"
        if not folder.exists():
            return folder
    raise AssertionError


def serve(link: socket.socket) -> None:
    """Record what the first message of the link orders, and report, until there is another one."""
    order = msgspec.msgpack.decode(_first_frame(link), type=EvidenceOrder)
    try:
        with EvidenceTopics(order.domain, order.topics) as listened:
            recorder = EvidenceRecorder(order, listened)
            next_report = 0.0
            while not select.select([link], [], [], _PERIOD)[0]:
                recorder.record()
                if time.monotonic() >= next_report:
                    next_report = time.monotonic() + REPORT_PERIOD
                    link.sendall(frame(recorder.report()))
            link.sendall(frame(recorder.finish()))
    except (MadrobError, RecorderError) as error:  # a new process could do no more
        problem = terminal_safe(str(error))
        while not select.select([link], [], [], REPORT_PERIOD)[0]:
            link.sendall(frame(Evidence(problem=problem)))


def _first_frame(link: socket.socket) -> bytes:
    received = bytearray()
    while data := link.recv(1 << 16):
        received += data
        for content in frames(received):
            return content
    raise EOFError


def give_way() -> None:
    with suppress(OSError):
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the bag is finished first
    give_way()
    with Path(os.devnull).open("w") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())  # what DDS prints, no program reads
    with suppress(EOFError, ConnectionError), socket.socket(fileno=int(sys.argv[1])) as link:
        serve(link)


if __name__ == "__main__":
    main()
