"""Records evidence in a process of its own: its crash or its load does not affect the engine."""

from __future__ import annotations

import itertools
import sys
import time
from collections import deque
from collections.abc import Sequence

import msgspec

from madrob_console.engine.ipc.wire import decoded
from madrob_console.engine.runtime.evidence_client import EvidenceClient, EvidencePlace
from madrob_console.engine.runtime.evidence_order import EvidenceOrder
from madrob_console.engine.runtime.evidence_recording import QUIET, EvidenceRecording
from madrob_console.engine.runtime.supervisor import END_TIME, Worker
from madrob_console.referee.evidence_state import EvidenceState

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.runtime.evidence_worker")

FIRST_REPORT = 20.0
"""Time of a new process until its first report, s."""

_PERIOD = 0.25
_reports: msgspec.msgpack.Decoder[EvidenceState] = msgspec.msgpack.Decoder(EvidenceState)


class EvidenceProcess(Worker, EvidenceClient):
    """Has evidence recorded in a process of its own.

    The process listens from `warm` on, so that all topics are discovered before a run, and writes
    into the bag of a run while ordered to. One that has ended, or hangs, is started again and goes
    on in a file of its own; the run is otherwise untouched.
    """

    patience = 4.0
    longest = 30.0
    state = EvidenceState()

    def __init__(self, order: EvidenceOrder, command: Sequence[str] = COMMAND) -> None:
        """`order` says where it listens to which topics."""
        super().__init__(command)
        self._order = order
        self._warm = self._closed = self._held = False
        self._numbers = itertools.count(1)
        self._recording: EvidenceRecording | None = None
        self._orders: deque[EvidenceOrder] = deque()
        # Of the supervisor's thread.
        self._report: EvidenceState | None = None
        self._reported = 0.0
        self._trouble = ""

    # ------------------------------------------------------------------ the engine's thread

    def warm(self) -> None:
        self._warm = True
        self.ring()

    def begin_recording(self, place: EvidencePlace) -> None:
        recording = EvidenceRecording(next(self._numbers), place)
        if self._report is None:
            recording.open_gap(self._trouble or "its process was only being started")
        self._recording = recording
        self._update_state()
        self._submit_order()
        self.warm()

    def end_recording(self) -> None:
        if self._recording is not None:
            self._recording.ended = time.monotonic()
        self._submit_order()

    def await_account(self, limit: float) -> None:
        if self._recording is not None:
            self._recording.written.wait(limit)

    def hold_writing(self, *, held: bool) -> None:
        self._held = held
        self._submit_order()

    def _submit_order(self) -> None:
        self._orders.append(self._current_order())
        self.ring()

    def _current_order(self) -> EvidenceOrder:
        recording = None if self._recording is None else self._recording.order
        return msgspec.structs.replace(self._order, recording=recording, held=self._held)

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
        return True  # it completes its file

    def begin(self) -> None:
        self._report, self._reported = None, time.monotonic() + FIRST_REPORT - self.patience
        self._orders.clear()
        self.send(self._current_order())

    def work(self, now: float) -> float:
        while self.pid is not None and self._orders:
            self.send(self._orders.popleft())
        self._update_state()
        return _PERIOD

    def take(self, data: memoryview) -> None:
        self._report = decoded(_reports, data, "a report of the evidence process")
        self._reported, self._trouble = time.monotonic(), ""
        recording = self._recording
        if recording is not None:
            recording.add_report(self._report, self._reported)
        self._update_state()
        if recording is not None and recording.is_written:
            recording.written.set()

    def lose(self, why: str) -> None:
        self._trouble, self._report = why, None
        if self._recording is not None:
            self._recording.lose_process(why)
        self._update_state()

    def due(self) -> float:
        return self._reported

    def _update_state(self) -> None:
        live = live_state(self._report, time.monotonic() - self._reported, self._trouble)
        recording = self._recording
        self.state = live if recording is None else recording.merged_into(live)


def live_state(report: EvidenceState | None, silent: float, trouble: str = "") -> EvidenceState:
    """The current state: the last `report`, `silent` s old, or why there is no process."""
    if trouble:
        return EvidenceState(problem=f"the evidence process is started again: {trouble}")
    if report is None:
        return EvidenceState()
    if silent > QUIET:  # the last report is too old
        return EvidenceState(problem=f"the evidence process is silent for {silent:.0f} s")
    return report
