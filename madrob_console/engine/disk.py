"""Threads for file operations, because a disk may hang; results return to the core thread."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, Full, Queue, SimpleQueue
from typing import Any, Generic, Protocol, Self, TypeVar

from madrob_console.common.errors import MadrobError

# Two queues, one of which goes first: between the threads of screens and engine.


T = TypeVar("T")


class Lanes(Generic[T]):
    """Put into and taken from in any thread."""

    def __init__(self) -> None:
        self._first: deque[T] = deque()
        self._others: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: T, *, first: bool) -> bool:
        """Let something wait for its turn; False where nobody will take it any more."""
        with self._changed:
            if self._closed:
                return False
            (self._first if first else self._others).append(item)
            self._changed.notify()
            return True

    def next(self) -> T | None:
        """The next one, once there is one; None where there will be none."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._first or self._others)
            return self._taken()

    def waiting(self) -> Iterator[T]:
        """Those that wait now; before each one, those that go first and have come meanwhile."""
        with self._changed:
            others = len(self._others)
        while True:
            with self._changed:
                others -= not self._first
                item = self._taken() if others >= 0 else None
            if item is None:
                return
            yield item

    def count(self, *, first: bool) -> int:
        """How many wait in one of the two."""
        return len(self._first if first else self._others)

    def close(self) -> list[T]:
        """Take no more; returns those that were left."""
        with self._changed:
            self._closed = True
            left = [*self._first, *self._others]
            self._first.clear()
            self._others.clear()
            self._changed.notify_all()
        return left

    def _taken(self) -> T | None:
        queue = self._first or self._others
        return queue.popleft() if queue else None


# What only reads: beside the core, so that a slow disk holds up nothing but this.


THREADS = 2
"""For screens, beside the one of the core: a bag that is read holds up no listing."""

MOST_WAITING = 64
"""Of the core, of the screen that may act, and of all others; more are refused."""

REST, LONGEST_REST = 4.0, 0.1
"""After what others asked a thread rests so many times as long as that took, and s at most.

The engine's thread has no processor of its own.
"""

BUSY = "too much waits to be read: look at the disk, or ask again later"
ENDED = "the engine has ended"


class Reader(Protocol):
    """Reads what it is asked for, in no order that can be relied on."""

    def ask(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Have something read; never waits for it, unless it is read at once. From any thread.

        Args:
            job: reads; what it raises is its answer.
            done: told what came of it, in the thread that calls `deliver`: the core's. What the
                core asks waits for nothing that screens ask.
            first: before those that are not.

        Returns:
            The same; it can be cancelled at any time. Nothing is read if that is before its turn.
        """
        ...

    def deliver(self) -> None:
        """Tell what came of jobs since the last call."""
        ...

    @property
    def silent(self) -> float:
        """How long the disk has not answered what the core asked, s. From any thread."""
        ...

    def close(self) -> None:
        """Take no more jobs; those that wait are refused, what is being read is left to itself."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    read: Callable[[], Any]
    done: Callable[[Future[Any]], None] | None
    answer: Future[Any]
    first: bool


class ThreadReader:
    """Reads in a few threads, one of which is the core's.

    The threads are daemons: a disk that hangs must not hold up the end of the process.
    """

    def __init__(self) -> None:
        self._of_core: Lanes[_Job] = Lanes()
        self._of_screens: Lanes[_Job] = Lanes()
        self._answers: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._begun: dict[_Job, float] = {}
        for number, jobs in enumerate([self._of_core, *THREADS * [self._of_screens]]):
            work, name = partial(self._work, jobs), f"reader {number}"
            threading.Thread(target=work, name=name, daemon=True).start()

    def ask(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Have something read; what finds no room fails."""
        answer: Future[T] = Future()
        asked = _Job(job, done, answer, first)
        jobs = self._of_screens if done is None else self._of_core
        if jobs.count(first=first) >= MOST_WAITING:
            self._answer(asked, None, MadrobError(BUSY))
        elif not jobs.put(asked, first=first):
            self._answer(asked, None, MadrobError(ENDED))
        return answer

    def deliver(self) -> None:
        """Tell what came of jobs since the last call."""
        with suppress(Empty):
            while True:
                self._answers.get_nowait()()

    @property
    def silent(self) -> float:
        """How long the oldest job of the core has been under way, s."""
        began = [at for job, at in self._begun.copy().items() if job.done is not None]
        return max(0.0, time.monotonic() - min(began)) if began else 0.0

    def close(self) -> None:
        """Read nothing more."""
        for job in (*self._of_core.close(), *self._of_screens.close()):
            self._answer(job, None, MadrobError(ENDED))

    def _work(self, jobs: Lanes[_Job]) -> None:
        while (job := jobs.next()) is not None:
            if job.answer.done():
                continue
            self._begun[job] = began = time.monotonic()
            value, error = None, None
            try:
                value = job.read()
            except MadrobError as refused:
                error = refused
            except Exception as bug:  # noqa: BLE001  one bug, one answer: the thread goes on
                error = MadrobError(f"it cannot be read: {bug!r}")
            took = time.monotonic() - began
            del self._begun[job]
            self._answer(job, value, error)
            if not job.first:
                time.sleep(min(LONGEST_REST, REST * took))

    def _answer(self, job: _Job, value: object, error: MadrobError | None) -> None:
        """Say what came of a job, unless it was cancelled."""
        with suppress(InvalidStateError):
            if error is None:
                job.answer.set_result(value)
            else:
                job.answer.set_exception(error)
            if (done := job.done) is not None:
                self._answers.put(lambda: done(job.answer))


# The engine's core hands over what touches a file and goes on. Answers are given in the core's
# own thread, at its next step, so that nothing of it needs a lock.


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
