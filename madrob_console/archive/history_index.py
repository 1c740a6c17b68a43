"""The index of a results folder: what was read of its runs, cached in one SQLite file.

Nothing depends on it. An index that is missing, locked or cannot be written is not used; one that
is damaged or foreign is made again.
"""

from __future__ import annotations

import os
import re
import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path

from madrob_console.common.files import stamp_of

INDEX_FILE = ".history.sqlite"

_TABLE = (
    "CREATE TABLE {} (folder TEXT NOT NULL PRIMARY KEY, stamps BLOB NOT NULL, "
    "summary BLOB NOT NULL, checksum INTEGER NOT NULL)"
)
_MOST_TABLES = 20

_MOMENT = 0.2
"""How long another process is waited for, s."""

_LARGEST_SUMMARY = 500_000
"""Bytes; a larger one, of thousands of events, is not kept."""

_NOT_NOW = {
    *(sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL),
    *(sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM),
    *(sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM),
}
"""Errors of the moment or of the disk. Any other one means that the file is damaged."""

_PRIMARY = 0xFF  # SQLite says more about an error in the higher bits


def _checksum(stamps: bytes, summary: bytes) -> int:
    """A disk may change what lies on it: a wrong number must not be shown as good."""
    return zlib.crc32(stamps + summary)


class HistoryIndex:
    """One table of a results folder's index: a summary of each run, of one `kind`.

    `version` is that of the summaries' meaning; another one replaces the table.
    """

    def __init__(self, root: Path, kind: str, version: str) -> None:
        self._path = root / INDEX_FILE
        self._kind = f"{kind}_"
        self._name = self._kind + re.sub(r"\W", "_", version)

    def read(self) -> Iterator[tuple[str, bytes, bytes]]:
        """Of each run its folder, the stamps of its files and its summary, in no order."""
        if stamp_of(str(self._path)) is None:
            return
        try:
            with closing(self._opened("rw")) as index:
                if self._name not in self._tables(index):
                    return
                columns = f"SELECT folder, stamps, summary, checksum FROM {self._name}"
                for folder, stamps, summary, checksum in index.execute(columns):
                    if _checksum(stamps, summary) == checksum:
                        yield folder, stamps, summary
        except (sqlite3.Error, TypeError) as error:  # damaged pages may hold other types
            self._remove_if_damaged(error)

    def store(self, runs: Iterable[tuple[str, bytes, bytes]], gone: Iterable[str] = ()) -> None:
        """Adds or replaces `runs` (folder, stamps, summary); removes those in `gone` folders."""
        if stamp_of(str(self._path)) is None:  # a link is not followed
            self._remove()
        try:
            with closing(self._opened("rwc")) as index:
                index.execute("PRAGMA journal_mode = WAL")
                index.execute("PRAGMA synchronous = NORMAL")
                with index:
                    index.execute("BEGIN IMMEDIATE")
                    tables = self._tables(index)
                    for name in tables:
                        if name != self._name and name.startswith(self._kind):
                            index.execute(f"DROP TABLE {name}")
                    if self._name not in tables:
                        index.execute(_TABLE.format(self._name))
                    index.executemany(
                        f"REPLACE INTO {self._name} VALUES (?, ?, ?, ?)",
                        (
                            (*run, _checksum(*run[1:]))
                            for run in runs
                            if len(run[2]) < _LARGEST_SUMMARY
                        ),
                    )
                    index.executemany(
                        f"DELETE FROM {self._name} WHERE folder = ?",
                        ((folder,) for folder in gone),
                    )
        except sqlite3.Error as error:
            self._remove_if_damaged(error)

    def _opened(self, mode: str) -> sqlite3.Connection:
        if not os.access(self._path.parent, os.W_OK):
            mode = "ro&immutable=1"  # else SQLite would make files beside it
        place = f"{self._path.absolute().as_uri()}?mode={mode}"
        index = sqlite3.connect(place, uri=True, timeout=_MOMENT)
        index.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * _LARGEST_SUMMARY)
        return index

    def _tables(self, index: sqlite3.Connection) -> list[str]:
        """The names of its tables; raises DatabaseError where anything else is."""
        schema = "SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL LIMIT ?"
        found = index.execute(schema, (_MOST_TABLES,)).fetchall()
        if any(sql != _TABLE.format(name) for name, sql in found):
            raise sqlite3.DatabaseError("not the tables of an index")
        return [name for name, _ in found]

    def _remove_if_damaged(self, error: Exception) -> None:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
        if code & _PRIMARY not in _NOT_NOW:
            self._remove()

    def _remove(self) -> None:
        for ending in ("", "-wal", "-shm"):
            with suppress(OSError):
                Path(f"{self._path}{ending}").unlink()
