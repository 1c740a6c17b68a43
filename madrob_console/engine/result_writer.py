"""Requests, writes and shows the current run's result; what the disk refuses is retried."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.result_files import write_result
from madrob_console.common.errors import MadrobError
from madrob_console.engine.disk import DiskJobs, DiskThreads, why_not
from madrob_console.engine.run_recorder import EventPublisher
from madrob_console.engine.scorer import RenderedResult, Scorer, ToScore
from madrob_console.referee.flags import NO_INDICATORS
from madrob_console.referee.journal import Entry, Origin, up_to_date
from madrob_console.referee.rebuild import Change
from scoring.indicator_table import IndicatorName
from scoring.result import Indicator

# Writing results. What the disk refuses stays in memory and is retried until it is written.


RETRY_PERIOD = 2.0
"""Pause between two tries, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Unwritten:
    """A run whose result or journal is not on disk, and why."""

    folder: Path
    scored: RenderedResult
    entries: Sequence[Entry]
    problem: str

    def write(self, now: float) -> None:
        """Write the missing journal lines, then the result; `now` is s since the epoch.

        Raises:
            MadrobError: the disk refuses; what is written already may be written again.
        """
        details = self.scored.written_details
        written = Entry(now, Origin.SYSTEM, Change.RESULT_WRITTEN, details=details)
        path = self.folder / JOURNAL_FILE
        try:
            self.folder.mkdir(parents=True, exist_ok=True)  # it may have been deleted
            journal = up_to_date(path, self.entries)
        except OSError as error:
            raise MadrobError(f"{path}: cannot be written ({error.strerror})") from None
        try:
            write_result(self.folder, self.scored.files, self.scored.run.issue)
            journal.append([written])
        finally:
            journal.close()


class ResultKeeper:
    """Writes the result of the current run, and those of earlier runs that wait for the disk.

    No run starts without room on the disk: few results wait. `written` is called for each
    result of the current run that is on disk, `tell` for those of earlier runs, too. `anew`
    has a result made again whose files may be readable now; it returns whether it is on its
    way.
    """

    def __init__(
        self,
        keeper: DiskJobs,
        written: Callable[[Path, RenderedResult], None],
        tell: Callable[[Path], None],
        anew: Callable[[], bool],
    ) -> None:
        self.problem: str | None = None
        self._keeper = keeper
        self._written = written
        self._tell = tell
        self._anew = anew
        self._at_hand: Path | None = None
        self._refused: tuple[Path, RenderedResult] | None = None
        self._waiting: dict[Path, Unwritten] = {}
        self._tried = -math.inf
        self._trying = 0

    def __contains__(self, folder: Path) -> bool:
        return folder in self._waiting

    @property
    def writing(self) -> bool:
        return self._trying > 0

    @property
    def problems(self) -> tuple[str, ...]:
        """Earlier runs that wait and why, in words. From any thread."""
        return tuple(
            f"run {run.scored.record.setup.run_number} of subject "
            f"{run.scored.record.setup.subject}: {run.problem}"
            for run in tuple(self._waiting.values())
        )

    def write(self, folder: Path, scored: RenderedResult, done: Callable[[], None]) -> None:
        """Have the result of the current run written; `done` is called then, or when it failed."""

        def heard(answer: Future[None]) -> None:
            self._trying -= 1
            why = why_not(answer)
            if folder != self._at_hand:  # it was left meanwhile, and waits as such
                return
            if why is not None:
                self.problem, self._refused = _not_on_disk(why), (folder, scored)
            else:
                self.problem = self._refused = None
                self._written(folder, scored)
                self._tell(folder)
            done()

        self._at_hand = folder
        self._trying += 1
        self._keeper.submit_job(
            partial(write_result, folder, scored.files, scored.run.issue), heard
        )

    def leave(self, unwritten: Unwritten | None) -> None:
        self.problem = self._refused = self._at_hand = None
        if unwritten is not None:
            self._waiting[unwritten.folder] = unwritten
            self._tried = -math.inf  # soon, before the next run begins

    def due(self, now: float) -> bool:
        """`now` is s since the epoch."""
        return not 0 <= now - self._tried < RETRY_PERIOD

    def try_again(self, now: float, *, busy: bool) -> None:
        """Write what can be written at `now` (s since the epoch), while no run is `busy`."""
        self._tried = now
        if busy or self._trying:
            return
        if self._refused is not None and not self._anew():
            self.write(*self._refused, lambda: None)
        for run in tuple(self._waiting.values()):
            self._trying += 1
            self._keeper.submit_job(partial(run.write, now), partial(self._heard, run))

    def _heard(self, run: Unwritten, answer: Future[None]) -> None:
        self._trying -= 1
        if (why := why_not(answer)) is not None:
            self._waiting[run.folder] = replace(run, problem=_not_on_disk(why))
        else:
            del self._waiting[run.folder]
            self._tell(run.folder)


