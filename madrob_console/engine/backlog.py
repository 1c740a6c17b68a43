"""Results that the disk refused: kept in memory, and tried again until they are on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.engine.results import Scored, write_results
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import Entry, Origin, up_to_date
from madrob_console.referee.rebuild import Change
from madrob_console.runs import JOURNAL_FILE

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


class Backlog:
    """Runs that wait for the disk while others go on. Without room no run starts: they are few."""

    def __init__(self) -> None:
        self._waiting: dict[Path, Unwritten] = {}

    def __contains__(self, folder: Path) -> bool:
        return folder in self._waiting

    @property
    def problems(self) -> tuple[str, ...]:
        """Which runs wait and why, in words."""
        return tuple(
            f"run {run.scored.record.setup.run_number} of subject "
            f"{run.scored.record.setup.subject}: {run.problem}"
            for run in self._waiting.values()
        )

    def add(self, run: Unwritten) -> None:
        """Keep a run until it is on disk."""
        self._waiting[run.folder] = run

    def try_again(self, now: float) -> None:
        """Write what can be written at `now`, s since the epoch."""
        for run in tuple(self._waiting.values()):
            del self._waiting[run.folder]
            try:
                run.write(now)
            except MadrobError as error:
                self.add(replace(run, problem=not_on_disk(error)))


def not_on_disk(error: MadrobError) -> str:
    """Why a result is not on disk, in words."""
    return f"the result is NOT on disk: {error}"
