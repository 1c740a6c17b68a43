"""Writes files and folders whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import opened_folder


def atomic_write(path: Path, data: bytes | memoryview) -> None:
    atomic_writes(path.parent, {path.name: data})


def atomic_writes(folder: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Write files of a folder in their order, each as `whole_file` does; sync the folder once.

    On MadrobError the files before the one that it names are written.
    """
    path = folder / next(iter(files), "")
    try:
        with opened_folder(folder) as number:
            for name, data in files.items():
                path = folder / name
                with _replaced(name, number) as file:
                    file.write(data)
            os.fsync(number)
    except OSError as error:
        raise _refused(path, error) from None


def atomic_write_in(folder: int, name: str, parts: Iterable[bytes]) -> None:
    """Write a file of an open folder whole or not at all; OSError if the disk refuses.

    The folder is not synced: after a power cut the file may be as before, or missing.
    """
    with _replaced(name, folder) as file:
        file.writelines(parts)


def make_folder(path: Path, remedy: str) -> None:
    """Make a folder and those above it, where they are missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MadrobError(f"{path}: cannot be made ({error.strerror}): {remedy}") from None


def write_new_folder(path: Path, files: Mapping[str, bytes | memoryview]) -> None:
    with new_folder(path) as part:
        atomic_writes(part, files)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Fill a new folder atomically; the yielded path is where the files go until then.

    The parent folder is made, too. MadrobError if something is there already, or another program
    makes it.
    """
    taken = MadrobError(f"{path}: is there already; move it away or choose another folder")
    part = path.with_name(f".{path.name}.part")
    try:
        if path.exists() or path.is_symlink():
            raise taken
        with _filled_folder(part):
            yield part
            _sync_folder(part)
            part.rename(path)
            _sync_folder(path.parent)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY):  # somebody was faster
            raise taken from None
        raise _refused(path, error) from None


@contextmanager
def _filled_folder(part: Path) -> Iterator[None]:
    """A folder to be filled and renamed: empty, also where a kill has left one, and locked."""
    part.mkdir(parents=True, exist_ok=True)
    with opened_folder(part.parent, part.name) as number:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MadrobError(f"{part}: another program fills it: try again") from None
        try:
            for left in part.iterdir():
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            yield
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Write a file atomically: whatever happens, it is either the old one or the whole new one.

    The data are on disk at the end. A link at `path` is replaced, not followed.
    """
    try:
        with opened_folder(path.parent) as number:
            with _replaced(path.name, number) as file:
                yield file
            os.fsync(number)
    except OSError as error:
        raise _refused(path, error) from None


@contextmanager
def _replaced(name: str, folder: int) -> Iterator[BinaryIO]:
    """Write a file of an open folder without a name, which it gets when it is whole.

    Where the file system has no nameless files (FAT, NFS), a kill leaves the part that is there.
    """
    try:
        number = os.open(".", os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC, 0o666, dir_fd=folder)
    except OSError as error:
        if error.errno not in _NO_NAMELESS_FILES:
            raise
        part = f".{name}.{secrets.token_hex(4)}.part"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        number = os.open(part, flags, 0o666, dir_fd=folder)
    else:
        part = ""
    try:
        with os.fdopen(number, "wb") as file:
            yield file
            file.flush()
            os.fsync(number)
            if not part:
                _link(number, part := f".{name}.part", folder)
        try:
            os.replace(part, name, src_dir_fd=folder, dst_dir_fd=folder)
        except FileNotFoundError:
            os.stat(name, dir_fd=folder)  # another writer has put a whole file there
    except BaseException:
        with suppress(OSError):
            os.unlink(part, dir_fd=folder)
        raise


def _link(number: int, part: str, folder: int) -> None:
    """Give a nameless file a name, in place of a whole file that a kill has left there."""
    for _ in range(_OTHER_WRITERS):
        with suppress(FileNotFoundError):
            os.unlink(part, dir_fd=folder)
        with suppress(FileExistsError):
            os.link(f"/proc/self/fd/{number}", part, dst_dir_fd=folder)
            return
    raise FileExistsError(errno.EEXIST, "other programs write it")


_OTHER_WRITERS = 10
_NO_NAMELESS_FILES = (errno.EOPNOTSUPP, errno.EISDIR)


def _refused(path: Path, error: OSError) -> MadrobError:
    return MadrobError(
        f"{path}: not written ({error.strerror}); make room or choose another folder"
    )


def free_space(path: Path) -> int | None:
    """Bytes free where `path` lies or will lie; None if unknown."""
    for place in (path, *path.absolute().parents):
        try:
            return shutil.disk_usage(place).free
        except FileNotFoundError:
            continue
        except OSError:
            return None
    return None


def _sync_folder(folder: Path) -> None:
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    finally:
        os.close(file)
