"""Reports, pages and zips, made in background processes of low priority."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, NamedTuple

from madrob_console.archive.folders import FRAMES_FOLDER, INDEX_PAGE, REPORT_FILE, results_folder_of
from madrob_console.common.names import terminal_safe
from madrob_console.engine.snapshot import ExportView
from recorder.errors import remedy

# Background work, in processes of low priority.


PERIOD = 0.1
"""A process stops for a run within this time, s."""

PAUSE = 10.0
"""Pause before a chore is retried, s; doubled for each further try."""

LONGEST_PAUSE = 80.0
"""Longest pause, s."""

_PATIENCE = 2.0  # with a process that was told to end, s


@dataclass(frozen=True, slots=True)
class Finished:
    """Outcome of a chore.

    Attributes:
        code: the exit code of its process; None where none could be started.
        said, complained: the last line that it printed, as output and as an error.
        again: it lacked memory, file handles, a program or a disk, and is retried by itself.
    """

    code: int | None
    said: str
    complained: str
    again: bool = False


@dataclass(frozen=True, slots=True)
class _Chore:
    name: str
    arguments: tuple[str, ...]
    done: Callable[[Finished], None]
    given: bytes | memoryview | None
    pause: float


class Background:
    """Does one chore after the other, none while a run goes on, in a thread of its own.

    A chore that a run cuts short is done again after the run; one that lacked something,
    after a pause (in s). A chore replaces a waiting one of the same name. Nobody waits, and
    no failing chore ends the thread. `busy` may be asked from any thread.
    """

    def __init__(
        self, command: Sequence[str], busy: Callable[[], bool], pause: float = PAUSE
    ) -> None:
        self._command = tuple(command)
        self._busy = busy
        self._pause = pause
        self._changed = threading.Condition()
        self._waiting: dict[str, _Chore] = {}
        self._resting: dict[str, tuple[float, _Chore]] = {}
        self._working = False
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)
        self._thread.start()

    def submit_chore(
        self,
        name: str,
        arguments: Sequence[str],
        done: Callable[[Finished], None],
        given: bytes | memoryview | None = None,
    ) -> None:
        """`done` gets each try's outcome in the chores' thread; `given` is standard input."""
        with self._changed:
            self._resting.pop(name, None)
            self._waiting.pop(name, None)  # it comes after all that was asked for before
            self._waiting[name] = _Chore(name, tuple(arguments), done, given, self._pause)
            self._changed.notify_all()

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; whether everything is done, or pauses after a failure."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._working, patience)

    def close(self, patience: float) -> None:
        """Ignore runs from now on, and wait at most `patience` s; the rest goes on by itself."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(patience)
        with self._changed:
            left = (*self._waiting.values(), *(chore for _, chore in self._resting.values()))
            self._waiting.clear()
            self._resting.clear()
        for chore in left:
            with suppress(Exception):  # this program is at its end: nobody is there to be told
                self._start(chore, subprocess.DEVNULL, subprocess.DEVNULL)

    # ------------------------------------------------------------------ the thread

    def _work(self) -> None:
        while (chore := self._next()) is not None:
            finished = self._attempt(chore)
            with self._changed:
                if finished is None:
                    self._waiting.setdefault(chore.name, chore)
                elif finished.again and chore.name not in self._waiting:
                    self._rest(chore)
                self._working = False
                self._changed.notify_all()

    def _rest(self, chore: _Chore) -> None:
        later = replace(chore, pause=min(2 * chore.pause, LONGEST_PAUSE))
        self._resting[chore.name] = (time.monotonic() + chore.pause, later)

    def _next(self) -> _Chore | None:
        with self._changed:
            while True:
                self._wake()
                if self._waiting and not self._must_wait():
                    self._working = True
                    return self._waiting.pop(next(iter(self._waiting)))
                if self._closing:
                    return None
                due = min((due for due, _ in self._resting.values()), default=None)
                rest = None if due is None else max(0.0, due - time.monotonic())
                self._changed.wait(PERIOD if self._waiting else rest)

    def _wake(self) -> None:
        now = time.monotonic()
        for name in [name for name, (due, _) in self._resting.items() if due <= now]:
            self._waiting[name] = self._resting.pop(name)[1]

    def _must_wait(self) -> bool:
        return self._busy() and not self._closing

    def _attempt(self, chore: _Chore) -> Finished | None:
        try:
            finished = self._do(chore)
            if finished is not None:
                chore.done(finished)
        except Exception as error:  # noqa: BLE001 - whatever it is, the others want to be done
            finished = Finished(None, "", _words(error), isinstance(error, OSError | MemoryError))
            with suppress(MemoryError):  # then it is told the next time
                chore.done(finished)
        return finished

    def _do(self, chore: _Chore) -> Finished | None:
        with _scratch() as out, _scratch() as err:
            process = self._start(chore, out, err)
            while True:
                try:
                    code = process.wait(PERIOD)
                except subprocess.TimeoutExpired:
                    if self._must_wait():
                        _end(process)
                        return None
                    continue
                again = code in (
                    os.EX_TEMPFAIL,
                    -signal.SIGKILL,
                )  # which ends it for want of memory
                return Finished(code, _last_line(out), _last_line(err), again)

    def _start(
        self, chore: _Chore, out: IO[bytes] | int, err: IO[bytes] | int
    ) -> subprocess.Popen[bytes]:
        with _scratch() as given:
            if chore.given is not None:
                given.write(chore.given)
                given.seek(0)
            return subprocess.Popen(
                [*self._command, *chore.arguments],
                stdin=given,
                stdout=out,
                stderr=err,
                start_new_session=True,  # no hang-up and no Ctrl+C of a terminal reaches it
            )


