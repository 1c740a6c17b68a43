"""The journal of the run at hand: its lines on their way to the disk, and what waits for them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

from madrob_console.engine.live.keeper import Keeper, why_not
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import (
    LARGEST_JOURNAL,
    MOST_LINES,
    Entry,
    Journal,
    read_journal,
    refusal_words,
    up_to_date,
)
from madrob_console.referee.journal_mark import GrowingMark
from madrob_console.referee.on_record import JournalMark


class Promise:
    """A line that takes effect once it is on disk, unless it is withdrawn before.

    Whoever comes first decides, the keeper or the core, and nobody ever again.

    Args:
        entry: the line.

    Attributes:
        withdrawal: the line that takes it back; None = it stands.
    """

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.withdrawal: Entry | None = None
        self._decision = threading.Lock()
        self._kept = False

    def keep(self) -> bool:
        """It is on disk; False if it was withdrawn before."""
        with self._decision:
            self._kept = self.withdrawal is None
            return self._kept

    def withdraw(self, withdrawal: Entry) -> bool:
        """It shall have no effect; False if it is on disk already, and will have."""
        with self._decision:
            if not self._kept:
                self.withdrawal = self.withdrawal or withdrawal
            return not self._kept

    @property
    def withdrawn(self) -> bool:
        """Whether it was withdrawn."""
        return self.withdrawal is not None


class OpenJournal:
    """The journal file of one run. Everything in it waits for the disk: a keeper's part.

    Args:
        path: its file.
        journal: open on it.
        lines: those that it has.
    """

    def __init__(self, path: Path, journal: Journal, lines: Iterable[Entry]) -> None:
        self._path = path
        self._journal = journal
        self._lines = list(lines)

    @classmethod
    def create(cls, path: Path, lines: Sequence[Entry]) -> OpenJournal:
        """Make the file with its first lines, or none.

        Raises:
            MadrobError: the disk refuses.
        """
        journal = Journal()
        try:
            journal.open(path)
            if journal.append(lines) == len(lines):
                return cls(path, journal, lines)
            error = journal.refused
        except OSError as refused:
            error = refused
        else:
            with suppress(OSError):
                path.unlink()
        journal.close()
        assert error is not None
        raise MadrobError(f"{refusal_words(error)}: {_REMEDY}")

    @classmethod
    def reopen(cls, path: Path, lines: Sequence[Entry]) -> OpenJournal:
        """Go on with the journal of an earlier run; its lines are written where there is none.

        Args:
            path: its file.
            lines: those that the run was read with, which took a while.

        Raises:
            MadrobError: another program writes it or did so since, or the disk refuses.
        """
        journal = Journal()
        try:
            try:
                journal.reopen(path)
            except FileNotFoundError:
                return cls.create(path, lines)
            found, _ = read_journal(path)
        except BlockingIOError:
            raise MadrobError(f"{path.parent.name}: another console works on this run") from None
        except OSError as error:
            journal.close()
            raise MadrobError(
                f"{path}: cannot be written ({error.strerror}); `madrob score` reads such a run"
            ) from None
        if found and found != tuple(lines):  # one without lines says nothing: the bag was read
            journal.close()
            raise MadrobError(f"{path.parent.name}: was changed meanwhile: open it once more")
        return cls(path, journal, lines)

    def append(self, lines: Sequence[Entry], *, again: bool) -> tuple[int, str | None]:
        """Add lines; a journal that was deleted is written anew.

        Args:
            lines: to be added; there may be none.
            again: the disk refused before; it may be another one that is there now.

        Returns:
            How many of them are on disk, and why not all, in words.
        """
        count, problem = 0, None
        deleted = self._deleted()
        if not deleted:
            count = self._journal.append(lines)
            self._lines += lines[:count]
            problem = None if count == len(lines) else self._refusal()
            deleted = self._deleted()
        if not deleted and (problem is None or not again):
            return count, problem
        rest = lines[count:]
        try:
            journal = up_to_date(self._path, (*self._lines, *rest), self._journal)
        except (OSError, MadrobError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            gone = f"the journal was deleted, a new one is refused ({why})"
            return count, problem or gone
        self._journal.close()
        self._journal = journal
        self._lines += rest
        return len(lines), None

    def _deleted(self) -> bool:
        return not os.path.lexists(self._path)

    def _refusal(self) -> str:
        assert self._journal.refused is not None
        return refusal_words(self._journal.refused)

    def close(self) -> None:
        """Close the file."""
        self._journal.close()


class _Line:
    """A line that is not on disk yet.

    Attributes:
        entry: the line.
        added: when it was, s of a monotonic clock.
        promise: what it decides; None = it takes effect whatever the disk says.
        done: told when that is decided by the disk: why not, in words, or None.
    """

    __slots__ = ("added", "done", "entry", "promise")

    def __init__(
        self,
        entry: Entry,
        added: float,
        promise: Promise | None = None,
        done: Callable[[str | None], None] | None = None,
    ) -> None:
        self.entry = entry
        self.added = added
        self.promise = promise
        self.done = done


_REMEDY = "see to the disk, then try again"

_Written = tuple[list[_Line], str | None]


class JournalKeeper:
    """Hands the lines of one run after the other to a keeper; what the disk refuses waits.

    Those that come while the disk is busy are written together, by one sync.

    Args:
        keeper: writes them.
        monotonic: a clock, s.
    """

    def __init__(self, keeper: Keeper, monotonic: Callable[[], float]) -> None:
        self._keeper = keeper
        self._monotonic = monotonic
        self._file: OpenJournal | None = None
        self._busy = False
        self._problem: str | None = None
        self._entries: list[Entry] = []
        self._mark = GrowingMark()
        self._size = 0  # bytes of these lines
        self._waiting: tuple[_Line, ...] = ()

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Every line of the run at hand that stands, on disk or not."""
        return tuple(self._entries)

    @property
    def mark(self) -> JournalMark:
        """Of all these lines."""
        return self._mark.mark

    @property
    def full(self) -> bool:
        """Whether half is used of what readers of a journal take; the rest is for the run's end."""
        return 2 * len(self._entries) > MOST_LINES or 2 * self._size > LARGEST_JOURNAL

    @property
    def problem(self) -> str | None:
        """Why the disk refuses lines, in words; None when it does not."""
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

    def begin(self) -> None:
        """Another run: its lines wait for its file."""
        self.close()
        self._entries, self._waiting, self._problem = [], (), None
        self._mark, self._size = GrowingMark(), 0

    def adopt(self, file: OpenJournal, entries: Iterable[Entry]) -> None:
        """Go on in a file.

        Args:
            file: of the run at hand.
            entries: the lines that it has.
        """
        known = list(entries)
        self._waiting = tuple(
            one for one in self._waiting if not any(one.entry is entry for entry in known)
        )
        self._entries, self._mark, self._size = [], GrowingMark(), 0
        for entry in (*known, *(one.entry for one in self._waiting)):
            self._stands(entry)
        self._file, self._busy = file, False
        self._write()

    def close(self) -> None:
        """Have the file closed when it has what was handed over."""
        if self._file is not None:
            self._keeper.ask(self._file.close)
        self._file, self._busy = None, False

    def add(self, entry: Entry) -> None:
        """Add a line that takes effect whatever the disk says."""
        self._stands(entry)
        self._waiting += (_Line(entry, self._monotonic()),)
        self._write()

    def promise(self, promise: Promise, done: Callable[[str | None], None]) -> None:
        """Add a line that takes effect when it is on disk.

        Args:
            promise: the line.
            done: told when it is, with None, or at once why the disk refuses it, in words; not
                when it is withdrawn.
        """
        self._waiting += (_Line(promise.entry, self._monotonic(), promise, done),)
        self._write()

    def catch_up(self) -> None:
        """Try again to write what waits; a journal that was deleted is written anew."""
        self._write(again=True)

    def _stands(self, entry: Entry) -> None:
        self._entries.append(entry)
        self._size += len(entry.to_json()) + 1
        self._mark.add(entry)

    def _write(self, *, again: bool = False) -> None:
        file, lines = self._file, self._waiting
        if file is None or self._busy or not (lines or again):
            return
        self._busy = True

        def job() -> _Written:
            wanted = [one for one in lines if one.promise is None or not one.promise.withdrawn]
            count, problem = file.append([one.entry for one in wanted], again=again)
            for one in wanted[:count]:
                if one.promise is not None:
                    one.promise.keep()
            return wanted[:count], problem

        def done(answer: Future[_Written]) -> None:
            if file is self._file:
                self._heard(lines, answer)

        self._keeper.ask(job, done)

    def _heard(self, lines: Sequence[_Line], answer: Future[_Written]) -> None:
        self._busy = False
        written: Sequence[_Line] = ()
        self._problem = why_not(answer)
        if self._problem is None:
            written, self._problem = answer.result()
        kept = [one for one in written if one.promise is not None and not one.promise.withdrawn]
        refused = [
            one
            for one in (lines if self._problem is not None else ())
            if one not in written and one.promise is not None and not one.promise.withdrawn
        ]
        gone = [*written, *refused]
        self._waiting = tuple(
            one
            for one in self._waiting
            if one not in gone and not (one.promise is not None and one.promise.withdrawn)
        )
        for one in kept:
            assert one.done is not None
            self._stands(one.entry)
            one.done(None)
        for one in refused:
            assert one.done is not None
            one.done(f"{self._problem}: {_REMEDY}")
        if self._problem is None or any(one.promise is not None for one in self._waiting):
            self._write()  # what waits for nothing else is refused by the disk itself
