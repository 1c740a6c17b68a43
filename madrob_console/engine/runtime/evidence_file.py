"""One file of an evidence recording, in the evidence process."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from madrob_console.common.clock import NS
from madrob_console.common.formatting import format_size
from madrob_console.common.names import terminal_safe
from madrob_console.engine.runtime.evidence_orders import RecordInto
from madrob_console.referee.evidence_account import EvidenceLoss
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.testbeds.ros.evidence_intake import TakenEvidence
from recorder.bag import is_evidence
from recorder.errors import RecorderError
from recorder.writer import BagWriter, FurtherFile, RecorderState, RecorderStats

QUEUE_BYTES = 96_000_000
"""Memory of what waits for the disk, of all files: some seconds of four cameras."""

SYNC_PERIOD = 0.5
"""s"""

WRITER_NICE = 10
"""Niceness of the writer, for processor and disk: what waits for it waits in memory, what waits for
DDS to be read is lost."""

STUCK_AFTER = 1.5
"""The disk is stuck when it has taken nothing for this long, s."""

SLOW_END = 5.0
"""A file that is incomplete this long after the end of the recording is a problem, s."""

_SPARE = 1_000_000
"""Bytes of a file beside its messages (its topic list)."""


class EvidenceFile:
    """One file of a recording.

    Its thread makes the file and finishes it. All else is called by one thread, and waits for no
    disk.
    """

    def __init__(self, order: RecordInto, queue_bytes: int, *, held: bool) -> None:
        place = order.place
        self._number = order.number
        self._folder = Path(place.folder)
        self._folder_fd = -1
        self._most_bytes = place.most_bytes
        self._least_free = place.least_free
        self._held = held
        self._began = time.monotonic()
        self._ended: float | None = None
        self._refused = ""
        self._early: list[TakenEvidence] = []
        self._received: Counter[str] = Counter()
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
        self._is_open, self._handed_on = threading.Event(), threading.Event()
        self._changed = threading.Condition()  # guards `_held`
        self._thread = threading.Thread(target=self._work, name="evidence", daemon=True)
        self._thread.start()

    @property
    def has_room(self) -> bool:
        """Whether messages find room: until the file is there they wait in memory, then in DDS."""
        return self._is_open.is_set() or self._bytes.total() < QUEUE_BYTES

    @property
    def finished(self) -> bool:
        """Whether the file is complete, or given up."""
        return not self._thread.is_alive()

    @property
    def stats(self) -> RecorderStats:
        return self._writer.stats()

    def record(self, taken: TakenEvidence) -> None:
        """Have messages of a topic recorded; counts those that are left out or find no room."""
        name = taken.topic.name
        self._left_out[name] += taken.left_out
        self._too_large[name] += taken.too_large
        if taken.messages:
            self._first.setdefault(name, taken.messages[0].receive_ns / NS)
            self._received[name] += len(taken.messages)
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
            if refused and not self._problem(self.stats):
                self._behind[taken.topic.name] += refused
        self._early.clear()
        if self._ended is not None:
            self._handed_on.set()

    def hold_writing(self, *, held: bool) -> None:
        """Write nothing while scoring waits for the disk."""
        with self._changed:
            self._held = held
            self._changed.notify_all()

    def end(self) -> None:
        self._ended = time.monotonic()
        self.advance()

    def close(self, deadline: float) -> None:
        """Finish the file at once, by the `deadline` (monotonic s)."""
        self.hold_writing(held=False)
        self._is_open.wait(max(0.0, deadline - time.monotonic()))
        self.end()
        self._thread.join(max(0.0, deadline - time.monotonic()))

    def with_counts(self, state: EvidenceState) -> EvidenceState:
        """The state with this file, and with what was recorded of the topics."""
        stats, now = self.stats, time.monotonic()
        problem, recording = self._problem(stats), self._ended is None
        finishing = not (recording or self.finished)
        ending = 0.0 if self._ended is None else now - self._ended
        slow = f"not complete on disk {ending:.0f} s after the end of the recording"
        unsynced = stats.seconds_since_sync
        if unsynced is None:
            unsynced = now - self._began
        unwritten = self._received.total() - sum(stats.dropped.values()) - stats.written
        return replace(
            state,
            topics=tuple(self._counted(topic, stats) for topic in state.topics),
            problem=problem or (slow if finishing and ending > SLOW_END else None),
            stuck=stuck_words(unsynced, stats.queued_bytes) if recording and not problem else "",
            number=self._number,
            recording=recording,
            finishing=finishing,
            problems=(problem,) if problem else (),
            unwritten=None if stats.state is RecorderState.FAILED else unwritten,
            saved=None if stats.end_ns is None else stats.end_ns / NS,
        )

    def _problem(self, stats: RecorderStats) -> str:
        return terminal_safe(self._refused or stats.error or "")

    def _counted(self, topic: EvidenceTopic, stats: RecorderStats) -> EvidenceTopic:
        name, dropped = topic.topic, stats.dropped.get(topic.topic, 0)
        received = self._received[name]
        lost = {
            EvidenceLoss.BEHIND: self._behind[name],
            EvidenceLoss.TOO_LARGE: self._too_large[name],
            EvidenceLoss.DISK: dropped - self._behind[name],
        }
        return replace(
            topic,
            messages=received - dropped,
            bytes=self._bytes[name] * (received - dropped) // max(1, received),
            left_out=self._left_out[name],
            lost=topic.lost | {why: number for why, number in lost.items() if number > 0},
            first=self._first.get(name),
        )

    # Its thread, and that of the writer.

    def _work(self) -> None:
        with suppress(OSError):  # the thread of the writer, started here, inherits it
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), WRITER_NICE)
        try:
            self._folder_fd = os.open(self._folder, os.O_DIRECTORY | os.O_CLOEXEC)
            with os.scandir(self._folder_fd) as files:  # an earlier process may have recorded some
                self._most_bytes -= sum(f.stat().st_size for f in files if is_evidence(f.name))
            self._writer.open()
        except (OSError, RecorderError) as error:
            self._refused = f"no evidence is recorded: {error}"
        self._is_open.set()
        self._handed_on.wait()
        self._writer.close(timeout=None)
        with suppress(OSError):
            os.close(self._folder_fd)

    def _refusal(self, size: int, coming: int) -> str | None:
        with self._changed:
            self._changed.wait_for(lambda: not self._held)
        if size > self._most_bytes:
            return "the budget is used up: raise `recording.budget`"
        disk = os.fstatvfs(self._folder_fd)
        free = disk.f_bavail * disk.f_frsize
        if free - coming - _SPARE >= self._least_free:
            return None
        return (
            f"no more evidence is recorded: {format_size(free)} free, the score keeps "
            f"{format_size(self._least_free)} for itself; make room by `madrob tidy`"
        )


def stuck_words(unsynced: float, queued: int) -> str:
    """That the disk takes nothing, `unsynced` s; `queued` bytes wait. Empty = it takes all."""
    waits = f", {format_size(queued)} wait in memory" if queued else ""
    stuck = f"the disk has taken nothing for {unsynced:.0f} s{waits}"
    return stuck if unsynced > STUCK_AFTER else ""
