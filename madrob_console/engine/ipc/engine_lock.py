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
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.plain_files import checked_plain, read_all
from madrob_console.common.stored_json import decode

LOCK_FILE = ".madrob_engine.lock"
"""In a results folder: locked while an engine records to it."""

_LARGEST_NOTE = 10_000


class HeldError(MadrobError):
    """Another engine holds a lock that this one needs; `same`: it serves the same testbed."""

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


class Holder(msgspec.Struct, frozen=True):
    """The content of a lock file: the engine that holds it; `since` in s since the epoch."""

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
    with suppress(OSError, MadrobError):
        return decode(read_all(path, _LARGEST_NOTE), Holder)
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
