"""Threads for file operations, because a disk may hang; results return to the core thread.

The engine's core hands over what touches a file and goes on. Answers are given in the core's own
thread, at its next step, so that nothing of it needs a lock.
"""

from __future__ import annotations

import math
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

# A queue with two lanes, between the threads of screens and engine.


T = TypeVar("T")


class PriorityQueue(Generic[T]):
    """A queue with two priorities, for any thread."""

    def __init__(self) -> None:
        self._first: deque[T] = deque()
        self._others: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put_item(self, item: T, *, first: bool) -> bool:
        with self._changed:
            if self._closed:
                return False
            (self._first if first else self._others).append(item)
            self._changed.notify()
            return True

    def next(self) -> T | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._first or self._others)
            return self._taken()

    def waiting(self) -> Iterator[T]:
        """The items that wait now; before each one, those with priority that came meanwhile."""
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
        return len(self._first if first else self._others)

    def close(self) -> list[T]:
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


# Reading in threads beside the core, so that a slow disk holds up only readers.


THREADS = 2
"""For screens, beside the core's own: reading a bag holds up no listing."""

MOST_WAITING = 64
"""Separately for the core, the screen that may act, and all others; more are refused."""

REST, LONGEST_REST = 4.0, 0.1
"""After a job of others a thread rests this many times its duration, at most so many s:
the engine's thread has no processor of its own.
"""

BUSY = "too much waits to be read: look at the disk, or ask again later"
ENDED = "the engine has ended"


