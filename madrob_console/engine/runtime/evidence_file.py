"""One file of an evidence recording, in the evidence process."""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

from madrob_console.common.clock import NS
from madrob_console.common.files import free_space
from madrob_console.common.formatting import format_size
from madrob_console.common.names import terminal_safe
from madrob_console.engine.runtime.evidence_order import RecordInto
from madrob_console.referee.evidence_account import EvidenceLoss
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.testbeds.ros.evidence_intake import TakenEvidence
from recorder.evidence import FurtherFile
from recorder.writer import BagWriter, RecorderState, RecorderStats

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
    """One file of a recording. One thread calls it, and never waits for a disk."""

    def __init__(self, order: RecordInto, queue_bytes: int, *, held: bool) -> None:
        self._number = order.number
        self._place = order.place
        self._held = held
        self._began = time.monotonic()
        self._ended: float | None = None
        self._bytes: Counter[str] = Counter()
        self._left_out: Counter[str] = Counter()
        self._too_large: Counter[str] = Counter()
        self._behind: Counter[str] = Counter()
        self._first: dict[str, float] = {}
        self._changed = threading.Condition()  # guards `_held`
        self._writer = BagWriter(
            FurtherFile(Path(order.place.folder), order.file, self._refusal),
            (),
            {},
            flush_period=SYNC_PERIOD,
            memory_bytes=queue_bytes,
        )
        self._writer.start(WRITER_NICE)

    @property
    def stats(self) -> RecorderStats:
        return self._writer.stats()

    @property
    def finished(self) -> bool:
        """Whether the file is complete, or given up."""
        return self.stats.state is not RecorderState.RECORDING

    def record(self, taken: TakenEvidence) -> None:
        """Have messages of a topic recorded; counts those that are left out or find no room."""
        name = taken.topic.name
        self._left_out[name] += taken.left_out
        self._too_large[name] += taken.too_large
        if not taken.messages:
            return
        self._first.setdefault(name, taken.messages[0].receive_ns / NS)
        self._bytes[name] += sum(len(message.data) for message in taken.messages)
        self._writer.add_topic(taken.topic)
        refused = len(taken.messages) - self._writer.put_all(taken.messages)
        if refused and self.stats.error is None:
            self._behind[name] += refused

    def hold_writing(self, *, held: bool) -> None:
        """Write nothing while scoring waits for the disk."""
        with self._changed:
            self._held = held
            self._changed.notify_all()

    def end(self) -> None:
        self._ended = time.monotonic()
        self._writer.finish()

    def close(self, deadline: float) -> None:
        """Finish the file at once, by the `deadline` (monotonic s)."""
        self.hold_writing(held=False)
        self._writer.close(max(0.0, deadline - time.monotonic()))

    def with_counts(self, state: EvidenceState) -> EvidenceState:
        """The state with this file, and with what was recorded of the topics."""
        stats, now = self.stats, time.monotonic()
        problem, recording = terminal_safe(stats.error or ""), self._ended is None
        finishing = not recording and stats.state is RecorderState.RECORDING
        ending = 0.0 if self._ended is None else now - self._ended
        slow = f"not complete on disk {ending:.0f} s after the end of the recording"
        unsynced = stats.seconds_since_sync
        if unsynced is None:
            unsynced = now - self._began
        waiting = Counter(stats.received) - Counter(stats.lost) - Counter(stats.recorded)
        return replace(
            state,
            topics=tuple(self._counted(topic, stats) for topic in state.topics),
            problem=problem or (slow if finishing and ending > SLOW_END else None),
            stuck=stuck_words(unsynced, stats.memory_bytes) if recording and not problem else "",
            number=self._number,
            recording=recording,
            finishing=finishing,
            problems=(problem,) if problem else (),
            unwritten=None if stats.state is RecorderState.FAILED else waiting.total(),
            saved=None if stats.end_ns is None else stats.end_ns / NS,
        )

    def _counted(self, topic: EvidenceTopic, stats: RecorderStats) -> EvidenceTopic:
        name, dropped = topic.topic, stats.lost.get(topic.topic, 0)
        received = stats.received.get(name, 0)
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

    def _refusal(self, size: int, coming: int) -> str | None:
        """Called by the writer's thread, which waits here while scoring needs the disk."""
        with self._changed:
            self._changed.wait_for(lambda: not self._held)
        if size > self._place.most_bytes:
            return "the budget is used up: raise `recording.budget`"
        free, least = free_space(Path(self._place.folder)) or 0, self._place.least_free
        if free - coming - _SPARE >= least:
            return None
        return (
            f"no more evidence is recorded: {format_size(free)} free, the score keeps "
            f"{format_size(least)} for itself; make room"
        )


def stuck_words(unsynced: float, queued: int) -> str:
    """Warns that the disk has refused data for `unsynced` s, `queued` bytes wait; else empty."""
    waits = f", {format_size(queued)} wait in memory" if queued else ""
    stuck = f"the disk has taken nothing for {unsynced:.0f} s{waits}"
    return stuck if unsynced > STUCK_AFTER else ""
