"""Reports, pages and zips: made in the background by a process of low priority.

What has to be made is kept in memory alone. An engine that starts finds it again from the results:
no file in a results folder says what is done.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from madrob_console.archive.folders import FRAMES_FOLDER, INDEX_PAGE
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.wire import decoded
from madrob_console.engine.runtime.supervisor import Worker
from madrob_console.engine.snapshot import ExportView

PAUSE = 10.0
"""Pause before a chore is retried, s."""

CLOSING_TIME = 3.0
"""An engine that ends waits this long for unfinished chores, s; they go on without it, too."""


class ChoreKind(StrEnum):
    """What a chore is, the most urgent first; its arguments follow in the command."""

    PICTURES = "pictures"
    """Write the frames of an instant: a run, the instant and a folder follow."""
    EXPORT = "export"
    """`madrob export`: the options follow."""
    REPORT = "report"
    """Make the report of a run anew: its folder follows."""
    REPAIR = "repair"
    """Make results and reports again that are out of date: a results folder follows. Where an
    option follows, name the runs without a report.
    """
    PUBLISH = "publish"
    """`madrob publish`: a folder for the pages and where the runs are follow."""
    MISSING = "missing"
    """Make the report of an earlier run that has none: its folder follows."""
    COMMAND = "command"
    """The command of [results]: its words and the folder of a run follow."""


_URGENCY = {kind: number for number, kind in enumerate(ChoreKind)}


class Chore(msgspec.Struct, frozen=True):
    """What the engine asks of the process; it replaces a waiting one of the same name."""

    name: str
    kind: ChoreKind
    arguments: tuple[str, ...]

    @property
    def place(self) -> Path:
        """The folder that it is for: of a run, of results or of the pages."""
        return Path(self.arguments[-1 if self.kind is ChoreKind.COMMAND else 0])


class Finished(msgspec.Struct, frozen=True):
    """The process's answer: outcome of a chore.

    Attributes:
        code: its exit code.
        said, complained: the last line that it printed, as output and as an error.
        missing: the folders of runs without a report, the newest first.
    """

    chore: Chore
    code: int
    said: str = ""
    complained: str = ""
    missing: tuple[str, ...] = ()

    @property
    def again(self) -> bool:
        """Whether it lacked memory, file handles or a disk, and is retried by itself."""
        return self.code == os.EX_TEMPFAIL

    @property
    def why_not(self) -> str:
        """Why it was not done, in words; empty = it was."""
        if not self.code:
            return ""
        why = terminal_safe(self.complained).removeprefix("madrob: ")
        why = why or f"its process ended with {self.code}"
        return f"{why}; it is tried again" if self.again else why


_answers = msgspec.msgpack.Decoder(Finished)


@dataclass(slots=True, eq=False)
class _Waiting:
    """A chore that is not done yet; `due` in monotonic s."""

    chore: Chore
    due: float = 0.0


class ChoreWorker(Worker):
    """Has chores done by a process, one after the other, never during a run.

    A chore that a run, a crash or a full disk cut short is done again.

    Args:
        command: starts the process.
        busy: whether a run goes on; may be asked from any thread.
        on_finished: gets each outcome.
        on_lost: gets why the process ended before it was through.
        pause: before a chore is retried, s.
    """

    def __init__(
        self,
        command: Sequence[str],
        busy: Callable[[], bool],
        on_finished: Callable[[Finished], None],
        on_lost: Callable[[str], None],
        pause: float,
    ) -> None:
        super().__init__(command)
        self._busy = busy
        self._on_finished = on_finished
        self._on_lost = on_lost
        self._retry_pause = pause
        self._lock = threading.Lock()  # of `_waiting`
        self._waiting: dict[str, _Waiting] = {}
        self._sent: deque[_Waiting] = deque()
        self._closing = False

    def submit(self, chore: Chore, *, anew: bool = True) -> None:
        """Have a chore done, `anew` in place of one of this name that waits."""
        with self._lock:
            if anew or chore.name not in self._waiting:
                self._waiting[chore.name] = _Waiting(chore)
        self.ring()

    @property
    def due_now(self) -> list[_Waiting]:
        """The most urgent first."""
        now = time.monotonic()
        with self._lock:
            due = [one for one in self._waiting.values() if one.due <= now]
        return sorted(due, key=lambda one: _URGENCY[one.chore.kind])

    def ignore_runs(self) -> None:
        """The engine is about to end: what waits goes on without it."""
        self._closing = True
        self.ring()

    # ------------------------------------------------------------------ the supervisor's thread

    @property
    def wanted(self) -> bool:
        return bool(self.due_now) and (self._closing or not self._busy())

    @property
    def goes_on(self) -> bool:
        return not self._busy()  # a run ends it

    def begin(self) -> None:
        self._sent.clear()

    def work(self, now: float) -> float:
        if self.pid is not None and (self._closing or not self._sent):
            waiting = [one for one in self.due_now if one not in self._sent]
            for one in waiting if self._closing else waiting[:1]:
                self._sent.append(one)
                self.send(one.chore)
        return 0.1  # s: a run may begin, or end

    def take(self, data: memoryview) -> None:
        finished = decoded(_answers, data, "a message of the process that makes reports")
        sent = self._sent.popleft()
        with self._lock:
            if finished.again:
                sent.due = time.monotonic() + self._retry_pause
            elif self._waiting.get(sent.chore.name) is sent:  # else it is wanted anew
                del self._waiting[sent.chore.name]
        self._on_finished(finished)

    def lose(self, why: str) -> None:
        if self.due_now:
            self._on_lost(f"{why}; it is tried again")


@dataclass(frozen=True, slots=True)
class WantedPages:
    """What is made by itself.

    Attributes:
        reports: whether a run's report is made after each of its results.
        publish: of `madrob publish`, after each result; empty = no pages are wanted.
        options: of `madrob export`: results folder, settings.
        command: words of a command that is run with the run's folder after each result.
    """

    reports: bool = True
    publish: Sequence[str] = ()
    options: Sequence[str] = ()
    command: Sequence[str] = ()


EVERY_REPORT = WantedPages()

_UNMADE = {
    ChoreKind.REPORT: "no report of {place.name}: {why}; `madrob report` makes it",
    ChoreKind.MISSING: "no report of {place.name}: {why}",
    ChoreKind.PUBLISH: "the pages in {place} are not up to date: {why}",
    ChoreKind.REPAIR: "results or reports in {place} are not up to date: {why}",
    ChoreKind.COMMAND: "the command of [results] failed: {why}",
}
"""What screens show of a chore that was not done."""


class _Unmade(NamedTuple):
    kind: ChoreKind
    words: str
    again: bool


class Reporting:
    """Has reports, pages and zips made in the background, and the command of [results] run.

    Args:
        command: the program that does it (`madrob_console.cli.chore_worker`).
        results: the results folder.
        busy: whether a run goes on; may be asked from any thread.
        pause: before a chore is retried, s.
    """

    def __init__(
        self,
        command: Sequence[str],
        results: Path,
        busy: Callable[[], bool],
        wanted: WantedPages = EVERY_REPORT,
        pause: float = PAUSE,
    ) -> None:
        self.exported: ExportView | None = None
        self._results = results
        self._wanted = wanted
        self._unmade: dict[str, _Unmade] = {}
        self._frames: dict[str, Callable[[str], None]] = {}

        self._lost = ""

        def worker(what: str, *more: str) -> ChoreWorker:
            lose = partial(self._lose, what)
            return ChoreWorker((*command, *more), busy, self._hear, lose, pause)

        self._pages = worker("reports, pages and zips")
        # a process of its own: a command may hang
        self._hook = worker("command of [results]", "--guarded") if wanted.command else None

    @property
    def workers(self) -> tuple[ChoreWorker, ...]:
        """For the supervisor."""
        return (self._pages,) if self._hook is None else (self._pages, self._hook)

    def report(self, folder: Path) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts.

        Then all else that is out of date, as reports of runs that are compared with it. Beside it
        the command of the settings is run.
        """
        if self._hook is not None:
            words = (*self._wanted.command, str(folder.absolute()))
            self._hook.submit(Chore(f"command {folder.name}", ChoreKind.COMMAND, words))
        if self._wanted.reports:
            self._submit(f"report {folder.name}", ChoreKind.REPORT, str(folder))
        self._submit("repair", ChoreKind.REPAIR, str(self._results))
        self.publish()

    def publish(self) -> None:
        if self._wanted.publish:
            self._submit("publish", ChoreKind.PUBLISH, *self._wanted.publish)

    def repair(self) -> None:
        """Make results and reports that are missing or out of date, then the pages."""
        options = ["--missing"] * self._wanted.reports
        self._submit("start", ChoreKind.REPAIR, str(self._results), *options)
        self.publish()

    def export(
        self, subject: int, competition: str | None = None, *, practice: bool = False
    ) -> None:
        """Pack the runs of a team into a zip; `exported` has the outcome."""
        options = [f"--subject={subject}", "--without-evidence", *["--practice"] * practice]
        if competition is not None:
            options.append(f"--competition={competition}")
        self._pack(ExportView(subject), options)

    def export_dossier(self, run: Path, called: str) -> None:
        """Pack everything about one run into a zip; `called`: its path in the results folder."""
        self._pack(ExportView(0, dossier=called), [f"--run={run}", "--dossier"])

    def _pack(self, wanted: ExportView, options: Sequence[str]) -> None:
        self.exported = wanted
        self._submit(wanted.what, ChoreKind.EXPORT, *options, *self._wanted.options)

    def frames(self, run: Path, at: float, done: Callable[[str, str], None]) -> None:
        """Write what the cameras saw `at` s from the start of a run into its folder.

        `done` gets the folder with the files, or why there are none; in another thread.
        """
        folder, name = run.absolute() / FRAMES_FOLDER, f"frames at {at:.3f}"
        self._frames[name] = lambda why: done("" if why else str(folder), why)
        self._submit(name, ChoreKind.PICTURES, str(run.absolute()), f"{at:.3f}", str(folder))

    @property
    def problem(self) -> str | None:
        """Why reports could not be made, in words; None when the last one could, and all before."""
        unmade = [*(one.words for one in self._unmade.values()), *[self._lost] * bool(self._lost)]
        if not unmade:
            return None
        others = f" ({len(unmade) - 1} more wait)" if len(unmade) > 1 else ""
        return unmade[-1] + others

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; whether everything is made, or pauses after a failure."""
        end = time.monotonic() + patience
        while (waits := any(one.due_now for one in self.workers)) and time.monotonic() < end:
            time.sleep(0.02)
        return not waits

    def finish(self) -> None:
        """Ignore runs from now on, and wait for `CLOSING_TIME`; the rest goes on by itself."""
        for worker in self.workers:
            worker.ignore_runs()
        self.wait(CLOSING_TIME)

    def _submit(self, name: str, kind: ChoreKind, *arguments: str) -> None:
        self._pages.submit(Chore(name, kind, arguments))

    # ------------------------------------------------------------------ the supervisor's thread

    def _lose(self, what: str, why: str) -> None:
        self._lost = f"no {what}: {why}"
        if self.exported is not None and not self.exported.path:
            self.exported = replace(self.exported, problem=why)

    def _hear(self, finished: Finished) -> None:
        self._lost = ""
        chore, why, said = finished.chore, finished.why_not, finished.said
        if chore.kind is ChoreKind.EXPORT:
            if self.exported is not None and self.exported.what == chore.name:  # the latest wanted
                path = said if said.endswith(".zip") else ""
                self.exported = replace(self.exported, path=path, problem=why)
            return
        if chore.kind is ChoreKind.PICTURES:
            if (done := self._frames.pop(chore.name, None)) is not None:
                done(why)
            return
        for folder in finished.missing:
            name = f"report {Path(folder).name}"
            self._pages.submit(Chore(name, ChoreKind.MISSING, (folder,)), anew=False)
        if said == str(chore.place / INDEX_PAGE):
            why = ""  # the pages are there, and name what cannot be read
        unmade = {
            name: one
            for name, one in self._unmade.items()
            if name != chore.name and (one.again or one.kind is not chore.kind)
        }
        if why:
            words = _UNMADE[chore.kind].format(place=chore.place, why=why)
            unmade[chore.name] = _Unmade(chore.kind, words, finished.again)
        self._unmade = unmade  # a new one, not changed: others read it meanwhile
