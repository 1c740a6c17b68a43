"""Files: read bounded and without links, locked, written whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe


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


def replaced_folder(path: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Replace a folder by one with these files.

    After an interruption the folder is as it was before, or missing, but never partly filled; the
    next replacement removes what that has left. MadrobError while another program replaces it.
    """
    new = path.with_name(f".{path.name}.part")
    old = path.with_name(f".{path.name}.old.part")
    try:
        with _filled_folder(new):
            atomic_writes(new, files)
            shutil.rmtree(old, ignore_errors=True)
            with suppress(FileNotFoundError):
                path.rename(old)
            try:
                new.rename(path)
            except OSError:
                with suppress(OSError):
                    old.rename(path)
                raise
            _sync_folder(path.parent)
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise _refused(path, error) from None


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


# Opening files that others may have put there: plain files only, no links, never waiting.


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
        if not _names(self.path, self._number):
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


# Bounded reading, and stamps that tell one version of a file from the next.


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


# Locks that other users cannot take.
#
# Whoever may read a file can lock it. So a lock is on a file of its own, of mode 0600, which lies
# beside the others while the lock is held. Nobody ever waits for a lock.


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
        return _names(self.path, self._number)

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
