"""Evidence recorded by a process of its own: neither its load nor its end is the engine's."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence

import msgspec

from madrob_console.engine.ipc.wire import decoded
from madrob_console.engine.runtime.evidence_client import EvidenceClient, EvidencePlace
from madrob_console.engine.runtime.evidence_status import (
    EvidenceNews,
    EvidenceRecording,
    FinishFile,
    LeaveDisk,
    ListenFor,
    status_of,
)
from madrob_console.engine.runtime.supervisor import END_TIME, Worker
from madrob_console.referee.evidence_account import EvidenceStatus

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.runtime.evidence_worker")

FIRST_WORD = 20.0
"""Time of a new process until its first message, s."""

NEARLY_WRITTEN = 0.1
"""Wait of a recording's account for the last of it to be in its file, s."""

_PERIOD = 0.25
_told: msgspec.msgpack.Decoder[EvidenceNews] = msgspec.msgpack.Decoder(EvidenceNews)


class EvidenceProcess(Worker, EvidenceClient):
    """Has evidence recorded in a process of its own.

    The process listens from `warm` on, so that all topics are found before a run, and writes into
    the bag of a run while ordered to. One that has ended, or hangs, is started again and goes on in
    a file of its own; the run is told and otherwise untouched.
    """

    patience = 4.0
    longest = 30.0
    status = EvidenceStatus()

    def __init__(self, observe: ListenFor, command: Sequence[str] = COMMAND) -> None:
        super().__init__(command)
        self._observe = observe
        self._warm = self._closed = self._held = False
        self._orders: deque[EvidencePlace | FinishFile | LeaveDisk] = deque()
        self._counted, self._written = threading.Event(), threading.Event()
        # Of the supervisor's thread.
        self._numbers = itertools.count(1)
        self._recording: EvidenceRecording | None = None
        self._news: EvidenceNews | None = None
        self._heard = 0.0
        self._trouble = ""

    # ------------------------------------------------------------------ the engine's thread

    def warm(self) -> None:
        self._warm = True
        self.ring()

    def begin_recording(self, place: EvidencePlace) -> None:
        self._counted.clear()
        self._written.clear()
        self._orders.append(place)
        self.warm()

    def end_recording(self) -> None:
        self._orders.append(FinishFile())
        self.ring()

    def await_account(self, limit: float) -> None:
        end = time.monotonic() + limit
        if self._counted.wait(limit):
            self._written.wait(min(NEARLY_WRITTEN, end - time.monotonic()))

    def hold_writing(self, *, held: bool) -> None:
        self._held = held
        self._orders.append(LeaveDisk(held))
        self.ring()

    def close(self) -> None:
        """An unfinished process goes on alone for a while."""
        self._closed = True
        self.ring()
        self.wait_until_left(2 * END_TIME + 1.0)

    # ------------------------------------------------------------------ the supervisor's thread

    @property
    def wanted(self) -> bool:
        return self._warm and not self._closed

    @property
    def goes_on(self) -> bool:
        return True  # its file gets complete

    def begin(self) -> None:
        self._news, self._heard = None, time.monotonic() + FIRST_WORD - self.patience
        self.send(self._observe)
        if self._held:
            self.send(LeaveDisk(held=True))
        if self._recording is not None and self._recording.goes_on:
            self.send(self._recording.next_file())

    def work(self, now: float) -> float:
        while self._orders:
            match self._orders.popleft():
                case EvidencePlace() as place:
                    self._begin(place)
                case FinishFile() as finish if self._recording is not None:
                    self._recording.ended = now
                    self._order(finish)
                case LeaveDisk() as leave:
                    self._order(leave)
        self._tell()
        return _PERIOD

    def _begin(self, place: EvidencePlace) -> None:
        self._recording = EvidenceRecording(next(self._numbers), place)
        if self._news is None:
            self._recording.open_gap(self._trouble or "its process was only being started")
        if self.pid is not None:
            self.send(self._recording.next_file())

    def _order(self, order: FinishFile | LeaveDisk) -> None:
        if self.pid is not None:
            self.send(order)

    def take(self, data: memoryview) -> None:
        self._news, self._heard = (
            decoded(_told, data, "a message of the process that records evidence"),
            time.monotonic(),
        )
        self._trouble = ""
        recording = self._recording
        if recording is not None:
            recording.hear(self._news, self._heard)
        self._tell()
        if recording is not None and recording.counted:
            self._counted.set()
            if recording.unwritten == 0:
                self._written.set()

    def lose(self, why: str) -> None:
        self._trouble = why
        if self._recording is not None:
            self._recording.lose_process(why)
        self._news = None
        self._tell()

    def due(self) -> float:
        return self._heard

    def _tell(self) -> None:
        trouble = self._trouble and f"the evidence process is started again: {self._trouble}"
        self.status = status_of(time.monotonic(), self._news, self._heard, trouble, self._recording)
