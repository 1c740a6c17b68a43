"""A disk and a scorer that answer when a test lets them, without a thread, and a run on them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.acting import DURABLE_WITHIN
from madrob_console.engine.core.scored_run import RenderedResult, ScoringRequest
from madrob_console.engine.runtime.disk import DiskJobs, DiskThreads
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.referee.acts import Act
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import rebuild
from madrob_console.referee.run import Run
from madrob_console.testbeds.announcement import Announcement
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.engine.drive import STEP, FaultyDrive, FaultySource

T = TypeVar("T")


class HeldDisk(DiskJobs):
    """A disk whose jobs wait while it is held; what came of them is told at a step.

    Attributes:
        held: whether it is silent.
        now: its clock, s.
    """

    def __init__(self) -> None:
        self.held = False
        self.now = 1000.0
        self._jobs: deque[tuple[float, Callable[[], None]]] = deque()
        self._answers: deque[Callable[[], None]] = deque()
        self._busy = False

    def threads(self) -> DiskThreads:
        """As the engine takes it: the disk of its own files is this one."""
        return DiskThreads(self, DiskJobs(), monotonic=lambda: self.now)

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        answer: Future[T] = Future()

        def work() -> None:
            if not answer.set_running_or_notify_cancel():
                return
            try:
                answer.set_result(job())
            except Exception as error:  # noqa: BLE001
                answer.set_exception(error)
            if done is not None:
                self._answers.append(lambda: done(answer))

        self._jobs.append((self.now, work))
        self._go_on()
        return answer

    def _go_on(self) -> None:
        while self._jobs and not self.held and not self._busy:
            self._busy = True
            self._jobs.popleft()[1]()
            self._busy = False

    def come_back(self) -> None:
        """It answers again."""
        self.held = False
        self._go_on()

    def answer_one(self) -> None:
        """The oldest job is done, though it is held."""
        self._jobs.popleft()[1]()

    def deliver(self) -> None:
        while self._answers:
            self._answers.popleft()()

    def wait_until_idle(self, limit: float) -> bool:
        self._go_on()
        while self._answers:
            self.deliver()
            self._go_on()
        return not self._jobs

    @property
    def silent(self) -> float:
        return self.now - self._jobs[0][0] if self._jobs else 0.0

    def close(self, limit: float) -> None:
        self.wait_until_idle(limit)


class HeldScorer(Scorer):
    """A scorer that says nothing while it is held."""

    def __init__(self) -> None:
        super().__init__()
        self.held = False
        self._wanted: tuple[ScoringRequest, Callable[[RenderedResult], None]] | None = None

    def score(self, wanted: ScoringRequest, done: Callable[[RenderedResult], None]) -> None:
        self._wanted = wanted, done

    def forget(self) -> None:
        self._wanted = None

    def deliver(self) -> None:
        if not self.held and self._wanted is not None:
            wanted, self._wanted = self._wanted, None
            super().score(*wanted)

    def wait_until_idle(self, limit: float) -> bool:
        self.deliver()
        return self._wanted is None


class HeldSource(FaultySource):
    """A testbed that says of itself that it is simulated."""

    kind = SourceKind.SIMULATED
    announcement = Announcement(str(Scenario.NO_TOUCH))


class HeldDrive(FaultyDrive):
    """A referee, a robot that does nothing, and a disk that can be held.

    Attributes:
        told: the answers to what was submitted.
    """

    SOURCE = HeldSource

    def __init__(self, results: Path, scorer: Scorer | None = None) -> None:
        self.disk = HeldDisk()
        self.told: list[str | None] = []
        super().__init__(results, Scenario.NO_TOUCH, disk=self.disk.threads(), scorer=scorer)

    def submit(self, act: Act, name: str = "") -> None:
        self.engine.submit(act, self.told.append, id=name)

    def pass_time(self, duration: float) -> None:
        """Steps of the engine, with the machine's clock beside its own."""
        end = self.engine.now() + duration
        while (before := self.engine.now()) < end:
            self.engine.step(STEP)
            self.disk.now += self.engine.now() - before

    def too_long(self) -> None:
        self.pass_time(DURABLE_WITHIN + 2 * STEP)

    @property
    def phases(self) -> tuple[str, ...]:
        """What robot and testbed are told of the phase."""
        return tuple(state["phase"] for state in self.published(REFEREE_STATE_TOPIC))

    def lines(self) -> list[Entry]:
        return list(read_journal(self.folder / JOURNAL_FILE)[0])

    def told_by_journal(self) -> Run:
        run = self.engine.run
        return rebuild(self.lines(), run.handle_zero, run.zero_samples)
