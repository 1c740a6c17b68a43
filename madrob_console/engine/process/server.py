"""The engine's end of the socket: any number of screens, one of which may act.

The server runs beside the engine's thread and holds no state of the run. A screen that does not
read gets the latest snapshot when it does; nothing waits for it.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.engine.process.local import LocalEngine
from madrob_console.engine.shown import wire
from madrob_console.engine.shown.parts import OWN, Outgoing
from madrob_console.engine.shown.requests import Command, Request, Role, TakeOver
from madrob_console.engine.shown.snapshot import RightToAct
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

SENDING_PERIOD = 0.1
"""Between two looks at the engine, s."""

_CREDENTIALS = struct.Struct("3i")
_GREETING_TIME = 5.0


@dataclass(eq=False)
class _Screen:
    """A screen that is attached.

    Attributes:
        role: what for.
        who: for people.
        writer: to it.
        right: what it knows of its right to act; None = nothing yet.
        version: of the state that it was sent last.
        tasks: its requests that are being carried out.
    """

    role: Role
    who: str
    writer: asyncio.StreamWriter
    right: RightToAct | None = None
    version: int = 0
    tasks: set[asyncio.Task[None]] = field(default_factory=set)

    def send(self, message: msgspec.Struct) -> None:
        """Hand a message to the socket; never waits."""
        self.write(wire.frame(message))

    def write(self, frame: bytes) -> None:
        """The same with one that is encoded."""
        if not self.writer.is_closing():
            self.writer.write(frame)


class EngineServer:
    """Serves an engine on a Unix socket until it is told to stop or nobody needs it.

    Args:
        engine: running in its thread; the caller closes it.
        label: of its testbed.
        idle_time: ends by itself after so long without a screen and without a run, s.
        monotonic: a clock, s.
    """

    def __init__(
        self,
        engine: LocalEngine,
        label: str,
        idle_time: float,
        monotonic: Callable[[], float],
    ) -> None:
        self._engine = engine
        self._label = label
        self._idle_time = idle_time
        self._monotonic = monotonic
        self._screens: set[_Screen] = set()
        self._referee: _Screen | None = None
        self._outgoing = Outgoing()
        self._attending: set[asyncio.Task[None]] = set()
        self._over = asyncio.Event()

    async def serve(self, path: Path) -> None:
        """Serve until the end; the socket is made with mode 0600 and removed.

        Raises:
            OSError: the socket cannot be made.
        """
        server = await asyncio.start_unix_server(self._attend, sock=_listening(path))
        try:
            async with server:
                tasks = [
                    asyncio.create_task(self._end_when_idle()),
                    asyncio.create_task(self._keep_showing()),
                ]
                await self._over.wait()
                for task in tasks:
                    task.cancel()
                for screen in self._screens:
                    screen.writer.close()
                if self._attending:
                    await asyncio.wait(self._attending, timeout=1.0)
        finally:
            _remove(path)

    def stop(self) -> None:
        """End the server; from the loop's own thread."""
        self._over.set()

    # ------------------------------------------------------------------ screens

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._attending.add(task)
        try:
            hello = await _greeting(reader, writer)
        except (MadrobError, TimeoutError, OSError, asyncio.IncompleteReadError) as error:
            with suppress(OSError):
                writer.write(wire.frame(wire.Rejected(str(error) or "no greeting came")))
                writer.close()
        else:
            screen = _Screen(hello.role, terminal_safe(hello.who)[:100], writer)
            await self._serve_screen(screen, reader)
        finally:
            self._attending.discard(task)

    async def _serve_screen(self, screen: _Screen, reader: asyncio.StreamReader) -> None:
        if screen.role is Role.REFEREE and self._referee is None:
            self._referee = screen
        self._screens.add(screen)
        results = str(self._engine.results)
        screen.send(wire.Welcome(wire.VERSION, os.getpid(), self._label, results))
        try:
            self._look()
            self._show(screen)
            while True:
                call, request = wire.call_of(await _read(reader))
                task = asyncio.create_task(self._reply(screen, call, request))
                screen.tasks.add(task)
                task.add_done_callback(screen.tasks.discard)
        except MadrobError as error:
            screen.send(wire.Rejected(str(error)))
        except (OSError, asyncio.IncompleteReadError):
            pass  # it has gone
        finally:
            self._screens.discard(screen)
            if self._referee is screen:
                self._referee = None
            screen.writer.close()

    async def _keep_showing(self) -> None:
        """Send what is new, again and again."""
        while True:
            try:
                if self._screens:
                    self._look()
            except MadrobError as error:
                for screen in self._screens:
                    screen.send(wire.Rejected(str(error)))
                self.stop()
                return
            self._show_all()
            await asyncio.sleep(SENDING_PERIOD)

    def _show_all(self) -> None:
        """Send what is new to all screens but those that stall: they get the latest later."""
        for screen in self._screens:
            if screen.writer.transport.get_write_buffer_size() == 0:
                self._show(screen)

    def _look(self) -> None:
        """Take the engine's latest snapshot.

        Raises:
            MadrobError: the engine has failed.
        """
        self._outgoing.show(self._engine.snapshot(), self._monotonic())

    def _show(self, screen: _Screen) -> None:
        """Send a screen what is new to it."""
        alone = self._referee in (None, screen)
        right = RightToAct(screen.role, "" if alone else self._referee_name())
        if right != screen.right:
            screen.right = right
            screen.send(wire.State({OWN: wire.raw(right)}))
        if screen.version != self._outgoing.version:
            screen.write(self._outgoing.since(screen.version))
            screen.version = self._outgoing.version

    def _referee_name(self) -> str:
        return "" if self._referee is None else self._referee.who

    # ------------------------------------------------------------------ requests

    async def _reply(self, screen: _Screen, call: wire.Call, request: Request[Any]) -> None:
        try:
            answer = self._no_right(screen, request) or await asyncio.to_thread(
                self._engine.ask, request, call.deadline
            )
            self._look()
            self._show(screen)  # before the answer: it shows what was done
            reply = wire.Reply(call.number, wire.raw(answer))
        except MadrobError as error:
            reply = wire.Reply(call.number, failed=str(error))
        screen.send(reply)
        self._show_all()
        if self._engine.ended:
            self.stop()

    def _no_right(self, screen: _Screen, request: Request[Any]) -> str | None:
        """Why a screen may not act; the right goes to who asks for it, or first when it is free."""
        if not isinstance(request, Command):
            return None
        if screen.role is Role.WATCH:
            return "this screen only watches"
        if self._referee is None or isinstance(request, TakeOver):
            self._referee = screen
        if screen is not self._referee:
            return f"{self._referee_name()} has the right to act"
        return None

    async def _end_when_idle(self) -> None:
        idle_since = self._monotonic()
        while self._monotonic() - idle_since < self._idle_time:
            await asyncio.sleep(min(0.2, self._idle_time / 4))
            busy = self._screens or self._engine.busy
            if busy:
                idle_since = self._monotonic()
        self.stop()


