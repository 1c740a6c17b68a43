"""Reports, pages and zips: a queue of chores on disk, worked off by a process of low priority."""

from __future__ import annotations

import fcntl
import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import msgspec

from madrob_console.archive.folders import FRAMES_FOLDER, INDEX_PAGE
from madrob_console.common.names import terminal_safe
from madrob_console.engine.snapshot import ExportView
from madrob_console.engine.supervisor import Worker
from madrob_console.engine.wire import decoded

QUEUE_FOLDER = ".madrob_queue"
"""In a results folder: a file for each chore that waits."""

PAUSE = 10.0
"""Pause before a chore is retried, s."""

CLOSING_TIME = 3.0
"""An engine that ends waits this long for unfinished chores, s; they go on without it, too."""


class ChoreKind(StrEnum):
    """What a chore is; its arguments follow in the command."""

    REPORT = "report"
    """Make the report of a run anew: its folder follows."""
    RENEW = "renew"
    """Make outdated reports again: a results folder follows."""
    REPAIR = "repair"
    """Make results again that differ from their journals, then outdated reports: a results folder
    follows.
    """
    PUBLISH = "publish"
    """`madrob publish`: a folder for the pages and where the runs are follow."""
    EXPORT = "export"
    """`madrob export`: the options follow."""
    PICTURES = "pictures"
    """Write the frames of an instant: a run, the instant and a folder follow."""
    COMMAND = "command"
    """The command of [results]: the folder of a run and the command's words follow."""


class Chore(msgspec.Struct, frozen=True):
    """A chore replaces a waiting one of the same name."""

    name: str
    kind: ChoreKind
    arguments: tuple[str, ...]


class ChoreQueue:
    """The chores that wait, as files in a folder: they survive the engine.

    A file's name says when it was put there, its time when it is due.
    """

    def __init__(self, folder: Path, pause: float = PAUSE) -> None:
        self._folder = folder
        self._pause = pause
        self._taken: Path | None = None

    def put(self, chore: Chore) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        part = self._folder / f"{time.time_ns()}.part"
        with part.open("wb") as file:
            file.write(msgspec.json.encode(chore))
            file.flush()
            os.fsync(file.fileno())  # else a power cut tears it
        part.replace(part.with_suffix(".json"))

    def hold(self) -> None:
        """Wait until no other process works the queue off; for the rest of this process."""
        self._folder.mkdir(parents=True, exist_ok=True)
        fcntl.flock(os.open(self._folder, os.O_RDONLY | os.O_CLOEXEC), fcntl.LOCK_EX)

    def take_next(self) -> Chore | None:
        """The chore that waits for longest, as it was put last; None where none is due.

        It is due again after the pause, should this process end before it is finished.
        """
        waiting: dict[str, list[tuple[Path, Chore]]] = {}
        for path in sorted(self._folder.glob("*.json")):
            try:
                chore = msgspec.json.decode(path.read_bytes(), type=Chore)
            except msgspec.MsgspecError:  # of a power cut: what it asked for is found by the repair
                path.unlink()
                continue
            waiting.setdefault(chore.name, []).append((path, chore))
        for *superseded, (path, chore) in waiting.values():
            for earlier, _ in superseded:
                earlier.unlink()
            if self._rest(path) == 0:
                self._set_due(path, self._pause)
                self._taken = path
                return chore
        return None

    def finish(self) -> None:
        """The chore that was taken is done; what was put meanwhile stays."""
        if self._taken is not None:
            self._taken.unlink()
        self._taken = None

    def give_back(self) -> None:
        """The chore that was taken, if one was, is due at once."""
        if self._taken is not None:
            self._set_due(self._taken, 0.0)

    @property
    def rest(self) -> float:
        """Time until a chore is due, s; infinite where none waits."""
        return min(map(self._rest, self._folder.glob("*.json")), default=math.inf)

    def _set_due(self, path: Path, pause: float) -> None:
        due = time.time() + pause
        os.utime(path, (due, due))

    def _rest(self, path: Path) -> float:
        rest = path.stat().st_mtime - time.time()
        return rest if 0 < rest <= self._pause else 0.0  # the clock may have been set back


# What crosses the socket between the engine and the process.


class Look(msgspec.Struct, frozen=True, tag=True):
    """Look at the queue: `number` chores have been put into it by now."""

    number: int


class Finished(msgspec.Struct, frozen=True, tag=True):
    """Outcome of a chore.

    Attributes:
        code: its exit code.
        said, complained: the last line that it printed, as output and as an error.
    """

    chore: Chore
    code: int
    said: str
    complained: str

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


class Resting(msgspec.Struct, frozen=True, tag=True):
    """Nothing is due for `rest` s; `number` is that of the last `Look`."""

    number: int
    rest: float


_answers: msgspec.msgpack.Decoder[Finished | Resting] = msgspec.msgpack.Decoder(Finished | Resting)


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
    ChoreKind.RENEW: "reports of {place} are older than its results: {why}",
    ChoreKind.PUBLISH: "the pages in {place} are not up to date: {why}",
    ChoreKind.REPAIR: "{why}",
    ChoreKind.COMMAND: "the command of [results] failed: {why}",
}
"""What screens show of a chore that was not done."""


class _Unmade(NamedTuple):
    kind: ChoreKind
    words: str
    again: bool


