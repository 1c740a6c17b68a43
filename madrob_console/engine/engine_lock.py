"""What an engine owns: the locks that decide, and the name by which it is found.

The kernel holds a lock for each results folder and each ROS domain; it vanishes with the process.
A name stands in the kernel's table of abstract Unix sockets: it lies on no disk, so nobody can
remove it. Each engine has a name of its own, so nobody can take it away either.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import secrets
import socket
import stat
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_state_path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe

LOCK_FILE = ".madrob_engine.lock"
"""In a results folder: locked while an engine records to it; says which one."""

_BACKLOG = 128
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
        """The start of its name: `domain/0`, `simulated/5f3a...`."""
        return f"{'domain' if self.kind is SourceKind.ROS else self.kind.value}/{self.key}"

    @property
    def stem(self) -> str:
        """The name of its files: `ros_domain_0`, `simulated_5f3a...`."""
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


# ---------------------------------------------------------------------- locks


def state_folder() -> Path:
    """The user's folder for this machine's locks and logs, made with mode 0700 if there is none.

    No end of a login removes it, and a home that several machines share has one for each.

    Raises:
        MadrobError: it cannot be made, or others may change it.
    """
    folder = user_state_path("madrob") / socket.gethostname()
    try:
        for path in (*reversed(folder.parents), folder):
            path.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat()
        others = found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o022
        problem = "others may change it" if others else ""
    except OSError as error:
        problem = error.strerror or str(error)
    if problem:
        raise MadrobError(
            f"{folder} cannot hold the engine's lock and log ({problem}): set XDG_STATE_HOME to a "
            "folder of your own"
        )
    return folder


def lock_file(path: Path) -> int:
    """Lock a file until its handle is closed; a disk that hangs may hold this up.

    Raises:
        BlockingIOError: another process has it.
    """
    if not path.parent.is_dir():  # else not even that is written: the disk may hang
        path.parent.mkdir(parents=True, exist_ok=True)
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    lock = os.open(path, flags, 0o600)
    try:
        if not stat.S_ISREG(os.fstat(lock).st_mode):
            raise OSError(errno.EINVAL, "no plain file")  # noqa: TRY301
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"pid {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
    except BaseException:
        os.close(lock)
        raise
    return lock


def holder_in(path: Path) -> str:
    """What a locked file says of its process; for people."""
    try:
        with path.open("rb") as file:
            said = file.read(200).decode(errors="replace")
    except OSError:
        said = ""
    return terminal_safe(said.strip()) or "it does not say which"


# ---------------------------------------------------------------------- names


def address_of(name: str) -> str:
    return f"\0madrob/{os.getuid()}/{name}"


def listen_on(testbed: str) -> tuple[str, socket.socket]:
    """Listen on a name of this process: `domain/0/4711`; another one if a stranger has that."""
    name = f"{testbed}/{os.getpid()}"
    while True:
        listening = socket.socket(socket.AF_UNIX)
        try:
            listening.bind(address_of(name))
            listening.listen(_BACKLOG)
        except OSError as error:
            listening.close()
            if error.errno != errno.EADDRINUSE:
                raise
            name = f"{testbed}/{os.getpid()}.{secrets.token_hex(4)}"
        else:
            return name, listening


def testbed_in(name: str) -> str:
    return name.rpartition("/")[0]


def names_in_use(testbed: str | None = None) -> dict[str, int]:
    """Names of this user on which a process listens, and the number of its socket.

    A process of another user may have made some of them.

    Raises:
        MadrobError: this system does not show them.
    """
    prefix, found = f"@madrob/{os.getuid()}/", dict[str, int]()
    try:
        table = _TABLE.read_text(errors="replace")
    except OSError as error:
        raise MadrobError(f"no engine can be found: {_TABLE}: {error.strerror}") from None
    for line in table.splitlines():
        # Num RefCount Protocol Flags Type St Inode Path
        words = line.split()
        if len(words) == 8 and words[3] == _LISTENS and words[7].startswith(prefix):
            name = words[7].removeprefix(prefix)
            if testbed in (None, testbed_in(name)):
                found[name] = int(words[6])
    return found


@dataclass(frozen=True, slots=True)
class Peer:
    """The process at the other end of a Unix socket."""

    pid: int
    user: int


def peer_of(connection: socket.socket) -> Peer:
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, user, _ = _CREDENTIALS.unpack(raw)
    return Peer(pid, user)


def connect_to(name: str, patience: float) -> tuple[socket.socket, int]:
    """Connect to the process of this user that has a name; returns its number, too.

    Raises:
        TimeoutError: it has hung so long that others wait in its backlog, too.
        OSError: nobody has the name, or another user.
    """
    connection = socket.socket(socket.AF_UNIX)
    limit = struct.pack("ll", int(patience), int(1e6 * (patience % 1)))
    try:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        connection.connect(address_of(name))
        connection.settimeout(patience)
        peer = peer_of(connection)
        if peer.user != os.getuid():
            raise ConnectionRefusedError  # noqa: TRY301
    except BlockingIOError:
        connection.close()
        raise TimeoutError from None
    except BaseException:
        connection.close()
        raise
    return connection, peer.pid


def holder_of(name: str) -> int | None:
    """The process of this user that listens on a name, whether or not it answers."""
    try:
        knock, holder = connect_to(name, 1.0)
    except TimeoutError:
        pid = name.rpartition("/")[2].partition(".")[0]
    except OSError:
        return None
    else:
        knock.close()
        return holder
    with suppress(OSError, KeyError):  # whether the process that is named has it
        target = f"socket:[{names_in_use()[name]}]"
        own = pid.isdecimal() and (_PROCESSES / pid).stat().st_uid == os.getuid()
        if own and any(file.name == target for file in files_of(int(pid))):
            return int(pid)
    return None


def threads_of(pid: int) -> list[Path]:
    """The threads of a process in /proc: the first may be gone while another one hangs."""
    with suppress(OSError):
        return list((_PROCESSES / str(pid) / "task").iterdir())
    return []


def files_of(pid: int) -> Iterator[Path]:
    """What a process has open, as far as this one may see."""
    for thread in threads_of(pid):
        with suppress(OSError):
            for file in (thread / "fd").iterdir():
                with suppress(OSError):
                    yield file.readlink()
