"""Writes the current run's journal, and holds its folder and bag."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RunName, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import OpenFolder
from madrob_console.engine.disk import DiskJobs, why_not
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
from recorder.writer import BagWriter, DropReason, RecorderState


class JournalLine:
    """A line on its way to the journal on disk.

    With `done` it is an act's: it takes effect once it is on disk, unless it is withdrawn before.
    The first to decide, the disk's thread or the core, decides for good. `done` gets None when
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
                found, _ = read_journal(file)
            except BlockingIOError:
                raise MadrobError(f"{path.name}: another console works on this run") from None
            except OSError as error:
                raise MadrobError(
                    f"{path / JOURNAL_FILE}: cannot be written ({error.strerror}); `madrob score` "
                    "reads such a run"
                ) from None
            if found and found != tuple(lines):  # one without lines says nothing: the bag was read
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


class JournalKeeper:
    """Has the lines of one run after the other written; what the disk refuses waits.

    Lines that come while the disk is busy are written together, by one sync.
    """

    def __init__(self, disk: DiskJobs, monotonic: Callable[[], float]) -> None:
        self._disk = disk
        self._monotonic = monotonic
        self._file: OpenJournal | None = None
        self.begin_journal()

    def begin_journal(self, entries: Iterable[Entry] = ()) -> None:
        """Leave the journal before; the next one has these `entries` so far."""
        self.close()
        self._entries: list[Entry] = []
        self._mark = GrowingMark()
        self._size = 0  # bytes of these lines
        self._waiting: tuple[JournalLine, ...] = ()
        self._problem: str | None = None
        for entry in entries:
            self._stands(entry)

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
    def folder(self) -> OpenFolder:
        """Of the current run, which has begun."""
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
        waiting = [one for one in self._waiting if not any(one.entry is each for each in entries)]
        self.begin_journal([*entries, *(one.entry for one in waiting)])
        self._file, self._waiting = file, tuple(waiting)
        self._write()

    def close(self) -> None:
        if self._file is not None:
            self._disk.submit_job(self._file.close)
        self._file, self._busy = None, False

    def add_line(self, line: JournalLine) -> None:
        """Have a line written: an act's stands when it is on disk, any other from now on."""
        if line.done is None:
            self._stands(line.entry)
        line.added = self._monotonic()
        self._waiting += (line,)
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

        def job() -> tuple[Sequence[JournalLine], str | None]:
            wanted = [line for line in lines if not line.withdrawn]
            count, problem = file.append([line.entry for line in wanted], again=again)
            return [line for line in wanted[:count] if line.keep()], problem

        def done(answer: Future[tuple[Sequence[JournalLine], str | None]]) -> None:
            if file is self._file:
                written, problem = ((), why) if (why := why_not(answer)) else answer.result()
                self._heard(lines, written, problem)

        self._disk.submit_job(job, done)

    def _heard(
        self, lines: Sequence[JournalLine], written: Sequence[JournalLine], problem: str | None
    ) -> None:
        self._busy, self._problem = False, problem
        over = [line for line in lines if line in written or line.done is not None]
        self._waiting = tuple(
            line for line in self._waiting if line not in over and not line.withdrawn
        )
        for line in over:
            if line.done is None or line.withdrawn:
                continue
            if line in written:
                self._stands(line.entry)
            line.done(None if line in written else f"{problem}: {_REMEDY}")
        if problem is None or any(line.done is not None for line in self._waiting):
            self._write()  # what waits for nothing else is refused by the disk itself


# The open files of one run: its folder, bag and journal.


class Recording:
    """Records one run into a new folder, in which it begins its journal.

    Args:
        start: planned start, s since the epoch; stands in the folder's name.
        topics: those known by now; more can be added.
        entries: the journal's first lines; the last one is the start.
        lossless: wait for the disk instead of dropping (virtual time).
    """

    def __init__(
        self,
        root: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        entries: Sequence[Entry],
        *,
        lossless: bool,
    ) -> None:
        setup = record.setup
        name = RunName(setup.subject, setup.condition.number, setup.run_number)
        self.record = record
        self.entries = entries
        self.folder = reserve_run_folder(root, name, start, practice=setup.practice)
        self._topics = {topic.name for topic in topics}
        self._scored = {mapping.topic for mapping in record.mappings}
        self._writer = BagWriter(
            self.folder, topics, {RECORD_NAME: record.to_metadata()}, block_when_full=lossless
        )
        try:
            self._writer.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        try:
            self.journal = OpenJournal.create(OpenFolder(self.folder), entries)
        except (MadrobError, OSError):
            self.close()
            raise

    def give_up(self, withdrawal: Entry) -> None:
        """Close it all: the run does not start. Its folder stays, its number is used."""
        self.journal.append([withdrawal], again=False)
        self.journal.close()
        self.close()

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
        return RecorderView(
            state=stats.state.value,
            messages=stats.written,
            size=stats.file_bytes,
            dropped=sum(stats.dropped.values()),
            problem=stats.error,
        )

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

    def close(self) -> None:
        """Write what is queued and finish the bag; waits for the disk as long as it takes.

        The journal goes on.
        """
        self._writer.close(None)