class Reader(Protocol):
    """Reads files, in no particular order."""

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Have something read; never waits for it, unless it is read at once. From any thread.

        The answer holds the job's value or error; cancelled before its turn, the job never
        runs. `done` gets the answer in the thread that calls `deliver`, the core's. Jobs of the
        core wait for none of the screens'. `first` jobs go before the others.
        """
        ...

    def deliver(self) -> None: ...

    @property
    def silent(self) -> float:
        """How long the disk has not answered the core, s. From any thread."""
        ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    read: Callable[[], Any]
    done: Callable[[Future[Any]], None] | None
    answer: Future[Any]
    first: bool


class ReaderPool:
    """Reads in a few threads, one of which is the core's.

    The threads are daemons: a disk that hangs must not hold up the end of the process.
    """

    def __init__(self) -> None:
        self._of_core: PriorityQueue[_Job] = PriorityQueue()
        self._of_screens: PriorityQueue[_Job] = PriorityQueue()
        self._answers: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._begun: dict[_Job, float] = {}
        for number, jobs in enumerate([self._of_core, *THREADS * [self._of_screens]]):
            work, name = partial(self._work, jobs), f"reader {number}"
            threading.Thread(target=work, name=name, daemon=True).start()

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        answer: Future[T] = Future()
        asked = _Job(job, done, answer, first)
        jobs = self._of_screens if done is None else self._of_core
        if jobs.count(first=first) >= MOST_WAITING:
            self._answer(asked, None, MadrobError(BUSY))
        elif not jobs.put_item(asked, first=first):
            self._answer(asked, None, MadrobError(ENDED))
        return answer

    def deliver(self) -> None:
        with suppress(Empty):
            while True:
                self._answers.get_nowait()()

    @property
    def silent(self) -> float:
        began = [at for job, at in self._begun.copy().items() if job.done is not None]
        return max(0.0, time.monotonic() - min(began)) if began else 0.0

    def close(self) -> None:
        for job in (*self._of_core.close(), *self._of_screens.close()):
            self._answer(job, None, MadrobError(ENDED))

    def _work(self, jobs: PriorityQueue[_Job]) -> None:
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
        with suppress(InvalidStateError):
            if error is None:
                job.answer.set_result(value)
            else:
                job.answer.set_exception(error)
            if (done := job.done) is not None:
                self._answers.put(lambda: done(job.answer))


MOST_JOBS = 200
"""Most jobs that wait: a disk that hangs must not fill the memory."""

FULL = "too much waits for the disk: try again when it answers"

_Work = Callable[[], None]


class DiskJobs(Protocol):
    """Does jobs one after the other, in the order of the requests."""

    def submit_job(
        self, job: Callable[[], T], done: Callable[[Future[T]], None] | None = None
    ) -> Future[T]:
        """Have a job done; never waits for it, unless it is done at once. From any thread.

        The answer holds the job's value or error; cancelled before its turn, the job never
        runs. `done` gets the answer in the thread that calls `deliver`, but not that of a
        cancelled job.
        """
        ...

    def deliver(self) -> None: ...

    def wait_until_idle(self, limit: float) -> bool:
        """Wait `limit` s at most until no job is left, and deliver; returns whether none is."""
        ...

    @property
    def silent(self) -> float:
        """How long the current job has been running, s; 0 without one. From any thread."""
        ...

    def close(self, limit: float) -> None:
        """Take no more jobs; wait for the rest, `limit` s at most."""
        ...


class InlineDisk:
    """Does each job at once, for virtual time and replays; a `DiskJobs` and a `Reader`."""

    silent = 0.0

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        answer: Future[T] = Future()
        _carry_out(job, answer)
        if done is not None:
            done(answer)
        return answer

    def deliver(self) -> None:
        """Nothing is left to be told."""

    def wait_until_idle(self, limit: float) -> bool:
        return True

    def close(self, limit: float = 0.0) -> None:
        """Nothing is left to be done."""


class DiskThread:
    """Does jobs in a thread of its own, which no failing job ends."""

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

    def submit_job(
        self, job: Callable[[], T], done: Callable[[Future[T]], None] | None = None
    ) -> Future[T]:
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
        with suppress(Empty):
            while True:
                self._answers.get_nowait()()

    def wait_until_idle(self, limit: float) -> bool:
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
class DiskThreads:
    """Threads for files: a slow reading delays no line of the journal.

    `own` does the files of the current run, `reading` what is only read.
    """

    own: DiskJobs
    reading: Reader
    monotonic: Callable[[], float] = time.monotonic

    @classmethod
    def inline(cls) -> Self:
        return cls(InlineDisk(), InlineDisk())

    @classmethod
    def threads(cls) -> Self:
        return cls(DiskThread("keeper"), ReaderPool())

    def deliver(self) -> None:
        self.own.deliver()
        self.reading.deliver()

    def close(self, limit: float) -> None:
        """End both; wait for the run's own files, `limit` s at most."""
        self.reading.close()
        self.own.close(limit)


class RepeatedReading(Generic[T]):
    """What is read every `period` s beside the core, or after a change; until then the last answer.

    `submit` hands the job to a reader. Nothing is asked while an answer is awaited. What `forgets`
    is `unknown` again when an answer fails, or takes longer than the period.
    """

    def __init__(
        self,
        job: Callable[[], T],
        submit: Callable[[Callable[[], T], Callable[[Future[T]], None]], object],
        period: float,
        unknown: T,
        *,
        forgets: bool = False,
    ) -> None:
        self.value = unknown
        self._job = job
        self._submit = submit
        self._period = period
        self._unknown = unknown
        self._forgets = forgets
        self._asked = -math.inf
        self._seen: object = None
        self._awaited = False

    def look(self, now: float, seen: object = None) -> T:
        """The last answer; asks for another one in time, or when `seen` differs. Never waits."""
        late = not 0 <= now - self._asked < self._period
        if self._awaited:
            self.value = self._unknown if late and self._forgets else self.value
        elif late or seen != self._seen:
            self._asked, self._seen, self._awaited = now, seen, True
            self._submit(self._job, self._heard)
        return self.value

    def _heard(self, answer: Future[T]) -> None:
        if answer.exception() is None:
            self.value = answer.result()
        elif self._forgets:
            self.value = self._unknown
        self._awaited = False


def why_not(answer: Future[T]) -> str | None:
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