def _not_on_disk(why: str) -> str:
    return f"the result is NOT on disk: {why}"


NOTICEABLE = 0.3
"""An outdated result stays on screen this long while the next one is made, s."""

HURRY = 1.0
"""A wanted result is checked often for this long, s."""


class CurrentResult:
    """Has the results of one run after the other made and written; shows each once on disk.

    Results of earlier runs that the disk has refused wait here, too. `scored` is that of
    the current run, once it can be shown.
    """

    def __init__(
        self,
        scorer: Scorer,
        keepers: DiskThreads,
        event_publisher: EventPublisher,
        *,
        again: Callable[[], None],
        written: Callable[[Path, RenderedResult], None],
        shown: Callable[[RenderedResult], None],
        tell: Callable[[Path], None],
    ) -> None:
        self.scored: RenderedResult | None = None
        self._scorer = scorer
        self._monotonic = keepers.monotonic
        self._event_publisher = event_publisher
        self._again = again
        self._shown = shown
        self._files = ResultKeeper(keepers.own, written, tell, self._anew)
        self._asked = 0
        self._awaited: int | None = None
        self._awaited_since = 0.0
        self._hurries_until = -math.inf
        self._ending = False

    def __contains__(self, folder: Path) -> bool:
        """Whether the result of an earlier run waits for the disk."""
        return folder in self._files

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
        return waits and self._monotonic() - self._awaited_since > NOTICEABLE

    @property
    def hopeless(self) -> bool:
        return self._scorer.hopeless

    @property
    def writing(self) -> bool:
        return self._files.writing

    @property
    def problem(self) -> str | None:
        return self._files.problem

    @property
    def problems(self) -> tuple[str | None, ...]:
        return (self._files.problem, self._scorer.problem, *self._files.problems)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Earlier runs that are not on disk and why, in words. From any thread."""
        return self._files.problems

    @property
    def hurries(self) -> bool:
        return self._monotonic() < self._hurries_until

    def hurry(self) -> None:
        """Check often: people wait for something that is made elsewhere."""
        self._hurries_until = self._monotonic() + HURRY

    def request_result(self, wanted: ToScore) -> None:
        """Request the result of the current run; replaces an earlier request.

        With files the result goes to disk, and is shown once it is there or the disk has refused.
        """
        if self._awaited is None:
            self._awaited_since = self._monotonic()
        self.hurry()
        self._asked += 1
        number = self._awaited = self._asked

        def done(scored: RenderedResult) -> None:
            if number != self._awaited:
                return
            if wanted.files:
                self._files.write(wanted.folder, scored, lambda: self._have(number, scored))
            else:
                self._have(number, scored)

        run = replace(wanted.run, journal=self._event_publisher.mark)
        self._scorer.score(replace(wanted, run=run), done)

    def _have(self, number: int, scored: RenderedResult) -> None:
        if number != self._awaited:
            return
        self.scored, self._awaited = scored, None
        self._hurries_until = -math.inf
        self._shown(scored)

    def _anew(self) -> bool:
        """Have a result made again that the disk refused; False where none can come soon."""
        if self._awaited is not None or self._ending:
            return False
        self._again()
        return True

    def clear(self) -> None:
        self.scored = self._awaited = None
        self._scorer.forget()

    def leave(self, folder: Path | None) -> None:
        event_publisher = self._event_publisher
        problem = self.problem or event_publisher.problem
        if problem is None and event_publisher.unwritten[0]:
            problem = "its journal waits for the disk"
        unwritten = None
        if problem is not None and self.scored is not None and folder is not None:
            unwritten = Unwritten(folder, self.scored, event_publisher.entries, problem)
        self._files.leave(unwritten)

    def retry_writing(self, now: float, *, busy: bool) -> None:
        if self._files.due(now):
            self._try_again(now, busy=busy)

    def end(self, now: float, *, busy: bool) -> None:
        self._ending = True
        self._try_again(now, busy=busy)

    def _try_again(self, now: float, *, busy: bool) -> None:
        self._event_publisher.catch_up()
        self._files.try_again(now, busy=busy)
