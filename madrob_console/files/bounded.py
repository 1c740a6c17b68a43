"""Reads no more of a file than it may hold, and knows one version of it from the next."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import NamedTuple

from madrob_console.files.plain import open_plain


class Stamp(NamedTuple):
    """Of one version of a file: another stamp, another content.

    Attributes:
        modified: when its content changed, ns; any program can put that back.
        changed: when it or its name changed, ns; no program can put that back.
        size: in bytes.
    """

    modified: int
    changed: int
    size: int


def stamp_of(path: str) -> Stamp | None:
    """The stamp of a file; None for no file, a link or anything else."""
    try:
        found = os.stat(path, follow_symlinks=False)  # noqa: PTH116  ten thousand Paths take too long
    except OSError:
        return None
    return _stamp(found) if stat.S_ISREG(found.st_mode) else None


def _stamp(found: os.stat_result) -> Stamp:
    return Stamp(found.st_mtime_ns, found.st_ctime_ns, found.st_size)


def read_bounded(path: str, limit: int) -> tuple[bytes, Stamp]:
    """The content of a file and its stamp; of a larger file only the first `limit` bytes.

    Raises:
        OSError: it cannot be read, or it is a link or no file.
    """
    number = open_plain(path)
    try:
        found = os.fstat(number)
        with os.fdopen(number, "rb", closefd=False) as file:
            return file.read(limit), _stamp(found)
    finally:
        os.close(number)


def read_all(path: str | Path, limit: int) -> bytes:
    """The content of a file that may have up to `limit` bytes.

    Raises:
        OSError: it cannot be read, it is a link or no file, or it is larger (`EFBIG`).
    """
    number = open_plain(path)
    try:
        size = os.fstat(number).st_size
        data = b""
        if size <= limit:
            with os.fdopen(number, "rb", closefd=False) as file:
                data = file.read(limit + 1)
            size = len(data)
        if size > limit:
            raise OSError(errno.EFBIG, f"{size / 1e6:.1f} MB, more than {limit / 1e6:g} MB")
        return data
    finally:
        os.close(number)
