"""What an engine owns: a testbed and a results folder, by locks that the kernel holds.

A lock vanishes with its process. Two files of each testbed lie in a folder that only this user can
open: `STEM.lock`, locked while the testbed has an engine, and `STEM.sock`, the engine's socket.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pwd
import socket
import stat
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
from platformdirs import user_state_path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.plain_files import checked_plain, read_all

LOCK_FILE = ".madrob_engine.lock"
"""In a results folder: locked while an engine records to it."""

_BACKLOG = 128
_LARGEST_NOTE = 10_000
_CREDENTIALS = struct.Struct("3i")


class HeldError(MadrobError):
    """Another engine has what this one needs; `same`: it is that of the same testbed."""

    def __init__(self, words: str, *, same: bool) -> None:
        super().__init__(words)
        self.same = same


@dataclass(frozen=True, slots=True)
class Owned:
    """What the engine of one testbed owns alone.

    The `key` tells the testbed from others of that kind: `domain_0`, else a digest. Without
    `results` it records nothing.
    """

    kind: SourceKind
    key: str
    results: Path | None

    @property
    def domain(self) -> int | None:
        return int(self.key.removeprefix("domain_")) if self.kind is SourceKind.ROS else None

    @property
    def stem(self) -> str:
        """The name of its files: `ros_domain_0`, `simulated_5f3a...`."""
        return f"{self.kind.value}_{self.key}"

    @property
    def words(self) -> str:
        return _WORDS.get(self.kind, f"ROS domain {self.domain}")


_WORDS = {SourceKind.SIMULATED: "this simulated testbed", SourceKind.REPLAY: "this replay"}


def owned_by(kind: SourceKind, *what: object, results: Path | None) -> Owned:
    if kind is SourceKind.ROS:
        return Owned(kind, f"domain_{what[0]}", results)
    digest = hashlib.blake2s(os.fsencode("\n".join(map(str, what))), digest_size=4).hexdigest()
    return Owned(kind, digest, results)


# ---------------------------------------------------------------------- the state folder


def state_folder() -> Path:
    """The user's folder for this machine's locks, sockets and logs, made if there is none.

    No end of a login removes it, and a home that several machines share has one for each.

    Raises:
        MadrobError: it cannot be made, or others may change it.
    """
    folder = user_state_path("madrob") / socket.gethostname()
    try:
        for path in (*reversed(folder.parents), folder):
            path.mkdir(mode=0o700, exist_ok=True)
        status = folder.stat()
    except OSError as error:
        raise no_state(folder, error) from None
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o022:
        raise no_state(folder, OSError(0, "others may change it"))
    return folder


def no_state(folder: Path, error: OSError) -> MadrobError:
    """What to say and do where the state folder is of no use."""
    return MadrobError(
        f"{folder} cannot hold the engine's lock and log ({error.strerror or error}): set "
        "XDG_STATE_HOME to a folder of your own"
    )


# ---------------------------------------------------------------------- locks


class Holder(msgspec.Struct, frozen=True):
    """What a lock's file says of the engine that holds it; `since` in s since the epoch."""

    pid: int = 0
    since: float = 0.0
    user: str = ""
    host: str = ""
    results: str = ""

    @property
    def words(self) -> str:
        if not self.pid:
            return "it does not say which"
        return terminal_safe(f"user {self.user}, pid {self.pid} on {self.host}")


def this_user() -> str:
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user without a name
        return str(os.getuid())


def holder_in(path: Path) -> Holder:
    with suppress(OSError, msgspec.MsgspecError):
        return msgspec.json.decode(read_all(path, _LARGEST_NOTE), type=Holder)
    return Holder()


def lock_file(path: Path, results: Path | None) -> int:
    """Lock a file, made if there is none, until the handle is closed.

    Raises:
        BlockingIOError: another engine has it.
    """
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        lock = os.open(path, flags)  # without O_CREAT: /tmp refuses that for a file of another user
    except FileNotFoundError:
        lock = os.open(path, flags | os.O_CREAT, 0o600)
    checked_plain(lock)
    where = socket.gethostname(), str(results or "")
    note = msgspec.json.encode(Holder(os.getpid(), time.time(), this_user(), *where))
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.pwrite(lock, note, 0)  # over the one before: a full disk has room for that
        os.ftruncate(lock, len(note))
    except BaseException:
        os.close(lock)
        raise
    return lock


def lock_results(folder: Path) -> int:
    """Lock a results folder, made if there is none; a disk that hangs may hold this up.

    Who may write in the folder, and nobody else, can open the lock's file: a lock on the folder
    itself could be taken by whoever may read there.

    Raises:
        BlockingIOError: another engine has it.
    """
    if not folder.is_dir():  # else not even that is written: the disk may hang
        folder.mkdir(parents=True, exist_ok=True)
    lock = lock_file(folder / LOCK_FILE, folder)
    status = folder.stat()
    writers = status.st_mode & 0o222
    for owner in (status.st_uid, -1):  # only root can give the file to the folder's owner
        with suppress(OSError):  # nor does every disk have owners
            os.fchmod(lock, writers | writers << 1)
            os.fchown(lock, owner, status.st_gid)
    return lock


# ---------------------------------------------------------------------- sockets


@contextmanager
def _address(stem: str) -> Iterator[str]:
    """The socket of a testbed, by its folder's handle: an address has 107 bytes at most."""
    folder = os.open(state_folder(), os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{folder}/{stem}.sock"
    finally:
        os.close(folder)


def listen_as(stem: str) -> socket.socket:
    """Listen on the socket of a testbed, whose lock this process holds."""
    listening = socket.socket(socket.AF_UNIX)
    with _address(stem) as address:
        Path(address).unlink(missing_ok=True)  # of an engine that has ended
        listening.bind(address)
        Path(address).chmod(0o600)  # before anybody can connect
        listening.listen(_BACKLOG)
    return listening


def connect_to(stem: str, patience: float) -> socket.socket:
    """Connect to the engine of a testbed, which has `patience` s for each answer; never waits.

    Raises:
        TimeoutError: it has hung so long that its backlog is full.
        OSError: there is none.
    """
    connection = socket.socket(socket.AF_UNIX)
    connection.setblocking(False)
    try:
        with _address(stem) as address:
            connection.connect(address)
    except OSError as error:
        connection.close()
        raise TimeoutError if isinstance(error, BlockingIOError) else error from None
    connection.settimeout(patience)
    return connection


def pid_of_peer(connection: socket.socket) -> int:
    """The process at the other end of a Unix socket."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return int(_CREDENTIALS.unpack(raw)[0])
