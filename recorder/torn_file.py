"""The file to be repaired: locked, kept under a second name, never out of sight.

All names are names in one open folder, so that no link leads out of it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from contextlib import suppress
from itertools import count
from typing import BinaryIO

from recorder.errors import RecorderError
from recorder.mcap_stream import ForeignError

TORN = ".torn"
"""What is added to the name of a file that was repaired."""

_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK}


def open_file(folder_fd: int, name: str) -> BinaryIO:
    """Open a file of the folder for reading.

    Raises:
        ForeignError: it is no plain file.
        OSError: it cannot be opened, or is a link.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    fd = os.open(name, flags, dir_fd=folder_fd)
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise ForeignError(f"{name} is not a file")
    return os.fdopen(fd, "rb")


def lock(folder_fd: int, name: str, file: BinaryIO) -> None:
    """Make sure that nobody records to the file or repairs it, until it is closed.

    Raises:
        RecorderError: somebody does.
    """
    busy = RecorderError(f"{name} is being written; end its recording or repair, then try again")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise busy from None
    except OSError:
        pass  # not every network disk has locks
    if not _is_named(folder_fd, name, os.fstat(file.fileno())):
        raise busy  # a repair has just ended


def keep(folder_fd: int, name: str) -> str:
    """Give a file a second name, `NAME.torn`; where a disk has no hard links, a new name."""
    info = os.stat(name, dir_fd=folder_fd, follow_symlinks=False)
    for number in count(1):
        kept = _torn_name(name, number)
        if _is_named(folder_fd, kept, info):
            return kept  # an earlier repair was ended here
        if _exists(folder_fd, kept):
            continue
        try:
            os.link(name, kept, src_dir_fd=folder_fd, dst_dir_fd=folder_fd, follow_symlinks=False)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            os.rename(name, kept, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        return kept
    raise AssertionError


def put_back(folder_fd: int, name: str) -> None:
    """Undo the first half of an exchange that was cut off, on a disk without hard links.

    Raises:
        RecorderError: the exchange is going on.
        OSError: the disk refuses.
    """
    if _exists(folder_fd, name) or not _exists(folder_fd, _torn_name(name, 1)):
        return
    last = next(n for n in count(1) if not _exists(folder_fd, _torn_name(name, n + 1)))
    kept = _torn_name(name, last)
    with open_file(folder_fd, kept) as file:
        lock(folder_fd, kept, file)
        if not _exists(folder_fd, name):
            os.rename(kept, name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)


def remove(folder_fd: int, name: str) -> None:
    """Remove a file if it is there."""
    with suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder_fd)


def _torn_name(name: str, number: int) -> str:
    return name + TORN + (f".{number}" if number > 1 else "")


def _exists(folder_fd: int, name: str) -> bool:
    try:
        os.stat(name, dir_fd=folder_fd, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _is_named(folder_fd: int, name: str, info: os.stat_result) -> bool:
    """Whether this is a name of that file."""
    try:
        return os.path.samestat(os.stat(name, dir_fd=folder_fd, follow_symlinks=False), info)
    except FileNotFoundError:
        return False
