"""Locks that nobody else can hold: in files that only their user may open.

Whoever may read a file can lock it. What is told by a lock is therefore told by one on a file of
its own, of mode 0600, that lies beside the others while it is held. Nobody ever waits for it.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Self

from madrob_console.files.plain import checked_plain, open_plain

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class Hold:
    """A lock that is held until `release`, or until the process ends.

    Args:
        path: its file; made if there is none.

    Attributes:
        path: the same.

    Raises:
        BlockingIOError: another holds it.
        OSError: the file cannot be made or locked, or what lies there is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._holders = 1
        while (number := _locked(path)) is None:  # its file was taken away a moment ago
            pass
        self._number = number

    @property
    def stands(self) -> bool:
        """Whether its file is still there: without it others would not know of the lock."""
        return _names(self.path, self._number)

    def share(self) -> Self:
        """Hold it once more: it is let go of when everybody has released it."""
        self._holders += 1
        return self

    def release(self) -> None:
        """Let go of it; its file goes, too."""
        self._holders -= 1
        if self._holders:
            return
        try:
            if self.stands:
                self.path.unlink(missing_ok=True)
        except OSError:
            pass  # a disk that fails: the lock goes all the same
        finally:
            os.close(self._number)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.release()


def is_held(path: Path) -> bool | None:
    """Whether somebody holds the lock of this file; None where it does not tell.

    It does not where there is none, or where it is another user's.
    """
    try:
        number = open_plain(path)
    except OSError:
        return None
    try:
        return locked_by_another(number)
    finally:
        os.close(number)


def locked_by_another(number: int) -> bool:
    """Whether another than who asks has locked an open file for writing."""
    try:
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a network disk without locks, on which no engine records
    return False


def _locked(path: Path) -> int | None:
    """The open and locked file; None if it has lost its name meanwhile."""
    number = checked_plain(os.open(path, _FLAGS, 0o600))
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _names(path, number):
            return number
    except OSError:
        os.close(number)
        raise
    os.close(number)
    return None


def _names(path: Path, number: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(number))
    except OSError:
        return False
