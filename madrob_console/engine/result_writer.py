"""Requests, writes and shows the current run's result; what the disk refuses is retried."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.issuing import issue
from madrob_console.archive.run_journal import Details
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import OpenFolder, naming_folder
from madrob_console.engine.disk import DiskThreads, why_not
from madrob_console.engine.run_recorder import EventPublisher
from madrob_console.engine.scorer import RenderedResult, Scorer, ToScore
from madrob_console.referee.flags import NO_INDICATORS
from madrob_console.referee.journal import Entry, up_to_date
from scoring.indicator_table import IndicatorName
from scoring.result import Indicator

# Writing results. What the disk refuses stays in memory and is retried until it is written.


RETRY_PERIOD = 1.5
"""Pause between two tries, and between two looks at the run's folder, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Unwritten:
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


NOTICEABLE = 0.3
"""An outdated result stays on screen this long while the next one is made, s."""


class CurrentResult:
    """Has the results of one run after the other made and written; shows each once on disk.

    What the disk refuses is made and written again, also when its run was left: no run starts
    without room on the disk, so few results wait. `written` is called for each result of the
    current run that is on disk, `tell` for those of earlier runs, too.

    Attributes:
        scored: the current run's result, once it can be shown.
        problem: why that is not on disk, in words.
    """

    def __init__(
        self,
        scorer: Scorer,
        keepers: DiskThreads,
        event_publisher: EventPublisher,
        *,
        again: Callable[[], None],
        written: Callable[[Details], None],
        shown: Callable[[RenderedResult], None],
        tell: Callable[[Path], None],
    ) -> None:
        self.scored: RenderedResult | None = None
        self.problem: str | None = None
        self._scorer = scorer
        self._keepers = keepers
        self._journal = event_publisher.journal
        self._again = again
        self._written = written
        self._shown = shown
        self._tell = tell
        self._folder: Path | None = None
        self._unwritten: dict[Path, Unwritten] = {}
        self._tried = -math.inf
        self._trying = 0
        self._awaited: ToScore | None = None
        self._awaited_since = 0.0

    def __contains__(self, folder: Path) -> bool:
        """Whether the result of an earlier run waits for the disk."""
        return folder in self._unwritten

    @property
    def indicators(self) -> Mapping[IndicatorName, Indicator]:
        return NO_INDICATORS if self.scored is None else self.scored.result.indicators

    @property
    def wanted(self) -> bool:
        """Whether there is a result, or one is being made."""
        return self.scored is not None or self._awaited is not None

    @property
    def missing(self) -> bool:
        """Whether the first result is being made."""
        return self.scored is None and self._awaited is not None

    @property
    def settled(self) -> bool:
        return self.scored is not None and self._awaited is None

    @property
    def outdated(self) -> bool:
        """Whether a newer result is wanted and takes a while."""
        waits = self._awaited is not None
        return waits and self._keepers.monotonic() - self._awaited_since > NOTICEABLE

    @property
    def hopeless(self) -> bool:
        return self._scorer.hopeless

    @property
    def writing(self) -> bool:
        return self._trying > 0

    @property
    def waiting(self) -> tuple[str, ...]:
        """Earlier runs that are not on disk and why, in words. From any thread."""
        return tuple(run.words for run in tuple(self._unwritten.values()))

    def request_result(self, wanted: ToScore) -> None:
        """Request the result of the current run; replaces an earlier request.

        With files the result goes to disk, and is shown once it is there or the disk has refused.
        """
        if self._awaited is None:
            self._awaited_since = self._keepers.monotonic()
        wanted = replace(wanted, run=replace(wanted.run, journal=self._journal.mark))
        self._awaited = wanted

        def done(scored: RenderedResult) -> None:
            if wanted is not self._awaited:
                return
            if wanted.files:
                self._write(wanted, scored)
            else:
                self._have(wanted, scored)

        self._scorer.score(wanted, done)

    def _write(self, wanted: ToScore, scored: RenderedResult) -> None:
        folder = wanted.folder

        def heard(answer: Future[Details]) -> None:
            self._trying -= 1
            if folder != self._folder:  # it was left meanwhile, and waits as such
                return
            self.problem = _not_on_disk(why) if (why := why_not(answer)) else None
            if self.problem is None:
                self._written(answer.result())
                self._tell(folder)
            self._have(wanted, scored)

        self._folder = folder
        self._trying += 1
        place, entries = self._journal.folder, self._journal.entries
        write = partial(issue, place, scored.files, entries, in_console=True)
        self._keepers.own.submit_job(write, heard)

    def _have(self, wanted: ToScore, scored: RenderedResult) -> None:
        if wanted is not self._awaited:
            return
        self.scored, self._awaited = scored, None
        self._shown(scored)

    def clear(self) -> None:
        self.scored = self._awaited = None
        self._scorer.forget()

    def leave(self, folder: Path | None) -> None:
        """The run is left: what is not on disk of it waits."""
        problem = self.problem or self._journal.problem
        if problem is None and self._journal.unwritten[0]:
            problem = "its journal waits for the disk"
        if problem is not None and self.scored is not None and folder is not None:
            place, entries = self._journal.hand_over_folder(), self._journal.entries
            unwritten = Unwritten(place, self.scored, entries, problem)
            self._unwritten[folder] = unwritten
            self._tried = -math.inf  # soon, before the next run begins
        self.problem = self._folder = None

    def retry_writing(self, now: float, *, busy: bool) -> None:
        """Write again what the disk refused; results only while no run is `busy`.

        `now` is in s since the epoch.
        """
        if 0 <= now - self._tried < RETRY_PERIOD:
            return
        self._tried = now
        self._journal.catch_up()
        if busy or self._trying:
            return
        if self.problem is not None and self._awaited is None:
            self._again()  # files that could not be read may be readable now
        self._write_unwritten(now)

    def end(self, folder: Path | None, now: float) -> None:
        """The engine ends: try for the last time to write what the disk refused."""
        self._journal.catch_up()
        self.leave(folder)
        self._journal.close()
        self._write_unwritten(now)

    def _write_unwritten(self, now: float) -> None:
        for run in tuple(self._unwritten.values()):
            self._trying += 1
            self._keepers.own.submit_job(partial(run.write, now), partial(self._heard, run))

    def _heard(self, run: Unwritten, answer: Future[None]) -> None:
        self._trying -= 1
        if (why := why_not(answer)) is not None:
            self._unwritten[run.folder.path] = replace(run, problem=_not_on_disk(why))
        else:
            del self._unwritten[run.folder.path]
            self._tell(run.folder.path)


def _not_on_disk(why: str) -> str:
    return f"the result is NOT on disk: {why}"
