"""Evidence recorded by a process of its own: neither its load nor its end is the engine's."""

from __future__ import annotations

import itertools
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.evidence_client import EvidencePlace, WitnessStatus
from madrob_console.engine.evidence_status import (
    QUIET,
    EvidenceNews,
    EvidenceRecording,
    FinishFile,
    LeaveDisk,
    ListenFor,
    ToEvidence,
    news_of,
    standing,
)
from madrob_console.engine.supervisor import delay_after
from madrob_console.engine.wire import frame
from madrob_console.engine.worker import END_TIME, Child, HangDetector, threads_of

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.evidence_worker")

PATIENCE = 4.0
"""A process that is silent and inactive for this long hangs, s."""

HANGS = 30.0
"""A process that is active but silent for this long hangs (an endless loop or a deadlock); s in
which neither a disk nor other programs held it up.
"""

FIRST_WORD = 20.0
"""Time of a new process until its first message, s."""

NEARLY_WRITTEN = 0.1
"""Wait of a recording's account for the last of it to be in its file, s."""

_PERIOD = 0.25


class EvidenceProcess:
    """Has evidence recorded in a process of its own; an `EvidenceClient`.

    The process listens from `warm` on, so that all topics are found before a run, and writes into
    the bag of a run while ordered to. One that has ended, or hangs, is started again and goes on in
    a file of its own; the run is told and otherwise untouched.
    """

    def __init__(self, observe: ListenFor, command: Sequence[str] = COMMAND) -> None:
        self._observe = observe
        self._command = tuple(command)
        self._numbers = itertools.count(1)
        self._status = WitnessStatus()
        self._closed = False
        self._lock = threading.Lock()  # of the orders and the bell
        self._orders: deque[EvidencePlace | FinishFile | LeaveDisk] = deque()
        self._bell: int | None = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._held = False
        self._counted, self._written = threading.Event(), threading.Event()
        # Of the thread.
        self._thread: threading.Thread | None = None
        self._child: Child[EvidenceNews] | None = None
        self._own_time: HangDetector | None = None
        self._recording: EvidenceRecording | None = None
        self._heard: EvidenceNews | None = None
        self._heard_at = 0.0
        self._starts_failed = 0
        self._trouble = ""

    # ------------------------------------------------------------------ the engine's thread

    @property
    def status(self) -> WitnessStatus:
        """From any thread."""
        return self._status

    @property
    def pid(self) -> int | None:
        child = self._child
        return None if child is None else child.pid

    def warm(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="evidence", daemon=True)
            self._thread.start()

    def begin_recording(self, place: EvidencePlace) -> None:
        self.warm()
        self._counted.clear()
        self._written.clear()
        self._order(place)

    def end(self) -> None:
        self._order(FinishFile(0))

    def await_account(self, limit: float) -> None:
        end = time.monotonic() + limit
        if self._counted.wait(limit):
            self._written.wait(min(NEARLY_WRITTEN, end - time.monotonic()))

    def hold_writing(self, *, held: bool) -> None:
        if held != self._held:
            self._held = held
            self._order(LeaveDisk(held))

    def close(self) -> None:
        """See `EvidenceClient`; an unfinished process goes on alone for a while."""
        self._closed = True
        self._ring()
        if self._thread is not None:
            self._thread.join(2 * END_TIME + 1.0)
        elif self._bell is not None:
            os.close(self._bell)
            self._bell = None

    def _order(self, order: EvidencePlace | FinishFile | LeaveDisk) -> None:
        with self._lock:
            self._orders.append(order)
        self._ring()

    def _ring(self) -> None:
        with self._lock, suppress(BlockingIOError):  # it rings already
            if self._bell is not None:
                os.eventfd_write(self._bell, 1)

    # ------------------------------------------------------------------ its thread

    def _work(self) -> None:
        """Keep a process running; no error ends the thread before `close`."""
        while not self._closed:
            why = self._one_process()
            if self._closed:
                break
            self._ended(why)
            self._pause(delay_after(self._starts_failed), why)
        with self._lock:
            bell, self._bell = self._bell, None
            orders, self._orders = self._orders, deque()
        assert bell is not None
        os.close(bell)
        for order in orders:
            if isinstance(order, EvidencePlace):
                os.close(order.folder_fd)
        if self._recording is not None:
            os.close(self._recording.place.folder_fd)
            self._recording = None

    def _one_process(self) -> str:
        self._starts_failed += 1
        try:
            child = self._child = Child(self._command, news_of)
        except (OSError, MemoryError, subprocess.SubprocessError) as error:
            return f"no process can be started ({getattr(error, 'strerror', None) or error!r})"
        why = ""
        self._heard, self._heard_at = None, time.monotonic() + FIRST_WORD - PATIENCE
        self._own_time = HangDetector(time.monotonic(), partial(threads_of, child.pid))
        try:
            self._send(child, self._observe)
            if self._recording is not None and self._recording.goes_on:
                self._record(child, self._recording)
            if self._held:
                self._send(child, LeaveDisk(True))
            self._serve(child)
        except (EOFError, ConnectionError):
            pass
        except MadrobError as error:
            why = str(error)
            child.kill()
        except Exception as error:  # noqa: BLE001  one bug costs one process: the thread goes on
            why = terminal_safe(repr(error))
            child.kill()
        self._child = None
        if self._closed:
            silent = time.monotonic() - self._heard_at > QUIET
            return child.end() if silent else child.leave()
        ended = child.end()
        return why or ended

    def _serve(self, child: Child[EvidenceNews]) -> None:
        assert self._bell is not None
        poll = select.poll()
        poll.register(self._bell, select.POLLIN)
        poll.register(child.link, select.POLLIN)
        while not self._closed:
            for handle, _ in poll.poll(1000 * _PERIOD):
                if handle == self._bell:
                    os.eventfd_read(self._bell)
                    self._hand_on(child)
                    continue
                for heard in child.receive():
                    self._starts_failed = 0
                    self._hear(heard)
            self._look(child)
        self._hand_on(child)

    def _look(self, child: Child[EvidenceNews]) -> None:
        now = time.monotonic()
        silence = now - self._heard_at
        if silence > PATIENCE and now - child.moved(now) > PATIENCE:
            raise MadrobError(f"it did not move for {silence:.0f} s")
        child.moved(now)
        assert self._own_time is not None
        if silence > PATIENCE and self._own_time.since(now) > HANGS:
            raise MadrobError(f"it said nothing for {silence:.0f} s")
        self._tell()

    def _hand_on(self, child: Child[EvidenceNews]) -> None:
        while True:
            with self._lock:
                if not self._orders:
                    return
                order = self._orders.popleft()
            match order:
                case EvidencePlace():
                    self._begin(order)
                    assert self._recording is not None
                    if self._heard is None:
                        self._recording.wait_for_process()
                    self._record(child, self._recording)
                case FinishFile():
                    self._finish(child)
                case LeaveDisk():
                    self._send(child, order)

    def _begin(self, place: EvidencePlace) -> None:
        if self._recording is not None:
            os.close(self._recording.place.folder_fd)
        self._trouble = ""
        self._recording = EvidenceRecording(next(self._numbers), place)
        self._tell()

    def _record(self, child: Child[EvidenceNews], recording: EvidenceRecording) -> None:
        self._send(child, recording.next_file(), recording.place.folder_fd)

    def _finish(self, child: Child[EvidenceNews] | None) -> None:
        recording = self._recording
        if recording is not None and recording.ended is None:
            recording.ended = time.monotonic()
            if child is not None:
                self._send(child, FinishFile(recording.number))
        self._tell()

    def _send(
        self, child: Child[EvidenceNews], order: ToEvidence, handle: int | None = None
    ) -> None:
        data = frame(order)
        try:
            if handle is None:
                sent = child.link.send(data)
            else:
                sent = socket.send_fds(child.link, [data], [handle])
        except BlockingIOError:
            sent = 0
        if sent != len(data):
            raise MadrobError("it takes no orders")

    def _ended(self, why: str) -> None:
        self._trouble = f"the evidence process is started again: {why}"
        if self._recording is not None:
            self._recording.lose_process(why)
        self._heard = None
        self._tell()

    def _hear(self, heard: EvidenceNews) -> None:
        self._heard, self._heard_at = heard, time.monotonic()
        if self._own_time is not None:
            self._own_time.restart_count(self._heard_at)
        if self._recording is not None:
            self._recording.hear(heard, self._heard_at)
        self._trouble = ""
        self._tell()
        if self._recording is not None and self._recording.counted:
            self._counted.set()
            if self._recording.unwritten == 0:
                self._written.set()

    def _tell(self) -> None:
        now = time.monotonic()
        self._status = standing(now, self._heard, self._heard_at, self._trouble, self._recording)

    def _pause(self, duration: float, why: str) -> None:
        assert self._bell is not None
        end = time.monotonic() + duration
        poll = select.poll()
        poll.register(self._bell, select.POLLIN)
        while not self._closed and (rest := end - time.monotonic()) > 0:
            if not poll.poll(1000 * rest):
                return
            os.eventfd_read(self._bell)
            with self._lock:
                orders, self._orders = self._orders, deque()
            for order in orders:
                match order:
                    case EvidencePlace():
                        self._begin(order)
                        assert self._recording is not None
                        self._recording.lose_process(why)
                    case FinishFile():
                        self._finish(None)