def _scratch() -> IO[bytes]:
    """A file without a name: a folder for temporary files may go while the engine runs."""
    return os.fdopen(os.memfd_create("madrob"), "w+b")


def _words(error: Exception) -> str:
    if isinstance(error, MemoryError):
        error = OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    if not isinstance(error, OSError):
        return f"no process could be started ({type(error).__name__}: {error})"
    why = error.strerror or str(error)
    if error.filename is not None:
        why = f"{error.filename}: {why}"
    hint = remedy(error)
    return f"no process could be started ({why})" + (f"; {hint}" if hint else "")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _last_line(file: IO[bytes]) -> str:
    file.seek(0)
    lines = file.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


PAGE = "page"
"""The chore that writes the report of a run: its file in the run's folder follows."""

PICTURES = "pictures"
"""The command that writes what cameras saw: a run, an instant and a folder follow."""

REPAIR = "repair"
"""The chore that makes results again that differ from their journals: a folder follows."""

RENEW = "renew"
"""The chore that makes outdated reports again: a folder follows, and maybe a command that comes
first: one process draws the figures of report and site once.
"""

OLDER = "not all is up to date"
"""The last line of such a chore that could not make everything."""

PUBLISH = "publish"
"""The command that writes the competition's pages: their folder and where the runs are follow."""

CLOSING_TIME = 3.0
"""An engine that ends waits this long for unfinished chores, s; they go on without it, too."""


class _Unmade(NamedTuple):
    words: str
    again: bool


class Reporting:
    """Makes reports, pages and zips in the background, never during a run.

    Args:
        command: the program that does the chores (`madrob_console.cli.aside`).
        busy: whether a run goes on; may be asked from any thread.
        options: of `madrob export`: results folder, settings.
        publish: of `madrob publish`, after each result; empty = no pages are wanted.
        pause: before a chore is retried, s.
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

    def report(self, folder: Path) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts.

        Then the reports of runs that are compared with it, and the competition's pages.
        """

        def done(finished: Finished) -> None:
            # a new one, not changed: others read it meanwhile
            unmade = {f: one for f, one in self._unmade.items() if one.again and f != folder}
            if finished.code != 0:
                words = f"no report of {folder.name}: {_why(finished)}"
                unmade[folder] = _Unmade(f"{words}; `madrob report` makes it", finished.again)
            self._unmade = unmade

        if self._reports:
            self._background.submit_chore(str(folder), [PAGE, str(folder / REPORT_FILE)], done)
        self._all_of(results_folder_of(folder), RENEW, *self._publishing)

    def publish(self) -> None:
        if not self._publish:
            return
        site = Path(self._publish[0])

        def done(finished: Finished) -> None:
            unmade = {place: one for place, one in self._unmade.items() if place != site}
            if finished.code != 0 and not self._wrote_pages(finished):
                words = f"the pages in {site} are not up to date: {_why(finished)}"
                unmade[site] = _Unmade(words, finished.again)
            self._unmade = unmade

        self._background.submit_chore(PUBLISH, self._publishing, done)

    def _wrote_pages(self, finished: Finished) -> bool:
        return finished.said == str(Path(self._publish[0]) / INDEX_PAGE)

    def repair(self, results: Path) -> None:
        """Make results and reports again that a power cut left out of date, then the pages."""
        self._all_of(results, REPAIR)
        self.publish()

    @property
    def _publishing(self) -> Sequence[str]:
        return (PUBLISH, *self._publish) if self._publish else ()

    def _all_of(self, results: Path, chore: str, *command: str) -> None:
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

        self._background.submit_chore(chore, [chore, str(results), *command], done)

    def export(
        self, subject: int, competition: str | None = None, *, practice: bool = False
    ) -> None:
        """Pack the runs of a team into a zip; `exported` has the outcome."""
        options = [f"--subject={subject}", "--without-evidence", *["--practice"] * practice]
        if competition is not None:
            options.append(f"--competition={competition}")
        self._pack(ExportView(subject), f"team {subject}", options)

    def export_dossier(self, run: Path, called: str) -> None:
        """Pack everything about one run into a zip; `called`: its path in the results folder."""
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
        self._background.submit_chore(name, ["export", *options, *self._options], done)

    def frames(self, run: Path, at: float, done: Callable[[str, str], None]) -> None:
        """Write what the cameras saw `at` s from the start of a run into its folder.

        `done` gets the folder with the files, or why there are none; in the thread of the
        chores.
        """
        instant, folder = f"{at:.3f}", run.absolute() / FRAMES_FOLDER

        def told(finished: Finished) -> None:
            done("" if finished.code else str(folder), _why(finished) if finished.code else "")

        arguments = [PICTURES, str(run.absolute()), f"--at={instant}", f"--output={folder}"]
        self._background.submit_chore(f"frames at {instant}", arguments, told)

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
        """Wait at most `patience` s for the waiting chores; those under way go on anyway."""
        self._background.close(patience)


def _why(finished: Finished) -> str:
    words = terminal_safe(finished.complained).removeprefix("madrob: ")
    if not words and finished.code == -signal.SIGKILL:
        words = "its process was killed, as when memory is short: end other programs"
    words = words or f"its process ended with {finished.code}"
    return f"{words}; it is tried again" if finished.again else words
