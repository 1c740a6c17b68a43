"""The socket at which screens attach: made again when lost, accepting while handles last.

Whoever ends a login may remove its runtime folder. Consoles ask the engine where its socket lies
(`control.py`), so that it may lie in any folder that is the user's own.
"""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.engine_lock import make_private


class Listening:
    """A Unix socket with a path, mode 0600; replaces that of an engine that was killed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem: str | None = None
        self._wanted = path
        self._made: tuple[int, int] | None = None

    def open(self) -> socket.socket:
        try:
            return self._at(self._wanted)
        except OSError as error:
            raise MadrobError(
                f"{self._wanted}: no socket can be made there ({error}); set XDG_RUNTIME_DIR to "
                "another folder of your own, with a short path"
            ) from None

    def open_again(self) -> socket.socket | None:
        """Make the socket again if it is lost or replaced; None if it is there or cannot be made.

        The folder is made again, too. Where that is not allowed the socket goes to a folder of its
        own among the temporary ones.
        """
        if self._is_there():
            return None
        for find in (self._wanted_place, self._temporary_place):
            try:
                listening = self._at(find())
            except OSError as error:
                self.problem = f"screens cannot attach: {self._wanted} is lost ({error.strerror})"
            else:
                self.problem = None
                return listening
        return None

    def close(self) -> None:
        if self._is_there():
            with suppress(OSError):
                self.path.unlink()
        if self.path.parent != self._wanted.parent:
            with suppress(OSError):
                self.path.parent.rmdir()

    def _is_there(self) -> bool:
        try:
            found = self.path.lstat()
        except OSError:
            return False
        return (found.st_dev, found.st_ino) == self._made

    def _wanted_place(self) -> Path:
        make_private(self._wanted.parent)
        folder = self._wanted.parent.lstat()
        if folder.st_uid != os.getuid() or folder.st_mode & 0o077:
            raise PermissionError(0, "others may enter its folder")
        if _answers(self._wanted):  # another engine's
            return self._wanted.with_stem(f"{self._wanted.stem}_{os.getpid()}")
        return self._wanted

    def _temporary_place(self) -> Path:
        return Path(tempfile.mkdtemp(prefix="madrob-")) / self._wanted.name

    def _at(self, path: Path) -> socket.socket:
        part = path.with_suffix(".new")
        part.unlink(missing_ok=True)
        listening = socket.socket(socket.AF_UNIX)
        try:
            os.fchmod(listening.fileno(), 0o600)  # before it has a path: nobody sees it otherwise
            listening.bind(str(part))
            listening.listen()
            found = part.lstat()
            part.replace(path)
        except OSError:
            listening.close()
            raise
        self.path, self._made = path, (found.st_dev, found.st_ino)
        return listening


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as knock:
        knock.settimeout(1.0)
        try:
            knock.connect(str(path))
        except (BlockingIOError, TimeoutError):
            return True
        except OSError:
            return False
        return True


# Errors around the engine that end nothing: logged once for each kind.


AGAIN = 600.0
"""The same trouble is logged again after this, s: a log must not grow with every screen."""

_MOST_KINDS = 50
_RETRY_PAUSE = 1.0


class FallenThreads:
    """Threads that ended with an unforeseen error: their work is missing from then on."""

    def __init__(self) -> None:
        self.problem: str | None = None

    def note(self, fallen: threading.ExceptHookArgs) -> None:
        """A hook for `threading.excepthook`; the log has the traceback."""
        name = "?" if fallen.thread is None else fallen.thread.name
        why = str(fallen.exc_value or "") or fallen.exc_type.__name__
        self.problem = terminal_safe(
            f"a part of the engine has ended ({name}: {why}): start it again after the run"
        )
        threading.__excepthook__(fallen)


class LogOnce:
    """Logs each kind of trouble once in a while, in one line."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._said: dict[tuple[str, str], float] = {}

    def log_trouble(self, what: str, error: BaseException | None = None) -> None:
        why = "" if error is None else f" ({str(error) or type(error).__name__})"
        kind = (what, type(error).__name__)
        now = self._monotonic()
        if now - self._said.get(kind, -AGAIN) < AGAIN or len(self._said) >= _MOST_KINDS:
            return
        self._said[kind] = now
        with suppress(OSError):  # a log that is full
            sys.stderr.write(f"madrob: {terminal_safe(what + why)}\n")
            sys.stderr.flush()

    def of_loop(self, _loop: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
        """An exception handler for an event loop: no traceback for each connection."""
        self.log_trouble(
            str(context.get("message", "the engine's socket")), context.get("exception")
        )

    async def lasting(self, work: Callable[[], Awaitable[None]]) -> None:
        while True:
            try:
                return await work()
            except Exception as error:  # noqa: BLE001 - whatever it is, screens wait for it
                self.log_trouble("screens had to wait", error)
                await asyncio.sleep(_RETRY_PAUSE)


# Accepting connections, as long as there are file handles for them.
#
# Without handles asyncio's own server fills the log with hundreds of thousands of lines, keeps a
# processor busy, and leaves no handle for a recording.


WANTED_HANDLES = 4096
"""File handles that an engine asks for; 1024 are usual, most of a testbed needs 200."""

MOST_SCREENS = 500
"""Most screens attached, but at most half the number of file handles."""

SPARE = 32
"""Places for connections under way, or for a referee."""

_PAUSE = 0.2
"""Pause before a waiting connection is tried again, s."""

_PARTING = 0.5
"""Time of a dismissed screen to read the last message, s."""

Attend = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def raise_handles() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = WANTED_HANDLES if hard == resource.RLIM_INFINITY else min(hard, WANTED_HANDLES)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))