def _listening(path: Path) -> socket.socket:
    """A socket at `path` that listens as soon as it can be seen there.

    One of an engine that was killed is replaced: the caller holds the lock.
    """
    part = path.with_suffix(".new")
    _remove(part)
    listening = socket.socket(socket.AF_UNIX)
    mask = os.umask(0o177)
    try:
        listening.bind(str(part))
        listening.listen()
        part.replace(path)
    except OSError:
        listening.close()
        raise
    finally:
        os.umask(mask)
    return listening


def _remove(path: Path) -> None:
    with suppress(FileNotFoundError):
        path.unlink()


async def _greeting(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> wire.Hello:
    """Who comes.

    Raises:
        MadrobError: somebody else's program, or one of another version.
        TimeoutError: it says nothing.
        asyncio.IncompleteReadError: it has gone.
    """
    _refuse_strangers(writer)
    async with asyncio.timeout(_GREETING_TIME):
        hello = wire.hello_of(await _read(reader))
    if hello.version != wire.VERSION:
        raise MadrobError(
            f"the engine speaks version {wire.VERSION}, the console {hello.version}: "
            "`madrob engine stop` ends the engine, then start the console again"
        )
    return hello


def _refuse_strangers(writer: asyncio.StreamWriter) -> None:
    """Only the user who runs the engine.

    Raises:
        MadrobError: it is somebody else.
    """
    connection: socket.socket = writer.get_extra_info("socket")
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(raw)
    if user not in (os.getuid(), 0):
        raise MadrobError("this engine belongs to another user")


async def _read(reader: asyncio.StreamReader) -> bytes:
    """The next message.

    Raises:
        MadrobError: it is too long.
        asyncio.IncompleteReadError: there is no more.
    """
    (length,) = wire.LENGTH.unpack(await reader.readexactly(wire.LENGTH.size))
    if length > wire.LARGEST_REQUEST:
        raise MadrobError(f"a request of {length} bytes is too long")
    return await reader.readexactly(length)
