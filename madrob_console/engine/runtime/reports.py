"""Reports, pages and zips: made in the background by a process of low priority.

The list of chores is in memory alone. An engine that starts makes it anew from the results: no file
in a results folder says what is done.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from madrob_console.archive.folders import FRAMES_FOLDER, INDEX_PAGE
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.engine_interface import fail
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


_URGENCY = {kind: number for number, kind in enumerate(ChoreKind)}


@dataclass(frozen=True, slots=True)
class Chore:
    """What the engine asks of the process; it replaces a waiting one of the same name."""

    name: str
    kind: ChoreKind
    arguments: tuple[str, ...]

    @property
    def place(self) -> Path:
        """The folder that it is for: of a run, of results or of the pages."""
        return Path(self.arguments[0])


class ChoreOutcome(msgspec.Struct, frozen=True):
    """The outcome of a chore.

    Attributes:
        code: its exit code.
        output, error: the last line that it printed, as output and as an error.
        missing: the folders of runs without a report, the newest first.
    """

    code: int
    output: str = ""
    error: str = ""
    missing: tuple[str, ...] = ()

    @property
    def is_retried(self) -> bool:
        """Whether it lacked its process, memory, file handles or a disk."""
        return self.code == os.EX_TEMPFAIL

    @property
    def problem(self) -> str:
        """Why it was not done, in words; empty = it was."""
        if not self.code:
            return ""
        why = terminal_safe(self.error).removeprefix("madrob: ")
        why = why or f"its process ended with {self.code}"
        return f"{why}; it is tried again" if self.is_retried else why


_FINISHED = msgspec.msgpack.Decoder(ChoreOutcome)


class ChoreWorker(Worker):
    """Has chores done by a process, one after the other, never while it is `held` for a run.

    Args:
        command: starts the process.
        work: what it makes, in words.
    """

    patience = math.inf  # a chore may wait for others

    def __init__(self, command: Sequence[str], work: str) -> None:
        super().__init__(command)
        self.loss = f"no {work}"
        self.held = False

    def hold(self, *, held: bool) -> None:
        """End the current chore, and begin no other one until `held` is false."""
        if held != self.held:
            self.held = held
            self.ring()

    def finish_alone(self) -> None:
        """The engine is about to end: what waits goes on without it."""
        self.most_sent = math.inf
        self.ring()

    @property
    def wanted(self) -> bool:
        may_begin = not self.held or self.most_sent > 1  # no run begins any more
        return may_begin and bool(self.due_questions())

    @property
    def goes_on(self) -> bool:
        return not self.held


@dataclass(frozen=True, slots=True)
class WantedPages:
    """Pages that are made without a command.

    Attributes:
        reports: whether a run's report is made after each of its results.
        publish: of `madrob publish`, after each result; empty = no pages are wanted.
        options: of `madrob export`: results folder, settings.
    """

    reports: bool = True
    publish: Sequence[str] = ()
    options: Sequence[str] = ()


EVERY_REPORT = WantedPages()

_UNMADE = {
    ChoreKind.REPORT: "no report of {place.name}: {why}; `madrob report` makes it",
    ChoreKind.MISSING: "no report of {place.name}: {why}",
    ChoreKind.PUBLISH: "the pages in {place} are not up to date: {why}",
    ChoreKind.REPAIR: "results or reports in {place} are not up to date: {why}",
}
"""What screens show of a chore that was not done."""


class _Unmade(NamedTuple):
    kind: ChoreKind
    words: str
    is_retried: bool


class Reporting:
    """Has reports, pages and zips made in the background.

    A chore that a run, a crash or a full disk cut short is done again.

    Args:
        command: the program that does it (`madrob_console.cli.chore_worker`).
        results: the results folder.
        pause: before a chore is retried, s.
    """

    def __init__(
        self,
        command: Sequence[str],
        results: Path,
        wanted: WantedPages = EVERY_REPORT,
        pause: float = PAUSE,
    ) -> None:
        self.exported: ExportView | None = None
        self._results = results
        self._wanted = wanted
        self._retry_pause = pause
        self._unmade: dict[str, _Unmade] = {}
        self._lock = threading.Lock()  # of `_unmade`, for those who change it
        self._pages = ChoreWorker(command, "reports, pages and zips")
        self.workers = (self._pages,)

    def hold(self, *, held: bool) -> None:
        """Make nothing while a run goes on. From any thread."""
        for worker in self.workers:
            worker.hold(held=held)

    def report(self, folder: Path) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts.

        Then all else that is out of date, as reports of runs that are compared with it.
        """
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

    def frames(self, run: Path, at: float) -> Future[str]:
        """Write what the cameras saw `at` s from the start of a run into its folder.

        The answer is the folder with the files; it fails with why there are none.
        """
        folder, written = run.absolute() / FRAMES_FOLDER, Future[str]()

        def answer(finished: Future[ChoreOutcome]) -> None:
            outcome = _outcome(finished)
            if outcome.problem:
                fail(written, outcome.problem)
            else:
                with suppress(InvalidStateError):  # it was given up
                    written.set_result(str(folder))

        words = (str(run.absolute()), f"{at:.3f}", str(folder))
        chore = Chore(f"frames at {at:.3f}", ChoreKind.PICTURES, words)
        self._pages.ask(chore, _FINISHED).add_done_callback(answer)
        return written

    @property
    def problem(self) -> str | None:
        """Why reports could not be made, in words; None when the last one could, and all before."""
        unmade = [each.words for each in self._unmade.values()]
        if not unmade:
            return None
        others = f" ({len(unmade) - 1} more wait)" if len(unmade) > 1 else ""
        return unmade[-1] + others

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; whether everything is made, or pauses after a failure."""
        end = time.monotonic() + patience
        while (left := any(w.due_questions() for w in self.workers)) and time.monotonic() < end:
            time.sleep(0.02)
        return not left

    def finish(self) -> None:
        """Ignore further runs, wait for `CLOSING_TIME`; the workers finish alone."""
        for worker in self.workers:
            worker.finish_alone()
        self.wait(CLOSING_TIME)

    def _submit(
        self, name: str, kind: ChoreKind, *arguments: str, pause: float = 0.0, anew: bool = True
    ) -> None:
        """Have a chore done, `anew` in place of one of this name that waits."""
        worker = self._pages
        before = [each.answer for each in worker.questions() if each.content.name == name]
        if not anew and (worker.is_over or not all(answer.done() for answer in before)):
            return  # what an engine that ends leaves unmade the next one makes
        for answer in before:
            answer.cancel()
        chore, due = Chore(name, kind, arguments), time.monotonic() + pause
        worker.ask(chore, _FINISHED, due=due, urgency=_URGENCY[kind], retries=0).add_done_callback(
            partial(self._note_outcome, chore)
        )

    def _note_outcome(self, chore: Chore, answer: Future[ChoreOutcome]) -> None:
        """In the worker's thread."""
        if answer.cancelled():
            return
        finished = _outcome(answer)
        why, lost = finished.problem, answer.exception() is not None
        if self.exported is not None and self.exported.what == chore.name:  # the latest wanted
            path = finished.output if finished.output.endswith(".zip") else ""
            self.exported = replace(self.exported, path=path, problem=why)
        for folder in finished.missing:
            self._submit(f"report {Path(folder).name}", ChoreKind.MISSING, folder, anew=False)
        if finished.output == str(chore.place / INDEX_PAGE):
            why = ""  # the pages are there, and name what cannot be read
        with self._lock:
            unmade = {
                name: each
                for name, each in self._unmade.items()
                if name != chore.name and (each.is_retried or each.kind is not chore.kind)
            }
            if why and (lost or chore.kind is not ChoreKind.EXPORT):
                words = why if lost else _UNMADE[chore.kind].format(place=chore.place, why=why)
                unmade[chore.name] = _Unmade(chore.kind, words, finished.is_retried)
            self._unmade = unmade  # a new one, not changed: others read it meanwhile
        if finished.is_retried:
            pause = self._retry_pause
            self._submit(chore.name, chore.kind, *chore.arguments, pause=pause, anew=False)


def _outcome(answer: Future[ChoreOutcome]) -> ChoreOutcome:
    """A chore whose process was lost is retried."""
    lost = answer.exception()
    return answer.result() if lost is None else ChoreOutcome(os.EX_TEMPFAIL, error=str(lost))
