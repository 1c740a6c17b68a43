"""What people take away from the engine: the report of each result, and the runs of a team."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.archive.scored import Scored
from madrob_console.engine.process.background import Background, Finished
from madrob_console.engine.shown.snapshot import ExportView
from madrob_console.names import terminal_safe

PAGE = "page"
"""The chore that writes a report: its file follows, the scored run comes pickled."""

CLOSING_TIME = 3.0
"""An engine that ends waits so long for what is being made; it gets ready without it, too, s."""


class Reporting:
    """Makes them in the background, never during a run.

    Args:
        command: the program that does the chores (`madrob_console.cli.aside`).
        busy: whether a run goes on; may be asked from any thread.
        options: of `madrob export`: results folder, settings.
        reports: whether reports are wanted.

    Attributes:
        problem: why the last report could not be made, in words; None when it could.
        exported: the last export; None before the first.
    """

    def __init__(
        self,
        command: Sequence[str],
        busy: Callable[[], bool],
        options: Sequence[str] = (),
        *,
        reports: bool = True,
    ) -> None:
        self.problem: str | None = None
        self.exported: ExportView | None = None
        self._options = tuple(options)
        self._reports = reports
        self._background = Background(command, busy)

    def report(self, folder: Path, scored: Scored) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts."""
        if not self._reports:
            return

        def done(finished: Finished) -> None:
            self.problem = None
            if finished.code != 0:
                why = _why(finished)
                self.problem = f"no report of {folder.name}: {why}; `madrob report` makes it"

        self._background.ask(str(folder), [PAGE, str(folder / REPORT_FILE)], done, scored)

    def export(self, subject: int) -> None:
        """Pack the runs of a team into a zip; `exported` says what became of it."""

        def done(finished: Finished) -> None:
            bad = finished.code != 0
            path = finished.said if finished.said.endswith(".zip") else ""
            self.exported = ExportView(subject, path, _why(finished) if bad else "")

        self.exported = ExportView(subject)
        self._background.ask(
            f"team {subject}", ["export", f"--team={subject}", *self._options], done
        )

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; returns whether everything is made."""
        return self._background.wait(patience)

    def close(self, patience: float = CLOSING_TIME) -> None:
        """Wait at most `patience` s for what is asked for; what is under way gets ready anyway."""
        self._background.close(patience)


def _why(finished: Finished) -> str:
    words = terminal_safe(finished.complained).removeprefix("madrob: ")
    return words or f"its process ended with {finished.code}"
