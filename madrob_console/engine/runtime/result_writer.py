"""Writes results; what the disk refuses stays in memory and is retried until it is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.issuing import issue
from madrob_console.archive.journal_agreement import Details
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import OpenFolder, naming_folder
from madrob_console.engine.core.scored_run import RenderedResult
from madrob_console.engine.runtime.disk import DiskJobs, why_not
from madrob_console.referee.journal import Entry, up_to_date


@dataclass(frozen=True, slots=True, eq=False)
class UnwrittenRun:
    """A run whose result or journal is not on disk, and why."""

    folder: OpenFolder
    scored: RenderedResult
    entries: Sequence[Entry]
    problem: str

    @property
    def words(self) -> str:
        setup = self.scored.record.setup
        return f"run {setup.run_number} of subject {setup.subject}: {self.problem}"

    def write(self, now: float) -> None:
        """Write the missing journal lines, then the result, and close the folder.

        `now` is in s since the epoch.

        Raises:
            MadrobError: the disk refuses; what is written already may be written again.
        """
        folder = self.folder
        try:
            folder.restore()
            with naming_folder(folder.path, folder.inside):
                journal = up_to_date(folder.inside / JOURNAL_FILE, self.entries)
        except OSError as error:
            path = folder.path / JOURNAL_FILE
            raise MadrobError(f"{path}: cannot be written ({error.strerror})") from None
        try:
            issue(self.folder, self.scored.files, self.entries, journal, now=now, in_console=True)
        finally:
            journal.close()
        folder.close()


class ResultWriter:
    """Writes the results of one run after the other, and retries those of runs that were left.

    No run starts without room on the disk, so few results wait.

    Attributes:
        make_reports: called with the folder of each run whose result is on disk.
    """

    def __init__(self, disk: DiskJobs) -> None:
        self.make_reports: Callable[[Path], None] = lambda _folder: None
        self._disk = disk
        self._unwritten: dict[Path, UnwrittenRun] = {}
        self._trying = 0

    def __contains__(self, folder: Path) -> bool:
        """Whether the result of an earlier run waits for the disk."""
        return folder in self._unwritten

    @property
    def is_writing(self) -> bool:
        return self._trying > 0

    @property
    def waiting(self) -> tuple[str, ...]:
        """Earlier runs that are not on disk and why, in words. From any thread."""
        return tuple(run.words for run in tuple(self._unwritten.values()))

    def write(
        self,
        folder: OpenFolder,
        scored: RenderedResult,
        entries: Sequence[Entry],
        done: Callable[[Details, str | None], None],
    ) -> None:
        """Issue a result; `done` gets the details of its journal line, or why not, in words."""

        def answered(answer: Future[Details]) -> None:
            self._trying -= 1
            problem = why_not(answer)
            done({} if problem else answer.result(), problem)

        self._trying += 1
        write = partial(issue, folder, scored.files, entries, in_console=True)
        self._disk.submit_job(write, answered)

    def keep(self, run: UnwrittenRun) -> None:
        """Write a run again that is left with something not on disk."""
        self._unwritten[run.folder.path] = run

    def retry(self, now: float) -> None:
        """Write earlier runs that wait; `now` is in s since the epoch."""
        for run in () if self._trying else tuple(self._unwritten.values()):
            self._trying += 1
            self._disk.submit_job(partial(run.write, now), partial(self._take_answer, run))

    def _take_answer(self, run: UnwrittenRun, answer: Future[None]) -> None:
        self._trying -= 1
        if (why := why_not(answer)) is not None:
            problem = f"the result is NOT on disk: {why}"
            self._unwritten[run.folder.path] = replace(run, problem=problem)
        else:
            del self._unwritten[run.folder.path]
            self.make_reports(run.folder.path)
