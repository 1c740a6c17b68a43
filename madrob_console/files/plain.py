"""Opens files that others may have put there: plain ones only, no links, and never waiting."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe must not block


def open_plain(path: str | Path, *, folder: int | None = None) -> int:
    """A file descriptor for reading; the caller closes it.

    Args:
        path: of the file.
        folder: descriptor of the folder where `path` begins; None = where it always does.

    Raises:
        OSError: it cannot be read, or it is a link or no file.
    """
    return checked_plain(os.open(path, _READ, dir_fd=folder))


@contextmanager
def opened_folder(root: Path, *below: str, make: bool = False) -> Iterator[int]:
    """Descriptor of a folder for as long as inside; no folder below `root` may be a link.

    Args:
        root: where to begin.
        below: the folders on the way, each in the one before.
        make: make those that are missing.

    Raises:
        OSError: it cannot be opened, or a link is on the way (`ENOTDIR`).
    """
    number = os.open(root, _FOLDER)
    try:
        for name in below:
            if make:
                with suppress(FileExistsError):
                    os.mkdir(name, dir_fd=number)
            within = os.open(name, _FOLDER | os.O_NOFOLLOW, dir_fd=number)
            os.close(number)
            number = within
        yield number
    finally:
        os.close(number)


def checked_plain(number: int) -> int:
    """An open file that is a plain one; another is closed.

    Raises:
        OSError: it is no file.
    """
    if stat.S_ISREG(os.fstat(number).st_mode):
        return number
    os.close(number)
    raise OSError(errno.EINVAL, "no plain file")


def refusal(error: OSError) -> str:
    """Why a file cannot be read, in words."""
    return "it is a link" if error.errno == errno.ELOOP else error.strerror or "no reason given"
