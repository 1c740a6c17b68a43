"""Names and files that an engine owns, by which it is found.

A name stands in the kernel's table of abstract Unix sockets: one process at a time has it, it
lies on no disk, and it is gone with its process. No runtime folder that somebody removes takes it
away.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import socket
import stat
import struct
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_runtime_path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind

LOCK_FILE = ".madrob_engine.lock"
"""In a results folder: locked while an engine records to it; says which one."""

_CREDENTIALS = struct.Struct("3i")
_PROCESSES = Path("/proc")
_TABLE = Path("/proc/net/unix")
_LISTENS = "00010000"


class HeldError(MadrobError):
    """Another engine has what this one needs; `same`: it is that of the same testbed."""

    def __init__(self, words: str, *, same: bool) -> None:
        super().__init__(words)
        self.same = same


@dataclass(frozen=True, slots=True)
class Owned:
    """What the engine of one testbed owns alone.

    The `key` tells the testbed from others of that kind: a ROS domain's number, else a
    digest. Without `results` it records nothing.
    """

    kind: SourceKind
    key: str
    results: Path | None

    @property
    def domain(self) -> int | None:
        return int(self.key) if self.kind is SourceKind.ROS else None

    @property
    def testbed(self) -> str:
        """The name of its testbed: `domain/0`, `simulated/5f3a...`."""
        return f"{'domain' if self.kind is SourceKind.ROS else self.kind.value}/{self.key}"

    @property
    def stem(self) -> str:
        """The name of its files in the runtime folder: `ros_domain_0`, `simulated_5f3a...`."""
        before = "ros_" if self.kind is SourceKind.ROS else ""
        return before + self.testbed.replace("/", "_")

    @property
    def words(self) -> str:
        return f"ROS domain {self.key}" if self.kind is SourceKind.ROS else _WORDS[self.kind]


_WORDS = {SourceKind.SIMULATED: "this simulated testbed", SourceKind.REPLAY: "this replay"}


def owned_by(kind: SourceKind, *what: object, results: Path | None) -> Owned:
    if kind is SourceKind.ROS:
        return Owned(kind, str(what[0]), results)
    digest = hashlib.blake2s("\n".join(map(str, what)).encode(), digest_size=4).hexdigest()
    return Owned(kind, digest, results)


def results_name(folder: Path) -> str | None:
    """The name of a results folder, whatever path leads to it; None where there is no folder."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return f"results/{found.st_dev:x}-{found.st_ino:x}"


def address_of(name: str) -> str:
    return f"\0madrob/{os.getuid()}/{name}"


def names_in_use() -> dict[str, int]:
    """Names of this user on which a process listens, and the number of its socket.

    Raises:
        OSError: this system does not show them.
    """
    prefix, found = f"@madrob/{os.getuid()}/", dict[str, int]()
    with _TABLE.open(errors="replace") as table:
        for line in table:
            # Num RefCount Protocol Flags Type St Inode Path
            words = line.split()
            if len(words) == 8 and words[3] == _LISTENS and words[7].startswith(prefix):
                found[words[7].removeprefix(prefix)] = int(words[6])
    return found


@dataclass(frozen=True, slots=True)
class Peer:
    """The process at the other end of a Unix socket.

    Where it cannot be seen (another container), `pid` is 0 and `user` -1.
    """

    pid: int
    user: int


def peer_of(connection: socket.socket) -> Peer:
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, user, _ = _CREDENTIALS.unpack(raw)
    return Peer(pid, user)


def holder_of(name: str) -> Peer:
    """The process that listens on a name, for when it accepts no connection.

    The kernel says who made a socket. A socket that is not seen belongs to another user.
    """
    with suppress(OSError, KeyError):
        target = f"socket:[{names_in_use()[name]}]"
        for process in _PROCESSES.iterdir():
            if process.name.isdecimal():
                with suppress(OSError):
                    for file in (process / "fd").iterdir():
                        if file.readlink().name == target:
                            return Peer(int(process.name), file.stat().st_uid)
    return Peer(0, -1)


# The folder of an engine's sockets and lock files, and a testbed's name in it.


@dataclass(frozen=True, slots=True)
class Place:
    """The files of the engine of one testbed, in a folder that only the user may enter.

    Every console on that testbed has the same `name`.
    """

    folder: Path
    name: str

    @property
    def socket(self) -> Path:
        """Where it listens; exists only while it runs."""
        return self.folder / f"{self.name}.sock"

    @property
    def log(self) -> Path:
        return self.folder / f"{self.name}.log"

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Hold the lock file: a stranger may have the name, older versions know no names."""
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
    return Place(runtime_folder(), owned.stem)


def runtime_folders() -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Folders that may hold sockets of this user, and what is wrong with them, in words.

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
