"""Looks beside the core whether the disk of the results can take the next run."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from madrob_console.archive.folders import recording_problem
from madrob_console.common.files import free_space
from madrob_console.common.plain_files import OpenFolder
from madrob_console.engine.runtime.disk import DiskJobs
from madrob_console.referee.run import Phase, Run

T = TypeVar("T")


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
        self._asked_at = -math.inf
        self._last_version: object = None
        self._awaited = False

    def look(self, now: float, version: object = None) -> T:
        """The last answer; asks again in time, or for another `version`. Never waits."""
        late = not 0 <= now - self._asked_at < self._period
        if self._awaited:
            self.value = self._unknown if late and self._forgets else self.value
        elif late or version != self._last_version:
            self._asked_at, self._last_version, self._awaited = now, version, True
            self._submit(self._job, self._heard)
        return self.value

    def _heard(self, answer: Future[T]) -> None:
        if answer.exception() is None:
            self.value = answer.result()
        elif self._forgets:
            self.value = self._unknown
        self._awaited = False


_DISK_PERIOD = 2.0


@dataclass(frozen=True, slots=True)
class _Disk:
    free: int | None
    problem: str | None


_UNKNOWN = _Disk(None, None)


class DiskWatch:
    """Looks whether the disk can take the next run; `disk` is the one whose silence counts."""

    def __init__(self, results: Path, disk: DiskJobs) -> None:
        self._path = results
        self._starts_next = self._practice = False
        self._results: OpenFolder | None = None
        self._disk = RepeatedReading(
            self._look_at_disk, disk.submit_job, _DISK_PERIOD, _UNKNOWN, forgets=True
        )

    def look(self, run: Run, now: float) -> _Disk:
        """Bytes free for results, and why no recording can begin; None = no answer comes."""
        self._starts_next = run.phase is Phase.READY
        self._practice = run.setup is not None and run.setup.practice
        return self._disk.look(now, (self._starts_next, self._practice))

    @property
    def last(self) -> _Disk:
        return self._disk.value

    def _look_at_disk(self) -> _Disk:
        """In the thread of the disk: it may hang."""
        results = self._path
        problem = recording_problem(results, attempt=self._starts_next, practice=self._practice)
        return _Disk(free_space(results), problem or self._moved() or "")

    def _moved(self) -> str | None:
        """Whether the results folder is another one than before: it has other run numbers."""
        if self._results is not None and self._results.is_deleted:
            self._results = None
        if self._results is None:
            with suppress(OSError):  # there is none yet
                self._results = OpenFolder(self._path.resolve())
                weakref.finalize(self, self._results.close)
        if self._results is None:
            return None
        with suppress(OSError):  # else its words say why
            self._results.open_again()
        return self._results.problem()
