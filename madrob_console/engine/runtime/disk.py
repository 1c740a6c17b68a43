"""Threads for file operations, because a disk may hang; results return to the core thread.

The engine's core hands over what touches a file and goes on. Answers are given in the core's own
thread, at its next step, so that nothing of it needs a lock.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, Self, TypeVar

from madrob_console.common.errors import MadrobError
from madrob_console.engine.priority_queue import PriorityQueue

T = TypeVar("T")

MOST_JOBS = 200
"""Most jobs that wait in each lane: a disk that hangs must not fill the memory."""

FULL = "too much waits for the disk: try again when it answers"
ENDED = "the engine has ended"


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    work: Callable[[], Any]
    done: Callable[[Future[Any]], None] | None
    answer: Future[Any]

    def carry_out(self) -> None:
        """Unless it was cancelled before. Any error is an answer: none ends the thread."""
        if not self.answer.set_running_or_notify_cancel():
            return
        try:
            self.answer.set_result(self.work())
        except MadrobError as refused:
            self.answer.set_exception(refused)
        except Exception as bug:  # noqa: BLE001  one bug, one answer
            error = MadrobError(f"{type(bug).__name__}: {bug}")
            error.__cause__ = bug
            self.answer.set_exception(error)

    def refuse(self, why: str) -> None:
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_exception(MadrobError(why))

    def tell(self) -> None:
        if self.done is not None and not self.answer.cancelled():
            self.done(self.answer)


class DiskJobs:
    """Does jobs one after the other: this one at once, for virtual time and replays."""

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Have a job done; never waits for it, unless it is done at once. From any thread.

        The answer holds the job's value, or a `MadrobError`; cancelled before its turn, the job
        never runs. `done` gets the answer in the thread that calls `deliver`, but not that of a
        cancelled job. `first` jobs go before the others.
        """
        submitted = _Job(job, done, Future())
        submitted.carry_out()
        submitted.tell()
        return submitted.answer

    def deliver(self) -> None:
        """Tell the answers that came since."""

    def wait_until_idle(self, limit: float) -> bool:
        """Wait `limit` s at most until no job is left, and deliver; returns whether none is."""
        return True

    @property
    def silent(self) -> float:
        """How long the current job has been running, s; 0 without one. From any thread."""
        return 0.0

    def close(self, limit: float) -> None:
        """Wait for the jobs, `limit` s at most; those that have not begun then never do."""


class DiskThread(DiskJobs):
    """Does jobs in a thread of its own."""

    def __init__(
        self,
        name: str,
        most_jobs: int = MOST_JOBS,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._most_jobs = most_jobs
        self._monotonic = monotonic
        self._jobs: PriorityQueue[_Job] = PriorityQueue()
        self._answered: SimpleQueue[_Job] = SimpleQueue()
        self._left: set[Future[Any]] = set()  # of jobs that are not done, or not told
        self._began: float | None = None
        # A daemon: a program that ends must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        submitted = _Job(job, done, Future())
        self._left.add(submitted.answer)
        if self._jobs.count(first=first) >= self._most_jobs:
            self._refuse(submitted, FULL)
        elif not self._jobs.put_item(submitted, first=first):
            self._refuse(submitted, ENDED)
        return submitted.answer

    def _refuse(self, job: _Job, why: str) -> None:
        job.refuse(why)
        self._answered.put(job)

    def _work(self) -> None:
        while (job := self._jobs.next()) is not None:
            self._began = self._monotonic()
            job.carry_out()
            self._began = None
            self._answered.put(job)

    def deliver(self) -> None:
        with suppress(Empty):
            while True:
                job = self._answered.get_nowait()
                self._left.discard(job.answer)
                job.tell()

    def wait_until_idle(self, limit: float) -> bool:
        end = self._monotonic() + limit
        while True:
            waiting = wait(self._left.copy(), max(0.0, end - self._monotonic())).not_done
            self.deliver()
            if waiting or not self._left:
                return not waiting

    @property
    def silent(self) -> float:
        began = self._began
        return 0.0 if began is None else max(0.0, self._monotonic() - began)

    def close(self, limit: float) -> None:
        """A job that hangs is left to itself."""
        end = self._monotonic() + limit
        self.wait_until_idle(limit)
        for job in self._jobs.close():
            self._refuse(job, ENDED)
        self._thread.join(max(0.0, end - self._monotonic()))


@dataclass(frozen=True, slots=True)
class DiskThreads:
    """Two threads for files: looking through many runs delays no line of the journal.

    `own` does the files of the current run and looks whether its disk is ready; its silence is
    the disk's. `reading` looks through other runs, and reads for screens.
    """

    own: DiskJobs
    reading: DiskJobs
    monotonic: Callable[[], float] = time.monotonic

    @classmethod
    def inline(cls) -> Self:
        return cls(DiskJobs(), DiskJobs())

    @classmethod
    def threads(cls) -> Self:
        return cls(DiskThread("disk"), DiskThread("reading"))

    def deliver(self) -> None:
        self.own.deliver()
        self.reading.deliver()

    def close(self, limit: float) -> None:
        """End both; wait for the run's own files, `limit` s at most."""
        self.reading.close(0.0)
        self.own.close(limit)


def why_not(answer: Future[T]) -> str | None:
    error = answer.exception()
    return None if error is None else str(error)
