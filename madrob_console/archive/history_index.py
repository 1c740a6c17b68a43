"""The index of a results folder: a cache of run summaries in one SQLite file.

Nothing depends on it. An index that is missing, locked or cannot be written is not used; one that
is damaged or of another version is made again.
"""

from __future__ import annotations

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
_MOMENT = 0.2
"""How long another process is waited for, s."""

_LARGEST_VALUE = 1_000_000
"""Bytes; no summary comes near it."""

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
    """The index of one results folder; `version` is that of the summaries' meaning."""

    def __init__(self, root: Path, version: str) -> None:
        self._path = root / INDEX_FILE
        self._name = f"runs_{version}"
        self._table = _TABLE.format(self._name)

    def read(self) -> Iterator[tuple[bytes, bytes]]:
        """Of each run the stamps of its files and its summary, packed; in no order."""
        if stamp_of(str(self._path)) is None:
            return
        try:
            with closing(self._opened("rw")) as index:
                if not self._is_made(index):
                    return
                columns = f"SELECT stamps, summary, checksum FROM {self._name}"
                for stamps, summary, checksum in index.execute(columns):
                    if _checksum(stamps, summary) == checksum:
                        yield stamps, summary
        except (sqlite3.Error, TypeError) as error:  # damaged pages may hold other types
            self._remove_if_damaged(error)

    def store(self, runs: Iterable[tuple[str, bytes, bytes]], gone: Iterable[str]) -> None:
        """Adds or replaces `runs` (folder, stamps, summary); removes those in `gone` folders."""
        if stamp_of(str(self._path)) is None:  # a link is not followed
            self._remove()
        try:
            with closing(self._opened("rwc")) as index:
                index.execute("PRAGMA journal_mode = WAL")
                index.execute("PRAGMA synchronous = NORMAL")
                with index:
                    index.execute("BEGIN IMMEDIATE")
                    if not self._is_made(index):
                        index.execute(self._table)
                    index.executemany(
                        f"REPLACE INTO {self._name} VALUES (?, ?, ?, ?)",
                        ((*run, _checksum(*run[1:])) for run in runs),
                    )
                    index.executemany(
                        f"DELETE FROM {self._name} WHERE folder = ?",
                        ((folder,) for folder in gone),
                    )
        except sqlite3.Error as error:
            self._remove_if_damaged(error)

    def _opened(self, mode: str) -> sqlite3.Connection:
        place = f"{self._path.absolute().as_uri()}?mode={mode}"
        index = sqlite3.connect(place, uri=True, timeout=_MOMENT)
        index.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_VALUE)
        return index

    def _is_made(self, index: sqlite3.Connection) -> bool:
        """Whether the table is there; raises DatabaseError where anything else is."""
        found = index.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL LIMIT 2")
        schema = found.fetchall()
        if schema not in ([], [(self._table,)]):
            raise sqlite3.DatabaseError("not the table of this version")
        return bool(schema)

    def _remove_if_damaged(self, error: Exception) -> None:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
        if code & _PRIMARY not in _NOT_NOW:
            self._remove()

    def _remove(self) -> None:
        for ending in ("", "-wal", "-shm"):
            with suppress(OSError):
                Path(f"{self._path}{ending}").unlink()
