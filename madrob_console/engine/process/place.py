"""Where an engine has its files: one folder of the user, one name for each testbed."""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_runtime_path

from madrob_console.engine.process.owned import HeldError, Owned
from madrob_console.errors import MadrobError


@dataclass(frozen=True, slots=True)
class Place:
    """The files of the engine of one testbed.

    Attributes:
        folder: the user's own; nobody else may enter it.
        name: of the testbed; the same for every console that means the same testbed.
    """

    folder: Path
    name: str

    @property
    def socket(self) -> Path:
        """Where it listens; only while it runs."""
        return self.folder / f"{self.name}.sock"

    @property
    def log(self) -> Path:
        """What it says, for people."""
        return self.folder / f"{self.name}.log"

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Hold the testbed's lock file: a stranger may have its name, older versions know no names.

        Raises:
            HeldError: another engine holds it.
        """
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        lock = os.open(self.folder / f"{self.name}.lock", flags, 0o600)
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise HeldError(
                    f"another engine has {self.name}: `madrob engine stop` ends it", same=True
                ) from None
            yield
        finally:
            os.close(lock)


def make_private(folder: Path) -> None:
    """Make a folder that only the user may enter; those above it that are missing, too.

    Raises:
        OSError: it cannot be made.
    """
    for path in (*reversed(folder.parents), folder):
        path.mkdir(mode=0o700, exist_ok=True)


def runtime_folder() -> Path:
    """The user's folder for sockets, made with mode 0700 if there is none.

    Raises:
        MadrobError: it cannot be made, or others may enter it.
    """
    folder = Path("the runtime folder")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a fallback in /tmp: it is checked below
            folder = user_runtime_path("madrob")
        make_private(folder)
        own = _is_own(folder)
    except OSError as error:
        raise MadrobError(
            f"{folder} cannot be used for the engine's socket ({error.strerror or error}): set "
            "XDG_RUNTIME_DIR to a folder of your own"
        ) from None
    if not own:
        raise MadrobError(
            f"{folder}: others may enter it; make it yours with `chmod 700`, or set "
            "XDG_RUNTIME_DIR to a folder of your own"
        )
    return folder


def place_of(owned: Owned) -> Place:
    """The place of an engine's files.

    Raises:
        MadrobError: there is no folder for it.
    """
    return Place(runtime_folder(), owned.stem)


def runtime_folders() -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The folders in which sockets of this user may lie, and what is wrong with them, in words.

    Logins have another one than services and programs without a login.
    """
    problems = []
    folders = [
        Path(f"/run/user/{os.getuid()}/madrob"),
        Path(tempfile.gettempdir(), f"runtime-{os.getuid()}", "madrob"),
    ]
    try:
        folders.insert(0, runtime_folder())
    except MadrobError as error:
        problems.append(str(error))
    found = {}
    for folder in folders:
        try:
            if _is_own(folder):
                found[folder.resolve()] = folder
        except OSError:
            continue  # there is none
    return tuple(found.values()), tuple(problems)


def _is_own(folder: Path) -> bool:
    found = folder.lstat()
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return own and not stat.S_IMODE(found.st_mode) & 0o077
