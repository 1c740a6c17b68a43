"""Writes the current run's journal into its open folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import OpenFolder
from madrob_console.engine.runtime.disk import DiskJobs, why_not
from madrob_console.referee.journal import Entry, Journal, read_journal, refusal_words, up_to_date


class JournalLine:
    """A line on its way to the journal on disk.

    With `done` it is an act's: it takes effect once it is on disk, unless it is withdrawn before.
    Kept or withdrawn: whichever of disk thread and core acts first wins. `done` gets None when
    the line is on disk, or the disk's refusal in words; it is not called for a withdrawn line.
    """

    def __init__(self, entry: Entry, done: Callable[[str | None], None] | None = None) -> None:
        self.entry = entry
        self.done = done
        self.added = 0.0  # to what waits for the disk, s of the monotonic clock
        self.withdrawal: Entry | None = None
        self._effect: Future[None] = Future()

    @property
    def withdrawn(self) -> bool:
        return self._effect.cancelled()

    def keep(self) -> bool:
        """Take effect, once: the line is on disk. False if it was withdrawn before."""
        return self._effect.set_running_or_notify_cancel()

    def withdraw(self, withdrawal: Entry) -> bool:
        """Cancel the effect; False if the line is on disk already and takes effect."""
        self.withdrawal = withdrawal
        return self._effect.cancel()


class OpenJournal:
    """The journal file of one run, in its open folder. Everything in it waits for the disk.

    `keeps_folder`: the folder is closed with the journal.
    """

    def __init__(self, folder: OpenFolder, journal: Journal, lines: Iterable[Entry]) -> None:
        self.folder = folder
        self.keeps_folder = True
        self._journal = journal
        self._lines = list(lines)

    @property
    def lines(self) -> Sequence[Entry]:
        """Those that are on disk."""
        return self._lines

    @property
    def _path(self) -> Path:
        return self.folder.inside / JOURNAL_FILE

    @classmethod
    def create(cls, folder: OpenFolder, lines: Sequence[Entry]) -> OpenJournal:
        journal, path = Journal(), folder.inside / JOURNAL_FILE
        try:
            journal.open(path)
            journal.append(lines)
            if (error := journal.refused) is None:
                return cls(folder, journal, lines)
            with suppress(OSError):
                path.unlink()
        except OSError as refused:
            error = refused
        journal.close()
        folder.close()
        raise MadrobError(f"{refusal_words(error)}: {_REMEDY}")

    @classmethod
    def reopen(cls, path: Path, lines: Sequence[Entry]) -> OpenJournal:
        """Go on with the journal of an earlier run; its lines are written where there is none.

        Raises:
            MadrobError: another program wrote it since it was read, or the disk refuses.
        """
        journal = Journal()
        with ExitStack() as undo:
            try:
                folder = OpenFolder(path)
                undo.callback(folder.close)
                undo.callback(journal.close)  # first: its lock goes by way of the folder
                file = folder.inside / JOURNAL_FILE
                try:
                    journal.reopen(file)
                except FileNotFoundError:
                    undo.pop_all()
                    return cls.create(folder, lines)
                entries, _ = read_journal(file)
            except BlockingIOError:
                raise MadrobError(f"{path.name}: another console works on this run") from None
            except OSError as error:
                raise MadrobError(
                    f"{path / JOURNAL_FILE}: cannot be written ({error.strerror}); `madrob score` "
                    "reads such a run"
                ) from None
            if entries and entries != tuple(lines):  # without lines the bag was read instead
                raise MadrobError(f"{path.name}: was changed meanwhile: open it once more")
            undo.pop_all()
        return cls(folder, journal, lines)

    def append(self, lines: Sequence[Entry], *, again: bool) -> tuple[int, str | None]:
        """Add lines, if any; a journal that was deleted is written anew.

        Returns how many are on disk, and why not all, or that the folder is not where its name
        says. `again`: the disk refused before.
        """
        count = self._journal.append(lines)
        problem = None if (error := self._journal.refused) is None else refusal_words(error)
        deleted = not os.path.lexists(self._path)
        if deleted or (problem is not None and again):
            with suppress(OSError):  # what is written below says why
                self.folder.open_again()
            try:
                journal = up_to_date(self._path, (*self._lines, *lines), self._journal)
            except (OSError, MadrobError) as refused:
                if deleted:
                    why = refused.strerror if isinstance(refused, OSError) else refused
                    count, problem = 0, f"the journal was deleted, a new one is refused ({why})"
            else:
                self._journal.close()
                self._journal = journal
                count, problem = len(lines), None
        self._lines += lines[:count]
        return count, problem or self.folder.problem()

    def close(self) -> None:
        self._journal.close()
        if self.keeps_folder:
            self.folder.close()


_REMEDY = "see to the disk, then try again"


class JournalWriter:
    """Has the lines of one run after the other written; what the disk refuses waits.

    Lines that come while the disk is busy are written together, by one sync.
    """

    def __init__(self, disk: DiskJobs, monotonic: Callable[[], float]) -> None:
        self._disk = disk
        self._monotonic = monotonic
        self._file: OpenJournal | None = None
        self._waiting: tuple[JournalLine, ...] = ()
        self._problem: str | None = None
        self._busy = False

    def leave_journal(self) -> None:
        """Close the journal; lines that come from now on wait for the next one."""
        self.close()
        self._waiting, self._problem = (), None

    @property
    def folder(self) -> OpenFolder:
        """The folder of the current run, which has begun."""
        assert self._file is not None
        return self._file.folder

    def hand_over_folder(self) -> OpenFolder:
        """The folder stays open when the journal is left: who gets it closes it."""
        assert self._file is not None
        self._file.keeps_folder = False
        return self._file.folder

    @property
    def problem(self) -> str | None:
        if self._problem is None or not self._waiting:
            return self._problem
        return f"{self._problem}: {len(self._waiting)} lines wait"

    @property
    def unwritten(self) -> tuple[int, float]:
        """How many lines are not on disk, and for how long, s. From any thread."""
        waiting = self._waiting
        if self._file is None or not waiting:
            return 0, 0.0
        return len(waiting), self._monotonic() - waiting[0].added

    def adopt(self, file: OpenJournal, entries: Sequence[Entry]) -> None:
        """Go on in a journal that has these `entries`, with the lines that wait for it."""
        waiting = [
            line for line in self._waiting if not any(line.entry is each for each in entries)
        ]
        self.leave_journal()
        self._file, self._waiting = file, tuple(waiting)
        self._write()

    def close(self) -> None:
        if self._file is not None:
            self._disk.submit_job(self._file.close)
        self._file, self._busy = None, False

    def add_line(self, line: JournalLine) -> None:
        """Have a line written."""
        line.added = self._monotonic()
        self._waiting += (line,)
        self._write()

    def catch_up(self) -> None:
        """Retry what waits; a journal that was deleted is written anew."""
        self._write(again=True)

    def _write(self, *, again: bool = False) -> None:
        file, lines = self._file, self._waiting
        if file is None or self._busy or not (lines or again):
            return
        self._busy = True

        def job() -> tuple[Sequence[JournalLine], str | None]:
            wanted = [line for line in lines if not line.withdrawn]
            count, problem = file.append([line.entry for line in wanted], again=again)
            return [line for line in wanted[:count] if line.keep()], problem

        def done(answer: Future[tuple[Sequence[JournalLine], str | None]]) -> None:
            if file is self._file:
                written, problem = ((), why) if (why := why_not(answer)) else answer.result()
                self._take_answer(lines, written, problem)

        self._disk.submit_job(job, done)

    def _take_answer(
        self, lines: Sequence[JournalLine], written: Sequence[JournalLine], problem: str | None
    ) -> None:
        self._busy, self._problem = False, problem
        over = [line for line in lines if line in written or line.done is not None]
        self._waiting = tuple(
            line for line in self._waiting if line not in over and not line.withdrawn
        )
        for line in over:
            if line.done is not None and not line.withdrawn:
                line.done(None if line in written else f"{problem}: {_REMEDY}")
        if problem is None or any(line.done is not None for line in self._waiting):
            self._write()  # an act's line is tried at once: it has 2 s
