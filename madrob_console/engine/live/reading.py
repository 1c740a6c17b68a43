"""What only reads: beside the core, so that a slow disk holds up nothing but this."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

from madrob_console.engine.live.lanes import Lanes
from madrob_console.errors import MadrobError

T = TypeVar("T")
"""Of what a job gives."""

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
