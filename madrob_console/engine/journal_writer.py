"""Writes the current run's journal, and holds its folder and bag."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import RunName, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.engine.disk import DiskJobs, Reader, why_not
from madrob_console.engine.snapshot import RecorderView
from madrob_console.referee.journal import (
    LARGEST_JOURNAL,
    MOST_LINES,
    Entry,
    Journal,
    read_journal,
    refusal_words,
    up_to_date,
)
from madrob_console.referee.rebuild import GrowingMark
from madrob_console.referee.records import JournalMark
from recorder.bag import RawMessage, Topic
from recorder.errors import RecorderError
from recorder.writer import BagSummary, BagWriter, DropReason, RecorderState


class Promise:
    """A line that takes effect once it is on disk, unless it is withdrawn before.

    The first to decide, the keeper or the core, decides for good.
    """

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.withdrawal: Entry | None = None
        self._decision = threading.Lock()
        self._kept = False

    def keep(self) -> bool:
        """Take effect: the line is on disk. False if it was withdrawn before."""
        with self._decision:
            self._kept = self.withdrawal is None
            return self._kept

    def withdraw(self, withdrawal: Entry) -> bool:
        """Cancel the effect; False if the line is on disk already and takes effect."""
        with self._decision:
            if not self._kept:
                self.withdrawal = self.withdrawal or withdrawal
            return not self._kept

    @property
    def withdrawn(self) -> bool:
        return self.withdrawal is not None


class OpenJournal:
    """The journal file of one run. Everything in it waits for the disk: a keeper's part."""

    def __init__(self, path: Path, journal: Journal, lines: Iterable[Entry]) -> None:
        self._path = path
        self._journal = journal
        self._lines = list(lines)

    @classmethod
    def create(cls, path: Path, lines: Sequence[Entry]) -> OpenJournal:
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

        Raises:
            MadrobError: another program wrote it since it was read, or the disk refuses.
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
        """Add lines, if any; a journal that was deleted is written anew.

        Returns how many are on disk, and why not all. `again`: the disk refused before.
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
        self._journal.close()


class _Line:
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

    Lines that come while the disk is busy are written together, by one sync.
    """

    def __init__(self, keeper: DiskJobs, monotonic: Callable[[], float]) -> None:
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
        return tuple(self._entries)

    @property
    def mark(self) -> JournalMark:
        return self._mark.mark

    @property
    def full(self) -> bool:
        """Whether half of the readable journal size is used; the rest is for the run's end."""
        return 2 * len(self._entries) > MOST_LINES or 2 * self._size > LARGEST_JOURNAL

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

    def begin_journal(self) -> None:
        self.close()
        self._entries, self._waiting, self._problem = [], (), None
        self._mark, self._size = GrowingMark(), 0

    def adopt(self, file: OpenJournal, entries: Iterable[Entry]) -> None:
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
        if self._file is not None:
            self._keeper.submit_job(self._file.close)
        self._file, self._busy = None, False

    def add_line(self, entry: Entry) -> None:
        self._stands(entry)
        self._waiting += (_Line(entry, self._monotonic()),)
        self._write()

    def promise(self, promise: Promise, done: Callable[[str | None], None]) -> None:
        """Add a line that takes effect when it is on disk.

        `done` gets None when it is, or at once the disk's refusal in words; it is not called for a
        withdrawn line.
        """
        self._waiting += (_Line(promise.entry, self._monotonic(), promise, done),)
        self._write()

    def catch_up(self) -> None:
        """Retry what waits; a journal that was deleted is written anew."""
        self._write(again=True)

    def _stands(self, entry: Entry) -> None:
        self._entries.append(entry)
        self._size += len(entry.to_json()) + 1
        self._mark.add_line(entry)

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

        self._keeper.submit_job(job, done)

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


# The open recording of one run: its folder, its bag.


_LOOK_PERIOD = 1.0
"""How often the folder is checked, s."""


class Recording:
    """Records one run into a new folder.

    Args:
        start: planned start, s since the epoch; stands in the folder's name.
        topics: those known by now; more can be added.
        lossless: wait for the disk instead of dropping (virtual time).
    """

    def __init__(
        self,
        root: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        *,
        lossless: bool,
        reading: Reader,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        setup = record.setup
        name = RunName(setup.subject, setup.condition.number, setup.run_number)
        self.folder = reserve_run_folder(root, name, start, practice=setup.practice)
        self._topics = {topic.name for topic in topics}
        self._scored = {mapping.topic for mapping in record.mappings}
        self._monotonic = monotonic
        self._reading = reading
        self._looked = monotonic()
        self._answered = True
        self._folder_problem: str | None = None
        self._writer = BagWriter(
            self.folder, topics, {RECORD_NAME: record.to_metadata()}, block_when_full=lossless
        )
        try:
            self._writer.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None

    def add_topics(self, topics: Sequence[Topic]) -> None:
        for topic in topics:
            if topic.name not in self._topics:
                self._topics.add(topic.name)
                self._writer.add_topic(topic)

    def record_messages(self, messages: Iterable[RawMessage]) -> None:
        self._writer.put_all(messages)

    def dropped(self) -> dict[str, int]:
        return dict(self._writer.stats().dropped)

    @property
    def silent(self) -> float:
        """How long the disk has taken nothing of the recording, s. From any thread."""
        stats = self._writer.stats()
        since = stats.seconds_since_sync if stats.state is RecorderState.RECORDING else None
        return since or 0.0

    def view(self) -> RecorderView:
        stats = self._writer.stats()
        problem = stats.error
        if stats.state is RecorderState.RECORDING:
            problem = self._problem_of_folder()
        return RecorderView(
            state=stats.state.value,
            messages=stats.written,
            size=stats.file_bytes,
            dropped=sum(stats.dropped.values()),
            problem=problem,
        )

    def _problem_of_folder(self) -> str | None:
        now = self._monotonic()
        if self._answered and now - self._looked >= _LOOK_PERIOD:
            self._looked, self._answered = now, False
            self._reading.submit_job(partial(_problem_of, self.folder), self._heard_of_folder)
        return self._folder_problem

    def _heard_of_folder(self, answer: Future[str | None]) -> None:
        self._answered = True
        self._folder_problem = None if answer.exception() else answer.result()

    def remarks(self) -> tuple[str, ...]:
        stats = self._writer.stats()
        failed = [] if stats.error is None else [stats.error.replace(str(self.folder), "the bag")]
        missing = sorted(stats.dropped.items())
        return (
            *failed,
            *(f"{topic}: {n} messages are not in the recording" for topic, n in missing if n),
        )

    @property
    def unrecorded(self) -> int:
        """Messages that were scored and are not in the recording; those of another type are not."""
        stats = self._writer.stats()
        missing = sum(n for topic, n in stats.dropped.items() if topic in self._scored)
        return max(0, missing - stats.drop_reasons.get(DropReason.OTHER_TYPE, 0))

    def close(self) -> BagSummary:
        """Write what is queued and finish the bag; waits for the disk as long as it takes."""
        return self._writer.close(None)


def _problem_of(folder: Path) -> str | None:
    if os.access(folder, os.W_OK | os.X_OK):
        return None
    why = "cannot be written" if os.path.lexists(folder) else "is gone"
    return f"{folder} {why}: the result would not be on disk"
