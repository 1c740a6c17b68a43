"""The sockets of the engines of this user, and the folder that holds them."""

from __future__ import annotations

import os
import socket
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platformdirs import user_state_path

from madrob_console.common.errors import MadrobError

_BACKLOG = 128

_CREDENTIALS = struct.Struct("3i")


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
