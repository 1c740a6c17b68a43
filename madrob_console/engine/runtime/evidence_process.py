"""Has topics recorded beside a run in a process of its own, which can cost the run nothing."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from madrob_console.engine.ipc.wire import decoded
from madrob_console.engine.runtime.evidence_worker import EvidenceOrder
from madrob_console.engine.runtime.supervisor import Worker
from madrob_console.referee.evidence import Evidence

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.runtime.evidence_worker")

FIRST_REPORT = 20.0
"""Time of a new process until its first report, s."""

_PERIOD = 0.25
_reports: msgspec.msgpack.Decoder[Evidence] = msgspec.msgpack.Decoder(Evidence)


@dataclass(eq=False)
class _Recording:
    """What is recorded beside one run; None of it is shared with the next.

    Attributes:
        is_ending: whether its bag is to be finished; `is_told`: its process knows that.
        earlier: what lost processes had recorded.
        evidence: what all of them have recorded.
    """

    order: EvidenceOrder
    is_ending: bool = False
    is_told: bool = False
    has_ended: threading.Event = field(default_factory=threading.Event)
    earlier: Evidence = field(default_factory=Evidence)
    evidence: Evidence = field(default_factory=Evidence)


class EvidenceProcess(Worker):
    """Records the topics of the settings from the opening of a recording to its end.

    A process that dies or hangs is started again, and records into a new bag.

    Args:
        least_free: bytes that stay free on the disk, for the run.
    """

    patience = 4.0
    longest = 30.0
    loss = "the recorder of the evidence is started again"

    def __init__(
        self, domain: int, topics: Sequence[str], least_free: int, command: Sequence[str] = COMMAND
    ) -> None:
        super().__init__(command)
        self._domain = domain
        self._topics = tuple(topics)
        self._least_free = least_free
        self._recording: _Recording | None = None
        self._served: _Recording | None = None  # by the process that runs
        self._heard = 0.0

    # The engine's thread.

    @property
    def evidence(self) -> Evidence:
        """What was recorded beside the current or last run."""
        return Evidence() if self._recording is None else self._recording.evidence

    def begin_recording(self, folder: Path, steady_ns: int) -> None:
        """Record beside the run in a folder; `steady_ns` is the engine's steady time of now."""
        self._recording = _Recording(
            EvidenceOrder(
                self._domain,
                self._topics,
                str(folder.absolute()),
                steady_ns,
                time.monotonic_ns(),
                self._least_free,
            )
        )
        self.ring()

    def end_recording(self) -> None:
        """Have the bag finished."""
        if self._recording is not None:
            self._recording.is_ending = True
        self.ring()

    def wait_until_ended(self, limit: float) -> None:
        """Wait until the bag is finished, `limit` s at most."""
        if self._recording is not None:
            self._recording.has_ended.wait(limit)

    # The supervisor's thread.

    @property
    def wanted(self) -> bool:
        recording = self._recording
        if recording is None or recording.has_ended.is_set():
            return False
        return self.pid is None or self._served is recording

    @property
    def goes_on(self) -> bool:
        return True  # it finishes its bag

    def begin(self) -> None:
        assert self._recording is not None
        self._served = self._recording
        self._heard = time.monotonic() + FIRST_REPORT - self.patience
        self.send(self._served.order)

    def work(self, now: float) -> float:
        recording = self._recording
        if recording is not None and recording.is_ending:
            if self.pid is None:
                recording.has_ended.set()
            elif not recording.is_told:
                recording.is_told = True
                self.send_parts([b"\0"])  # anything ends it
        return _PERIOD

    def take(self, data: memoryview) -> None:
        assert self._served is not None
        report = decoded(_reports, data, "a report of the evidence process")
        self._heard = time.monotonic()
        self._served.evidence = report.added_to(self._served.earlier)

    def lose(self, why: str) -> None:
        recording = self._served or self._recording
        self._served = None
        if recording is None:
            return
        if recording.is_ending:
            recording.has_ended.set()
            return
        recording.earlier = replace(recording.evidence, problem="")
        recording.evidence = replace(recording.evidence, problem=f"{self.loss}: {why}")

    def due(self) -> float:
        return self._heard
