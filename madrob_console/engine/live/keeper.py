"""Who waits for the disk: jobs that may hang, done elsewhere, whose answers come back to the core.

The engine's core hands over what touches a file and goes on. Answers are given in the core's own
thread, at its next step, so that nothing of it needs a lock.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, Full, Queue, SimpleQueue
from typing import Protocol, Self, TypeVar

from madrob_console.engine.live.reading import ENDED, Reader, ThreadReader
from madrob_console.errors import MadrobError

T = TypeVar("T")
"""Of what a job gives."""

MOST_JOBS = 200
"""That wait for their turn: a disk that hangs must not fill the memory."""

FULL = "too much waits for the disk: try again when it answers"

_Work = Callable[[], None]


class Keeper(Protocol):
    """Does one job after the other, in the order in which they were asked for."""

    def ask(
        self, job: Callable[[], T], done: Callable[[Future[T]], None] | None = None
    ) -> Future[T]:
        """Have a job done; never waits for it, unless it is done at once. From any thread.

        Args:
            job: touches files; what it raises is its answer.
            done: told what came of it, in the thread that calls `deliver`; not of a job that was
                cancelled before its turn.

        Returns:
            The same; who cancels it before its turn has it never done.
        """
        ...

    def deliver(self) -> None:
        """Tell what came of jobs since the last call."""
        ...

    def settle(self, limit: float) -> bool:
        """Wait until no job is left, those that answers ask for included; deliver meanwhile.

        Args:
            limit: of the waiting, s.

        Returns:
            Whether none is left.
        """
        ...

    @property
    def silent(self) -> float:
        """How long the job under way has been so, s; 0 while there is none. From any thread."""
        ...

    def close(self, limit: float) -> None:
        """Take no more jobs; those that are left are waited for, `limit` s at most."""
        ...


class InlineKeeper:
    """Does each job at once: for virtual time and replays, where nobody minds the waiting.

    It is a `Keeper` and a `Reader`.
    """

    silent = 0.0

    def ask(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Do it; `done` is told before this returns. Nothing waits, that others go first."""
        answer: Future[T] = Future()
        _carry_out(job, answer)
        if done is not None:
            done(answer)
        return answer

    def deliver(self) -> None:
        """Nothing is left to be told."""

    def settle(self, limit: float) -> bool:
        """Nothing is left to be done."""
        return True

    def close(self, limit: float = 0.0) -> None:
        """Nothing is left to be done."""


class ThreadKeeper:
    """Does jobs in a thread of its own, which no job ends.

    Args:
        name: of the thread.
        most_jobs: that may wait; more are refused.
        monotonic: a clock, s.
    """

    def __init__(
        self,
        name: str,
        most_jobs: int = MOST_JOBS,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monotonic = monotonic
        self._jobs: Queue[_Work | None] = Queue(most_jobs)
        self._answers: SimpleQueue[_Work] = SimpleQueue()
        self._began: float | None = None
        self._closed = False
        # A daemon: a program that ends must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def ask(
        self, job: Callable[[], T], done: Callable[[Future[T]], None] | None = None
    ) -> Future[T]:
        """Have a job done; one that finds no room fails."""
        answer: Future[T] = Future()

        def tell() -> None:
            if done is not None:
                self._answers.put(lambda: done(answer))

        def work() -> None:
            if answer.set_running_or_notify_cancel():
                _finish(job, answer)
                tell()

        refused = ENDED if self._closed else None
        if refused is None:
            try:
                self._jobs.put_nowait(work)
            except Full:
                refused = FULL
        if refused is not None:
            answer.set_exception(MadrobError(refused))
            tell()
        return answer

    def _work(self) -> None:
        while (work := self._jobs.get()) is not None:
            self._began = self._monotonic()
            work()
            self._began = None
            self._jobs.task_done()
        self._jobs.task_done()

    def deliver(self) -> None:
        """Tell what came of jobs since the last call."""
        with suppress(Empty):
            while True:
                self._answers.get_nowait()()

    def settle(self, limit: float) -> bool:
        """Wait until no job is left, and tell what came of each."""
        end = self._monotonic() + limit
        while True:
            with self._jobs.all_tasks_done:
                while self._jobs.unfinished_tasks and (rest := end - self._monotonic()) > 0:
                    self._jobs.all_tasks_done.wait(rest)
                left = self._jobs.unfinished_tasks
            self.deliver()
            if left or not self._jobs.unfinished_tasks:
                return not left

    @property
    def silent(self) -> float:
        """How long the job under way has been so, s."""
        began = self._began
        return 0.0 if began is None else max(0.0, self._monotonic() - began)

    def close(self, limit: float) -> None:
        """Take no more jobs; a job that hangs is left to itself."""
        end = self._monotonic() + limit
        self._closed = True
        with suppress(Full):
            self._jobs.put(None, timeout=max(0.0, limit))
        self._thread.join(max(0.0, end - self._monotonic()))
        self.deliver()


@dataclass(frozen=True, slots=True)
class Keepers:
    """Who waits for the disk: what is slow to read delays no line of the journal.

    Attributes:
        own: keeps the files that belong to the run at hand.
        reading: looks at what is only read.
        monotonic: a clock of the machine's, s.
    """

    own: Keeper
    reading: Reader
    monotonic: Callable[[], float] = time.monotonic

    @classmethod
    def inline(cls) -> Self:
        """Both do everything at once."""
        return cls(InlineKeeper(), InlineKeeper())

    @classmethod
    def threads(cls) -> Self:
        """In threads of their own, which `close` ends."""
        return cls(ThreadKeeper("keeper"), ThreadReader())

    def deliver(self) -> None:
        """Tell what came of jobs of both."""
        self.own.deliver()
        self.reading.deliver()

    def close(self, limit: float) -> None:
        """End both; the run's own files are waited for, `limit` s at most."""
        self.reading.close()
        self.own.close(limit)


def why_not(answer: Future[T]) -> str | None:
    """Why a job that is over failed, in words; None when it did not."""
    error = answer.exception()
    if error is None or isinstance(error, MadrobError):
        return None if error is None else str(error)
    return f"{type(error).__name__}: {error}"


def _carry_out(job: Callable[[], T], answer: Future[T]) -> None:
    answer.set_running_or_notify_cancel()
    _finish(job, answer)


def _finish(job: Callable[[], T], answer: Future[T]) -> None:
    try:
        answer.set_result(job())
    except BaseException as error:  # noqa: BLE001 - whatever it is, it is what came of the job
        answer.set_exception(error)
