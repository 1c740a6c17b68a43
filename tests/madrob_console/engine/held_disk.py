"""A disk that answers when a test lets it, without a thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from madrob_console.engine.runtime.disk import DiskJobs, DiskThreads

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
