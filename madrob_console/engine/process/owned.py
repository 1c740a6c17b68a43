"""What an engine owns, and the names under which it is found by that.

A name stands in the kernel's table of abstract Unix sockets: one process at a time has it, it lies
on no disk, and it is gone with its process. No runtime folder that somebody removes takes it away.
"""

from __future__ import annotations

import hashlib
import os
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind

LOCK_FILE = ".madrob_engine.lock"
"""In a results folder: locked while an engine records to it; says which one."""

_CREDENTIALS = struct.Struct("3i")
_PROCESSES = Path("/proc")
_TABLE = Path("/proc/net/unix")
_LISTENS = "00010000"


class HeldError(MadrobError):
    """Another engine has what this one needs.

    Attributes:
        same: it is the engine of the same testbed.
    """

    def __init__(self, words: str, *, same: bool) -> None:
        super().__init__(words)
        self.same = same


@dataclass(frozen=True, slots=True)
class Owned:
    """What the engine of one testbed has for itself.

    Attributes:
        kind: of its testbed.
        key: tells the testbed from others of that kind: a ROS domain's number, else a digest.
        results: the folder that it records to; None = it records nothing.
    """

    kind: SourceKind
    key: str
    results: Path | None

    @property
    def domain(self) -> int | None:
        """Its ROS domain; None where there is none."""
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
        """The testbed, for people."""
        return f"ROS domain {self.key}" if self.kind is SourceKind.ROS else _WORDS[self.kind]


_WORDS = {SourceKind.SIMULATED: "this simulated testbed", SourceKind.REPLAY: "this replay"}


def owned_by(kind: SourceKind, *what: object, results: Path | None) -> Owned:
    """What the engine of a testbed owns.

    Args:
        kind: of the testbed.
        what: tells it from others of that kind; a ROS domain's number.
        results: as in `Owned`.
    """
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
    """Where the kernel has a name of this user."""
    return f"\0madrob/{os.getuid()}/{name}"


def names_in_use() -> dict[str, int]:
    """All names of this user on which some process listens, and the number of its socket.

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

    Attributes:
        pid: 0 where it cannot be seen from here (another container).
        user: its user; -1 where that cannot be seen either.
    """

    pid: int
    user: int


def peer_of(connection: socket.socket) -> Peer:
    """Who is at the other end, as the kernel says: who connected, or who began to listen."""
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
