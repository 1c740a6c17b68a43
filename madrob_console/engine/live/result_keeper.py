"""Writes results; what the disk refuses stays in memory and is tried again until it is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.result_writer import write_results
from madrob_console.archive.scored import Scored
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
    scored: Scored
    entries: Sequence[Entry]
    problem: str

    def write(self, now: float) -> None:
        """Write the result, and the lines that the journal has not.

        Args:
            now: s since the epoch.

        Raises:
            MadrobError: the disk refuses; what is written already may be written again.
        """
        write_results(self.folder, self.scored)
        details = {"issue": self.scored.run.issue}
        written = Entry(now, Origin.SYSTEM, Change.RESULT_WRITTEN, details=details)
        path = self.folder / JOURNAL_FILE
        try:
            up_to_date(path, (*self.entries, written)).close()
        except OSError as error:
            raise MadrobError(f"{path}: cannot be written ({error.strerror})") from None


class ResultKeeper:
    """Writes the result of the run at hand, and those of runs before it that wait for the disk.

    Without room no run starts: few wait.

    Args:
        written: told of each result of the run at hand that is on disk.
        tell: told of each result that is on disk.

    Attributes:
        problem: why the result of the run at hand is not on disk, in words; None when it is.
    """

    def __init__(
        self, written: Callable[[Path, Scored], None], tell: Callable[[Path, Scored], None]
    ) -> None:
        self.problem: str | None = None
        self._written = written
        self._tell = tell
        self._refused: tuple[Path, Scored] | None = None
        self._waiting: dict[Path, Unwritten] = {}
        self._tried = -math.inf

    def __contains__(self, folder: Path) -> bool:
        return folder in self._waiting

    @property
    def problems(self) -> tuple[str, ...]:
        """Which runs before the one at hand wait and why, in words."""
        return tuple(
            f"run {run.scored.record.setup.run_number} of subject "
            f"{run.scored.record.setup.subject}: {run.problem}"
            for run in self._waiting.values()
        )

    def write(self, folder: Path, scored: Scored) -> None:
        """Write the result of the run at hand; if the disk refuses, `problem` says so."""
        try:
            write_results(folder, scored)
        except MadrobError as error:
            self.problem, self._refused = _not_on_disk(error), (folder, scored)
        else:
            self.problem = self._refused = None
            self._written(folder, scored)
            self._tell(folder, scored)

    def leave(self, unwritten: Unwritten | None) -> None:
        """Another run takes the place of the one at hand, which waits if it is not on disk."""
        self.problem = self._refused = None
        if unwritten is not None:
            self._waiting[unwritten.folder] = unwritten

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
        if busy:
            return
        if self._refused is not None:
            self.write(*self._refused)
        for run in tuple(self._waiting.values()):
            del self._waiting[run.folder]
            try:
                run.write(now)
            except MadrobError as error:
                self._waiting[run.folder] = replace(run, problem=_not_on_disk(error))
            else:
                self._tell(run.folder, run.scored)


def _not_on_disk(error: MadrobError) -> str:
    return f"the result is NOT on disk: {error}"