class Reporting(Worker):
    """Has reports, pages and zips made in the background, never during a run.

    Args:
        command: the program that works off the queue (`madrob_console.cli.aside`).
        queue: the folder of the `ChoreQueue`.
        results: the results folder.
        busy: whether a run goes on; may be asked from any thread.
        write: has a job done that writes a file, and never waits for it.
        pause: before a chore is retried, s.
    """

    def __init__(
        self,
        command: Sequence[str],
        queue: Path,
        results: Path,
        busy: Callable[[], bool],
        write: Callable[[Callable[[], None]], Future[None]],
        wanted: WantedPages = EVERY_REPORT,
        pause: float = PAUSE,
    ) -> None:
        super().__init__((*command, str(queue), str(pause)))
        self.exported: ExportView | None = None
        self._results = results
        self._queue = ChoreQueue(queue, pause)
        self._busy = busy
        self._write = write
        self._wanted = wanted
        self._what = "reports, pages and zips"
        self._hook: Reporting | None = None  # a process of its own: a command may hang
        if wanted.command:
            self._hook = Reporting(command, queue / "hook", results, busy, write, pause=pause)
            self._hook._what = "command of [results]"
        self._unmade: dict[str, _Unmade] = {}
        self._frames: dict[str, Callable[[str], None]] = {}
        self._closing = False
        self._asked = self._put = self._looked = 0
        self._due = math.inf

    @property
    def workers(self) -> tuple[Worker, ...]:
        """For the supervisor."""
        return (self,) if self._hook is None else (self, self._hook)

    def report(self, folder: Path) -> None:
        """Make the report of a run anew, if it is wanted; the latest result counts.

        Then the reports of runs that are compared with it, and the competition's pages. Beside
        them the command of the settings is run.
        """
        if self._hook is not None:
            arguments = (str(folder.absolute()), *self._wanted.command)
            self._hook._submit(f"command {folder.name}", ChoreKind.COMMAND, *arguments)
        if self._wanted.reports:
            self._submit(f"report {folder.name}", ChoreKind.REPORT, str(folder))
        self._submit("renew", ChoreKind.RENEW, str(self._results))
        self.publish()

    def publish(self) -> None:
        if self._wanted.publish:
            self._submit("publish", ChoreKind.PUBLISH, *self._wanted.publish)

    def repair(self) -> None:
        """Make results and reports again that a power cut left out of date, then the pages.

        What an earlier engine left in the queues goes on, too.
        """
        if self._hook is not None:
            self._hook._due = 0.0
            self._hook.ring()
        self._submit("repair", ChoreKind.REPAIR, str(self._results))
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
        hook = {} if self._hook is None else self._hook._unmade
        unmade = (*hook.values(), *self._unmade.values())
        if not unmade:
            return None
        others = f" ({len(unmade) - 1} more wait)" if len(unmade) > 1 else ""
        return unmade[-1].words + others

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; whether everything is made, or pauses after a failure."""
        end = time.monotonic() + patience
        while (waits := self._waits) and time.monotonic() < end:
            time.sleep(0.02)
        return not waits

    @property
    def _waits(self) -> bool:
        if self._hook is not None and self._hook._waits:
            return True
        return self._put < self._asked or self._due <= time.monotonic()

    def finish(self, patience: float = CLOSING_TIME) -> None:
        """Ignore runs from now on, and wait at most `patience` s; the rest goes on by itself."""
        for one in (self, self._hook):
            if one is not None:
                one._closing = True
        self.ring()
        self.wait(patience)

    def _submit(self, name: str, kind: ChoreKind, *arguments: str) -> None:
        self._asked += 1
        chore = Chore(name, kind, arguments)

        def written(answer: Future[None]) -> None:
            if (error := answer.exception()) is not None:
                self._hear(Finished(chore, os.EX_IOERR, "", str(error)))
            self._put += 1
            self._due = 0.0
            self.ring()

        self._write(lambda: self._queue.put(chore)).add_done_callback(written)

    # ------------------------------------------------------------------ the supervisor's thread

    @property
    def wanted(self) -> bool:
        return time.monotonic() >= self._due and (self._closing or not self._busy())

    @property
    def goes_on(self) -> bool:
        return not self._busy()  # a run ends it

    def begin(self) -> None:
        self._looked = 0

    def work(self, now: float) -> float:
        if self.pid is not None and self._looked < self._put:
            self._looked = self._put
            self.send(Look(self._looked))
        return 0.1  # s: a run may begin, or end

    def take(self, data: memoryview) -> None:
        told = decoded(_answers, data, "a message of the process that makes reports")
        self._unmade = {name: one for name, one in self._unmade.items() if name}
        if isinstance(told, Finished):
            self._hear(told)
            return
        self._due = time.monotonic() + told.rest
        if told.number < self._put:
            self._due = 0.0  # it looks again

    def lose(self, why: str) -> None:
        if not self._waits:
            return
        why = f"{why}; it is tried again"
        words = f"no {self._what}: {why}"
        self._unmade = {**self._unmade, "": _Unmade(ChoreKind.REPAIR, words, again=True)}
        if self.exported is not None and not self.exported.path:
            self.exported = replace(self.exported, problem=why)

    def _hear(self, finished: Finished) -> None:
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
        place = Path(chore.arguments[0])
        if said == str(place / INDEX_PAGE):
            why = ""  # the pages are there, and name what cannot be read
        unmade = {
            name: one
            for name, one in self._unmade.items()
            if name != chore.name and (one.again or one.kind is not chore.kind)
        }
        if why:
            words = _UNMADE[chore.kind].format(place=place, why=why)
            unmade[chore.name] = _Unmade(chore.kind, words, finished.again)
        self._unmade = unmade  # a new one, not changed: others read it meanwhile
