"""The run's journal: one JSON line for every act and every change.

A line is on disk before what it says takes effect. A torn last line is set aside, never fatal.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from madrob_console.errors import MadrobError
from madrob_console.files.plain import open_plain


class Origin(StrEnum):
    """Who or what made something happen."""

    REFEREE = "referee"
    SENSOR = "sensor"
    CLOCK = "clock"
    SYSTEM = "system"


@dataclass(frozen=True, slots=True)
class Entry:
    """One line.

    Attributes:
        time: s since the epoch, steady (section 8).
        origin: who or what.
        what: the act or the change, in fixed words.
        referee: the referee's name; empty unless `origin` is the referee.
        reason: the reason given, in the referee's words.
        details: everything needed to do it again: JSON values by name.
    """

    time: float
    origin: Origin
    what: str
    referee: str = ""
    reason: str = ""
    details: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """The entry as one line of JSON, without the line end."""
        record = {name: getattr(self, name) for name in self.__slots__}
        return json.dumps(record, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Entry:
        """The entry of a line.

        Raises:
            MadrobError: it is not a journal line.
        """
        try:
            record = json.loads(line)
            return cls(
                time=float(record["time"]),
                origin=Origin(record["origin"]),
                what=str(record["what"]),
                referee=str(record.get("referee", "")),
                reason=str(record.get("reason", "")),
                details=dict(record.get("details", {})),
            )
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise MadrobError(f"not a journal line ({error}): {line[:60]!r}") from None


_FLAGS = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC


class Journal:
    """Appends to a file; every line is synced before `append` returns.

    Lines from before the file exists, and lines that could not be written, are kept and
    written with the next one, in order.
    """

    def __init__(self) -> None:
        self._pending: list[Entry] = []
        self._file: int | None = None
        self._torn = False
        self._written = 0

    @property
    def pending(self) -> tuple[Entry, ...]:
        """Lines that are not on disk yet."""
        return tuple(self._pending)

    def open(self, path: Path) -> None:
        """Create the file and write what is pending.

        The file is locked, so that nobody else takes the run for one that was cut off.

        Raises:
            OSError: the file exists or cannot be written.
        """
        self._file = os.open(path, _FLAGS | os.O_CREAT | os.O_EXCL, 0o644)
        self._torn, self._written = False, 0
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._write()

    def reopen(self, path: Path) -> None:
        """Go on in the file of an earlier run; a torn last line stays by itself.

        Raises:
            BlockingIOError: another program writes it.
            OSError: there is none or it cannot be written.
        """
        file = os.open(path, _FLAGS)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            size = os.fstat(file).st_size
            self._torn = size > 0 and os.pread(file, 1, size - 1) != b"\n"
        except OSError:
            os.close(file)
            raise
        self._file = file

    def append(self, entry: Entry, *, must_take_effect: bool) -> str | None:
        """Add a line.

        Args:
            entry: the line.
            must_take_effect: keep it if it cannot be written now, and write it later; a stop, an
                abort or a timeout waits for no disk.

        Returns:
            Why it is not on disk yet, in words; None when it is (or when no file is open yet).

        Raises:
            MadrobError: it cannot be written and need not take effect; it is forgotten.
        """
        self._pending.append(entry)
        if self._file is None:
            return None
        try:
            self._write()
        except OSError as error:
            if must_take_effect:
                return self._waiting(error)
            self._pending.pop()
            raise MadrobError(f"{_refused(error)}: make room, then try again") from None
        return None

    def flush(self) -> str | None:
        """Try again to write what waits.

        Returns:
            Why it is not on disk yet, in words; None when it is (or when no file is open yet).
        """
        if self._file is None or not self._pending:
            return None
        try:
            self._write()
        except OSError as error:
            return self._waiting(error)
        return None

    def _waiting(self, error: OSError) -> str:
        return f"{_refused(error)}: {len(self._pending)} lines wait"

    def _write(self) -> None:
        assert self._file is not None
        for entry in self._pending[self._written :]:
            # A full disk can take a part of a line: end it, and write the line again.
            text = "\n" * self._torn + entry.to_json() + "\n"
            data = text.encode()
            written = os.write(self._file, data)
            self._torn = self._torn if written == 0 else written < len(data)
            if written < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._written += 1  # a line that waits for others is not written twice
        self._written = 0  # one that cannot be synced is
        os.fsync(self._file)
        self._pending.clear()

    def close(self) -> None:
        """Close the file; later lines wait for the next one."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _refused(error: OSError) -> str:
    return f"the journal cannot be written ({error.strerror})"


def up_to_date(path: Path, entries: Sequence[Entry]) -> Journal:
    """The journal of a run, open and with all its lines: those that its file has not are added.

    Args:
        path: its file; made if there is none.
        entries: every line, in order.

    Raises:
        MadrobError: a line cannot be written.
        OSError: the file cannot be; `BlockingIOError` if another program writes it.
    """
    journal = Journal()
    known: set[str] = set()
    try:
        journal.reopen(path)
        known = {entry.to_json() for entry in read_journal(path)[0]}
    except FileNotFoundError:
        journal.open(path)
    try:
        for entry in entries:
            if entry.to_json() not in known:
                journal.append(entry, must_take_effect=False)
    except MadrobError:
        journal.close()
        raise
    return journal


def read_journal(path: Path) -> tuple[tuple[Entry, ...], tuple[str, ...]]:
    """All entries of a journal file, and the lines that could not be read, as remarks.

    Raises:
        OSError: the file cannot be read, or it is a link or none.
    """
    entries: list[Entry] = []
    remarks: list[str] = []
    with os.fdopen(open_plain(path), "rb") as file:
        lines = file.read().decode(errors="replace").split("\n")
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            entries.append(Entry.from_json(line))
        except MadrobError:
            remarks.append(f"{path.name} line {number} is torn: set aside")
    return tuple(entries), tuple(remarks)