def most_screens() -> int:
    """How many screens may attach, so that the engine keeps handles for its own files."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_SCREENS if soft == resource.RLIM_INFINITY else min(soft // 2, MOST_SCREENS)


class Acceptor:
    """Accepts connections until it is closed; without room a connection waits."""

    def __init__(
        self, listening: socket.socket, attend: Attend, most: int, troubles: LogOnce
    ) -> None:
        listening.setblocking(False)
        self._listening = listening
        self._attend = attend
        self._most = most
        self._troubles = troubles
        self._attending: set[asyncio.Task[None]] = set()
        self._task = asyncio.create_task(self._accept())

    async def _accept(self) -> None:
        try:
            while True:
                if len(self._attending) >= self._most:
                    await asyncio.wait(self._attending, return_when=asyncio.FIRST_COMPLETED)
                try:
                    await self._accept_one()
                except OSError as error:
                    self._troubles.log_trouble("new screens must wait", error)
                    await asyncio.sleep(_PAUSE)
        finally:
            self._listening.close()

    async def _accept_one(self) -> None:
        loop = asyncio.get_running_loop()
        connection, _ = await loop.sock_accept(self._listening)
        reader = asyncio.StreamReader(loop=loop)
        protocol = asyncio.StreamReaderProtocol(reader, loop=loop)
        try:
            transport, _ = await loop.connect_accepted_socket(lambda: protocol, connection)
        except BaseException:
            connection.close()
            raise
        writer = asyncio.StreamWriter(transport, protocol, reader, loop)
        task = asyncio.create_task(self._attended(reader, writer))
        self._attending.add(task)
        task.add_done_callback(self._attending.discard)

    async def _attended(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._attend(reader, writer)
        except Exception as error:  # noqa: BLE001 - one screen's trouble is no other's
            self._troubles.log_trouble("a screen was let go", error)
        finally:
            writer.close()
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), _PARTING)
            writer.transport.abort()

    def close(self) -> None:
        self._task.cancel()

    async def wait(self, patience: float) -> None:
        """After `close`: wait at most `patience` s for the end of all connections."""
        await asyncio.wait({self._task, *self._attending}, timeout=patience)
