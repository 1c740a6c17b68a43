"""Files that are written whole or not at all, and the room that is left for them."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from madrob_console.errors import MadrobError


def atomic_write(path: Path, data: bytes | memoryview) -> None:
    """Write a file as `whole_file` does.

    Raises:
        MadrobError: the disk refuses.
    """
    atomic_writes(path.parent, {path.name: data})


def atomic_writes(folder: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Write several files of a folder in their order, each as `whole_file` does.

    The folder is brought to the disk once, at the end.

    Raises:
        MadrobError: the disk refuses; the files before the one that it names are written.
    """
    path = folder
    try:
        for name, data in files.items():
            path = folder / name
            with _replaced(path) as file:
                file.write(data)
        _sync_folder(folder)
    except OSError as error:
        raise _refused(path, error) from None


def atomic_write_in(folder: int, name: str, data: bytes) -> None:
    """Write a file of an open folder as `whole_file` does.

    Raises:
        OSError: the disk refuses.
    """
    with _replaced(Path(name), folder) as file:
        file.write(data)
    os.fsync(folder)


def write_new_folder(path: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Make a folder with these files, as `new_folder` does.

    Args:
        path: of the folder.
        files: by name.

    Raises:
        MadrobError: something is there already, or the disk refuses.
    """
    with new_folder(path) as part:
        atomic_writes(part, files)


def replaced_folder(path: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Make a folder with these files in place of one with others.

    It is there with all of them; where that is cut off, as it was before or not at all.

    Args:
        path: of the folder.
        files: by name.

    Raises:
        MadrobError: the disk refuses.
    """
    old, new = (path.with_name(f".{path.name}.{secrets.token_hex(4)}.part") for _ in range(2))
    write_new_folder(new, files)
    try:
        with suppress(FileNotFoundError):
            path.rename(old)
        new.rename(path)
        _sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):  # what was there comes back, unless the new one is in its place
            old.rename(path)
        raise _refused(path, error) from None
    finally:
        shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to be filled; it is there with all that was put into it or not at all.

    Args:
        path: of the folder; the one that it lies in is made, too. There must be nothing yet.

    Yields:
        where to put the files until then.

    Raises:
        MadrobError: something is there already, or the disk refuses.
    """
    taken = MadrobError(f"{path}: is there already; move it away or choose another folder")
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        if path.exists() or path.is_symlink():
            raise taken
        part.mkdir(parents=True)
        yield part
        _sync_folder(part)
        part.rename(path)
        _sync_folder(path.parent)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY):  # somebody was faster
            raise taken from None
        raise _refused(path, error) from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to be written that, whatever happens, is either the old one or the whole new one.

    The data are on disk at the end. A link at `path` is replaced, not followed.

    Raises:
        MadrobError: the disk refuses.
    """
    try:
        with _replaced(path) as file:
            yield file
        _sync_folder(path.parent)
    except OSError as error:
        raise _refused(path, error) from None


@contextmanager
def _replaced(path: Path, folder: int | None = None) -> Iterator[BinaryIO]:
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")

    def opened(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW, 0o666, dir_fd=folder)

    try:
        with open(part, "xb", opener=opened) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(part, dir_fd=folder)
        raise


def _refused(path: Path, error: OSError) -> MadrobError:
    return MadrobError(
        f"{path}: not written ({error.strerror}); make room or choose another folder"
    )


def free_space(path: Path) -> int | None:
    """Bytes free where `path` lies or will lie; None if that cannot be found out."""
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
