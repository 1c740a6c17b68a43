"""What people take away from the engine: report, pages of the competition, runs of a team."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from madrob_console.archive.folders import (
    FRAMES_FOLDER,
    INDEX_PAGE,
    REPORT_FILE,
    results_folder_of,
)
from madrob_console.engine.process.background import PAUSE, Background, Finished
from madrob_console.engine.shown.snapshot import ExportView
from madrob_console.names import terminal_safe

PAGE = "page"
"""The chore that writes a report: its file follows, the scored run comes on standard input."""

PICTURES = "pictures"
"""The command that writes what cameras saw: a run, an instant and a folder follow."""

REPAIR = "repair"
"""The chore that makes results again that are not what their journals say: a folder follows."""

RENEW = "renew"
"""The chore that makes reports again that tell of other runs than there are: a folder follows, and
maybe a command that comes first: one process draws the figures of report and site once."""

OLDER = "not all is up to date"
"""The last line of such a chore that could not make everything."""

PUBLISH = "publish"
"""The command that writes the competition's pages: their folder and where the runs are follow."""

CLOSING_TIME = 3.0
"""An engine that ends waits so long for what is being made; it gets ready without it, too, s."""


class _Unmade(NamedTuple):
    """A report that could not be made, in words, and whether it is tried again."""

    words: str
    again: bool


class Reporting:
    """Makes them in the background, never during a run.

    Args:
        command: the program that does the chores (`madrob_console.cli.aside`).
        busy: whether a run goes on; may be asked from any thread.
        options: of `madrob export`: results folder, settings.
        reports: whether reports are wanted.
        publish: of `madrob publish`, after each result; none = nobody wants it.
        pause: before one for which something was wanting is tried again, s.

    Attributes:
        exported: the last export; None before the first.
    """

    def __init__(
        self,
        command: Sequence[str],
        busy: Callable[[], bool],
        options: Sequence[str] = (),
        *,
        reports: bool = True,
        publish: Sequence[str] = (),
        pause: float = PAUSE,
    ) -> None:
        self._unmade: dict[Path, _Unmade] = {}
        self.exported: ExportView | None = None
        self._options = tuple(options)
        self._reports = reports
        self._publish = tuple(publish)
        self._background = Background(command, busy, pause)

    def report(self, folder: Path, scored: bytes | memoryview) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts.

        Then the reports of runs that are compared with it, and the competition's pages.

        Args:
            folder: of the run.
            scored: the `Scored` run, pickled.
        """

        def done(finished: Finished) -> None:
            # a new one, not changed: others read it meanwhile
            unmade = {f: one for f, one in self._unmade.items() if one.again and f != folder}
            if finished.code != 0:
                words = f"no report of {folder.name}: {_why(finished)}"
                unmade[folder] = _Unmade(f"{words}; `madrob report` makes it", finished.again)
            self._unmade = unmade

        if self._reports:
            self._background.ask(str(folder), [PAGE, str(folder / REPORT_FILE)], done, scored)
        self._all_of(results_folder_of(folder), RENEW, *self._publishing)

    def publish(self) -> None:
        """Write the competition's pages again where they have changed, if they are wanted."""
        if not self._publish:
            return
        site = Path(self._publish[0])

        def done(finished: Finished) -> None:
            unmade = {place: one for place, one in self._unmade.items() if place != site}
            if finished.code != 0 and not self._wrote_pages(finished):
                words = f"the pages in {site} are not up to date: {_why(finished)}"
                unmade[site] = _Unmade(words, finished.again)
            self._unmade = unmade

        self._background.ask(PUBLISH, self._publishing, done)

    def _wrote_pages(self, finished: Finished) -> bool:
        """Whether the last that was done was to write the pages, maybe without a damaged run."""
        return finished.said == str(Path(self._publish[0]) / INDEX_PAGE)

    def repair(self, results: Path) -> None:
        """Make the results and reports again that a power cut left out of date; never in a run.

        Then the competition's pages.
        """
        self._all_of(results, REPAIR)
        self.publish()

    @property
    def _publishing(self) -> Sequence[str]:
        """The command that writes the competition's pages; nothing where nobody wants them."""
        return (PUBLISH, *self._publish) if self._publish else ()

    def _all_of(self, results: Path, chore: str, *command: str) -> None:
        """Have a chore done with all runs of a results folder."""
        called = results / chore
        made_too = {called, *map(Path, self._publish[:1])} if command else {called}

        def done(finished: Finished) -> None:
            unmade = {place: one for place, one in self._unmade.items() if place not in made_too}
            if finished.code != 0 and not (command and self._wrote_pages(finished)):
                why = _why(finished)
                if chore == RENEW:
                    why = f"reports or pages of {results} are older than its results: {why}"
                unmade = {called: _Unmade(why, finished.again), **unmade}
            self._unmade = unmade

        self._background.ask(chore, [chore, str(results), *command], done)

    def export(
        self, subject: int, competition: str | None = None, *, practice: bool = False
    ) -> None:
        """Pack the official, or the practice runs of a team into a zip.

        `exported` says what became of it.
        """
        options = [f"--subject={subject}", "--without-evidence", *["--practice"] * practice]
        if competition is not None:
            options.append(f"--competition={competition}")
        self._pack(ExportView(subject), f"team {subject}", options)

    def export_dossier(self, run: Path, called: str) -> None:
        """Pack all about one run into a zip.

        Args:
            run: its folder.
            called: as seen from the results folder.
        """
        self._pack(
            ExportView(0, dossier=called), f"dossier {called}", [f"--run={run}", "--dossier"]
        )

    def _pack(self, wanted: ExportView, name: str, options: Sequence[str]) -> None:
        def done(finished: Finished) -> None:
            if self.exported is None or self.exported.what != wanted.what:
                return  # tried again, and meanwhile somebody wants to see another one
            bad = finished.code != 0
            path = finished.said if finished.said.endswith(".zip") else ""
            why = _why(finished) if bad else ""
            self.exported = replace(wanted, path=path, problem=why)

        self.exported = wanted
        self._background.ask(name, ["export", *options, *self._options], done)

    def frames(self, run: Path, at: float, done: Callable[[str, str], None]) -> None:
        """Write what the cameras saw at an instant of a run into its folder.

        Args:
            run: its folder.
            at: s from the start of the run.
            done: told the folder with the files and why there are none, one of which is empty; in
                the thread of the chores.
        """
        instant, folder = f"{at:.3f}", run.absolute() / FRAMES_FOLDER

        def told(finished: Finished) -> None:
            done("" if finished.code else str(folder), _why(finished) if finished.code else "")

        arguments = [PICTURES, str(run.absolute()), f"--at={instant}", f"--output={folder}"]
        self._background.ask(f"frames at {instant}", arguments, told)

    @property
    def problem(self) -> str | None:
        """Why reports could not be made, in words; None when the last one could, and all before."""
        unmade = tuple(self._unmade.values())
        if not unmade:
            return None
        others = f" ({len(unmade) - 1} more wait)" if len(unmade) > 1 else ""
        return unmade[-1].words + others

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; returns whether everything is made."""
        return self._background.wait(patience)

    def close(self, patience: float = CLOSING_TIME) -> None:
        """Wait at most `patience` s for what is asked for; what is under way gets ready anyway."""
        self._background.close(patience)


def _why(finished: Finished) -> str:
    words = terminal_safe(finished.complained).removeprefix("madrob: ")
    if not words and finished.code == -signal.SIGKILL:
        words = "its process was killed, as when memory is short: end other programs"
    words = words or f"its process ended with {finished.code}"
    return f"{words}; it is tried again" if finished.again else words
