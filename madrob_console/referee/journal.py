"""The run's journal: one JSON line for every act and every change.

A torn last line is set aside, never fatal. A line that was withdrawn counts for nobody who reads.
"""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.common.plain_files import checked_plain, read_all

HOLD_FILE = ".journal.lock"
"""The lock file beside a journal; its writer holds it."""

LARGEST_JOURNAL = 16_000_000
"""Bytes; a larger file is rejected. A run of 300 s takes some 20,000."""

MOST_LINES = 20_000
"""Lines of a journal: up to 500 sensor events a run, the rest by people."""

_MOST_DIGITS = 300  # of a whole number: more do not fit a float

WITHDRAWN: Final = "withdrawn"
"""A line of this kind takes back an earlier one (`id`), or the last ones (`lines`)."""


class Origin(StrEnum):
    """Who or what made something happen; `remote` is the robot, over ROS."""

    REFEREE = "referee"
    REMOTE = "remote"
    SENSOR = "sensor"
    CLOCK = "clock"
    SYSTEM = "system"


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a journal, as `/madrob/referee/event` has it.

    Attributes:
        time: when the line was written, s since the epoch, steady (section 8).
        origin: who or what made it happen.
        what: what happened.
        referee: the referee's name; may be empty.
        reason: in words; may be empty.
        details: everything needed to do it again; the content depends on `what`.
        id: of an act that takes effect only when it is on disk; else missing.
    """

    time: float
    origin: Origin
    what: str
    referee: str = ""
    reason: str = ""
    details: dict[str, Any] = field(default_factory=dict)
    id: str = ""

    def to_json(self) -> str:
        record = {name: getattr(self, name) for name in self.__slots__}
        if not self.id:
            del record["id"]
        return json.dumps(record, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Entry:
        """Parses a line; MadrobError where it is not a journal line."""
        try:
            record = _decoder.decode(line)
            return cls(
                time=_number(record["time"]),
                origin=Origin(record["origin"]),
                what=str(record["what"]),
                referee=str(record.get("referee", "")),
                reason=str(record.get("reason", "")),
                details=dict(record.get("details", {})),
                id=str(record.get("id", "")),
            )
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise MadrobError(f"not a journal line ({error}): {line[:60]!r}") from None


def _whole_number(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _number(field: str | float) -> float:
    if not math.isfinite(value := float(field)):
        raise ValueError(f"{field} is no number")
    return value


_decoder = json.JSONDecoder(parse_int=_whole_number, parse_float=_number, parse_constant=_number)


_FLAGS = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class Journal:
    """A file of lines, each on disk or no part of it. Its methods wait for the disk.

    Lines that could not be synced are taken back before the next write: after a power cut their
    state is unknown. `refused` says why the last lines were not all written. A journal that
    replaces another of the same run (`before`) shares its lock.
    """

    def __init__(self, before: Journal | Hold | None = None) -> None:
        self.refused: OSError | None = None
        self._file: int | None = None
        self._before = before
        self._hold: Hold | None = None
        self._synced = 0  # bytes that are on disk
        self._end = 0  # bytes of whole lines
        self._loose = 0  # lines behind those that are on disk
        self._torn = self._synced_torn = False

    def open(self, path: Path) -> None:
        """Creates the file and locks it, so that no other program repairs the run.

        Raises:
            BlockingIOError: another program is about to write it.
            OSError: the file exists or cannot be made.
        """
        self._take(path, _FLAGS | os.O_CREAT | os.O_EXCL)

    def reopen(self, path: Path) -> None:
        """Append to the file of an earlier run; a torn last line is kept as a line.

        Raises:
            BlockingIOError: another program writes it.
            OSError: there is none or it cannot be written.
        """
        self._take(path, _FLAGS)

    def _take(self, path: Path, flags: int) -> None:
        file = checked_plain(os.open(path, flags, 0o644))
        try:
            self._hold = self._held(path.with_name(HOLD_FILE))
            with suppress(BlockingIOError):  # any reader can look here
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            size = os.fstat(file).st_size
            torn = size > 0 and os.pread(file, 1, size - 1) != b"\n"
        except OSError:
            os.close(file)
            raise
        self._file, self._synced, self._end, self._loose = file, size, size, 0
        self._torn = self._synced_torn = torn

    def _held(self, path: Path) -> Hold:
        held = self._before._hold if isinstance(self._before, Journal) else self._before
        self._before = None
        if held is not None and held.path == path and held.stands:
            return held.share()
        return Hold(path)

    def append(self, entries: Sequence[Entry]) -> int:
        """Adds lines by one sync; returns how many are on disk, the first ones.

        `refused` says why not all. The others are no part of the journal.
        """
        written, self.refused = 0, None
        try:
            self._take_back()
            for entry in entries:
                self._put(entry)
                written += 1
        except OSError as error:
            self.refused = error
        if written == 0:
            return 0
        assert self._file is not None
        try:
            os.fsync(self._file)
        except OSError as error:
            self.refused = error
            with suppress(OSError):
                self._take_back()
            return 0
        self._synced, self._synced_torn, self._loose = self._end, self._torn, 0
        return written

    def _put(self, entry: Entry) -> None:
        assert self._file is not None
        # A full disk can take a part of a line: it is taken back, or ended before the next one.
        data = ("\n" * self._torn + entry.to_json() + "\n").encode()
        written = os.write(self._file, data)
        if written < len(data):
            try:
                os.ftruncate(self._file, self._end)
            except OSError:
                self._torn = self._torn or written > 0
                self._end += written
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._end += written
        self._torn = False
        self._loose += 1

    def _take_back(self) -> None:
        if self._loose == 0:
            return
        assert self._file is not None
        try:
            os.ftruncate(self._file, self._synced)
        except OSError:  # a disk or a file where one can only append
            loose, self._loose = self._loose, 0
            try:
                self._put(Entry(0.0, Origin.SYSTEM, WITHDRAWN, details={"lines": loose}))
            except OSError:
                self._loose = loose
                raise
            self._loose = 0
        else:
            self._end, self._torn, self._loose = self._synced, self._synced_torn, 0

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # a disk without locks
                fcntl.flock(self._file, fcntl.LOCK_UN)  # a process that starts just now has it, too
            os.close(self._file)
            self._file = None
        if self._hold is not None:
            self._hold.release()
            self._hold = None


def refusal_words(error: OSError) -> str:
    return f"the journal cannot be written ({error.strerror})"


def up_to_date(path: Path, entries: Sequence[Entry], before: Journal | None = None) -> Journal:
    """Opens or creates the journal of a run and adds those `entries` that its file lacks.

    Raises:
        MadrobError: a line cannot be written.
        OSError: the file cannot be; `BlockingIOError` if another program writes it.
    """
    journal = Journal(before)
    try:
        journal.reopen(path)
    except FileNotFoundError:
        journal.open(path)
    try:
        written = {entry.to_json() for entry in read_journal(path)[0]}
    except OSError:
        journal.close()
        raise
    missing = [entry for entry in entries if entry.to_json() not in written]
    if journal.append(missing) < len(missing):
        journal.close()
        assert journal.refused is not None
        raise MadrobError(refusal_words(journal.refused))
    return journal


def read_journal(path: Path) -> tuple[tuple[Entry, ...], tuple[str, ...]]:
    """All valid entries of a journal file, and remarks on the unreadable lines.

    Raises:
        OSError: the file cannot be read, is missing, a link or too long.
    """
    data = read_all(path, LARGEST_JOURNAL)
    if (count := data.count(b"\n")) > MOST_LINES:
        raise OSError(errno.EFBIG, f"{count} lines, more than {MOST_LINES}")
    standing, remarks = _Standing(), list[str]()
    for number, line in enumerate(data.decode(errors="replace").split("\n"), start=1):
        if not line.strip():
            continue
        try:
            standing.add(Entry.from_json(line))
        except MadrobError:
            remarks.append(f"{path.name} line {number} is torn: set aside")
    return standing.entries, tuple(remarks)


class _Standing:
    """The lines that are not withdrawn, found in linear time."""

    def __init__(self) -> None:
        self._entries: list[Entry | None] = []
        self._places: list[int] = []
        self._named: dict[str, list[int]] = {}

    @property
    def entries(self) -> tuple[Entry, ...]:
        return tuple(entry for entry in self._entries if entry is not None)

    def add(self, entry: Entry) -> None:
        if entry.what == WITHDRAWN:
            lines = entry.details.get("lines")
            if isinstance(lines, int):
                self._drop(self._places, lines)
            else:
                self._drop(self._named.get(str(entry.details.get("id", "")), []), 1)
        else:
            self._places.append(len(self._entries))
            if entry.id:
                self._named.setdefault(entry.id, []).append(len(self._entries))
        self._entries.append(entry)

    def _drop(self, places: list[int], count: int) -> None:
        while places and count > 0:
            place = places.pop()
            count -= self._entries[place] is not None
            self._entries[place] = None
