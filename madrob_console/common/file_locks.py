"""Locks that other users cannot take.

Whoever may read a file can lock it. So a lock is on a file of its own, of mode 0600, which lies
beside the others while the lock is held. No process waits for a lock.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Self

from madrob_console.common.plain_files import checked_plain, names_open_file, open_plain

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class Hold:
    """A lock that is held until `release`, or until the process ends; it makes its file.

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
        return names_open_file(self.path, self._number)

    def share(self) -> Self:
        """Hold the lock once more: it is free when every holder has released it."""
        self._holders += 1
        return self

    def release(self) -> None:
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
    """Whether a process holds the lock; None without a file, or for another user's."""
    try:
        number = open_plain(path)
    except OSError:
        return None
    try:
        return locked_by_another(number)
    finally:
        os.close(number)


def locked_by_another(number: int) -> bool:
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
        if names_open_file(path, number):
            return number
    except OSError:
        os.close(number)
        raise
    os.close(number)
    return None
