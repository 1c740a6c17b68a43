"""Opens and reads files that others may have put there.

Only plain files are opened, links are not followed, no call waits, and reading is bounded.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple, Self

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe must not block


def open_plain(path: str | Path, *, folder: int | None = None) -> int:
    """Open a plain file for reading; OSError for a link or anything else. The caller closes it.

    `folder` is the descriptor of the folder where `path` begins.
    """
    return checked_plain(os.open(path, _READ, dir_fd=folder))


@contextmanager
def opened_folder(root: Path, *below: str, make: bool = False) -> Iterator[int]:
    """Descriptor of a folder while inside; no folder below `root` may be a link (`ENOTDIR`).

    `below` are the nested folders on the way; `make` makes those that are missing.
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


class OpenFolder:
    """A folder as it was opened, whatever has its name later.

    Attributes:
        path: its name when it was opened, for words.
        inside: a path to the folder itself, for its files; also for other processes of this user.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._number = os.open(path, _FOLDER | os.O_NOFOLLOW)
        self.inside = Path(f"/proc/{os.getpid()}/fd/{self._number}")

    @property
    def is_deleted(self) -> bool:
        return os.fstat(self._number).st_nlink == 0

    def problem(self) -> str | None:
        """Why its files are not where its name says, or that it takes none, with the remedy."""
        if self.is_deleted:
            return f"{self.path} was deleted"
        if not names_open_file(self.path, self._number):
            name = terminal_safe(str(self.inside.readlink()))
            return f"rename {name} back to {self.path.name}: that is the folder in use"
        if not os.access(self.inside, os.W_OK | os.X_OK):
            return f"{self.path} cannot be written: make it yours"
        return None

    def open_again(self) -> None:
        """Open it by its name, if that has the same folder: its disk may have come back.

        OSError where it cannot be opened.
        """
        number = os.open(self.path, _FOLDER | os.O_NOFOLLOW)
        try:
            if os.fstat(number).st_ino == os.fstat(self._number).st_ino:
                os.dup2(number, self._number, inheritable=False)
        finally:
            os.close(number)

    def restore(self) -> None:
        """Open it again; make it again if it was deleted.

        FileExistsError if something else has the name of a deleted one.
        """
        if not self.is_deleted:
            with suppress(OSError):  # it has another name, and its files are where they were
                self.open_again()
            return
        self.path.mkdir(parents=True)
        number = os.open(self.path, _FOLDER | os.O_NOFOLLOW)
        os.dup2(number, self._number, inheritable=False)
        os.close(number)

    def close(self) -> None:
        number, self._number = self._number, -1
        if number >= 0:
            os.close(number)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


@contextmanager
def naming_folder(path: Path, inside: Path) -> Iterator[None]:
    """Errors about files `inside` an open folder name it by its `path`."""
    try:
        yield
    except MadrobError as error:
        raise type(error)(str(error).replace(str(inside), str(path))) from None


def checked_plain(number: int) -> int:
    """Return the descriptor of a plain file; close any other and raise OSError."""
    if stat.S_ISREG(os.fstat(number).st_mode):
        return number
    os.close(number)
    raise OSError(errno.EINVAL, "no plain file")


def refusal(error: OSError) -> str:
    return "it is a link" if error.errno == errno.ELOOP else error.strerror or "no reason given"


class Stamp(NamedTuple):
    """Version of a file: another stamp, another content.

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
        state = os.stat(path, follow_symlinks=False)  # noqa: PTH116  ten thousand Paths take too long
    except OSError:
        return None
    return _stamp(state) if stat.S_ISREG(state.st_mode) else None


def _stamp(state: os.stat_result) -> Stamp:
    return Stamp(state.st_mtime_ns, state.st_ctime_ns, state.st_size)


def read_bounded(path: str, limit: int) -> tuple[bytes, Stamp]:
    """The content and stamp of a plain file; of a larger one only the first `limit` bytes."""
    number = open_plain(path)
    try:
        state = os.fstat(number)
        with os.fdopen(number, "rb", closefd=False) as file:
            return file.read(limit), _stamp(state)
    finally:
        os.close(number)


def read_all(path: str | Path, limit: int) -> bytes:
    """The content of a plain file; OSError (`EFBIG`) if it has more than `limit` bytes."""
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


def names_open_file(path: Path, number: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(number))
    except OSError:
        return False
