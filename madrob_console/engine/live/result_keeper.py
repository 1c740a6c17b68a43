"""Writes results; what the disk refuses stays in memory and is tried again until it is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.result_writer import write_result
from madrob_console.engine.live.keeper import Keeper, why_not
from madrob_console.engine.live.scorer import RenderedResult
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import Entry, Origin, up_to_date
from madrob_console.referee.rebuild import Change

RETRY_PERIOD = 2.0
"""Between two tries, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Unwritten:
    """A run whose result or journal is not on disk.

    Attributes:
        folder: where they belong.
        scored: the result.
        entries: every line of the journal.
        problem: why it is not, in words.
    """

    folder: Path
    scored: RenderedResult
    entries: Sequence[Entry]
    problem: str

    def write(self, now: float) -> None:
        """Write the lines that the journal has not, then the result.

        Args:
            now: s since the epoch.

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
    """Writes the result of the run at hand, and those of runs before it that wait for the disk.

    Without room no run starts: few wait.

    Args:
        keeper: touches the files.
        written: told of each result of the run at hand that is on disk.
        tell: told of each result that is on disk.
        anew: has the result of the run at hand made again, whose files may be readable now;
            returns whether it is on its way.

    Attributes:
        problem: why the result of the run at hand is not on disk, in words; None when it is.
    """

    def __init__(
        self,
        keeper: Keeper,
        written: Callable[[Path, RenderedResult], None],
        tell: Callable[[Path, RenderedResult], None],
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
        """Whether a result is being written."""
        return self._trying > 0

    @property
    def problems(self) -> tuple[str, ...]:
        """Which runs before the one at hand wait and why, in words. From any thread."""
        return tuple(
            f"run {run.scored.record.setup.run_number} of subject "
            f"{run.scored.record.setup.subject}: {run.problem}"
            for run in tuple(self._waiting.values())
        )

    def write(self, folder: Path, scored: RenderedResult, done: Callable[[], None]) -> None:
        """Have the result of the run at hand written.

        Args:
            folder: of the run, which stays at hand until then.
            scored: the result.
            done: told when it is on disk, or when the disk refuses it: then `problem` says so.
        """

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
                self._tell(folder, scored)
            done()

        self._at_hand = folder
        self._trying += 1
        self._keeper.ask(partial(write_result, folder, scored.files, scored.run.issue), heard)

    def leave(self, unwritten: Unwritten | None) -> None:
        """Another run takes the place of the one at hand, which waits if it is not on disk."""
        self.problem = self._refused = self._at_hand = None
        if unwritten is not None:
            self._waiting[unwritten.folder] = unwritten
            self._tried = -math.inf  # soon, before the next run begins

    def due(self, now: float) -> bool:
        """Whether it is time to try again, at `now` (s since the epoch)."""
        return not 0 <= now - self._tried < RETRY_PERIOD

    def try_again(self, now: float, *, busy: bool) -> None:
        """Write what can be written now.

        Args:
            now: s since the epoch.
            busy: a run goes on; results wait for its end.
        """
        self._tried = now
        if busy or self._trying:
            return
        if self._refused is not None and not self._anew():
            self.write(*self._refused, lambda: None)
        for run in tuple(self._waiting.values()):
            self._trying += 1
            self._keeper.ask(partial(run.write, now), partial(self._heard, run))

    def _heard(self, run: Unwritten, answer: Future[None]) -> None:
        """A run before the one at hand is on disk, or the disk refuses it again."""
        self._trying -= 1
        if (why := why_not(answer)) is not None:
            self._waiting[run.folder] = replace(run, problem=_not_on_disk(why))
        else:
            del self._waiting[run.folder]
            self._tell(run.folder, run.scored)


def _not_on_disk(why: str) -> str:
    return f"the result is NOT on disk: {why}"
