"""The engine's end of the socket: any number of screens, one of which may act.

The server runs beside the engine's thread and holds no state of the run. A screen that does not
read gets the latest snapshot when it does; nothing waits for it.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine import wire
from madrob_console.engine.client import OWN, Outgoing
from madrob_console.engine.control import ENDING, WhoAnswer
from madrob_console.engine.engine_lock import peer_of
from madrob_console.engine.engine_thread import LocalEngine
from madrob_console.engine.requests import Command, Request, Role, TakeOver
from madrob_console.engine.server_socket import SPARE, Acceptor, Listening, LogOnce, most_screens
from madrob_console.engine.snapshot import RightToAct
from madrob_console.engine.wire import UnsureError, given_up

SENDING_PERIOD = 0.1
"""How often the engine's state is sent, s."""

LOOKING_PERIOD = 1.0
"""How often the socket is checked, s."""

MOST_UNDER_WAY = 16
"""Requests of one screen under way at the same time, and as many urgent ones."""

MOST_OF_WATCHERS = 2
"""The same for a screen that only watches: its next requests are not read before."""

LARGEST_BACKLOG = 8_000_000
"""Bytes that may wait for a screen that does not read; with more it is disconnected."""

TOO_MANY = "this screen has too many requests under way: wait for their answers"

_GREETING_TIME = 2.0


@dataclass(eq=False)
class _Screen:
    """A screen that is attached; `version` is of the state that it was sent last."""

    role: Role
    who: str
    writer: asyncio.StreamWriter
    right: RightToAct | None = None
    version: int = 0
    urgent: set[asyncio.Task[None]] = field(default_factory=set)
    others: set[asyncio.Task[None]] = field(default_factory=set)

    def send(self, message: msgspec.Struct) -> None:
        """Never waits."""
        self.write(wire.frame(message))

    def write(self, frame: bytes) -> None:
        """Send an encoded message; a screen that never reads is disconnected."""
        if self.backlog > LARGEST_BACKLOG:
            self.writer.transport.abort()
        if not self.writer.is_closing():
            self.writer.write(frame)

    @property
    def backlog(self) -> int:
        """In bytes."""
        return self.writer.transport.get_write_buffer_size()


class EngineServer:
    """Serves an engine on a Unix socket until it is told to stop or nobody needs it.

    It ends by itself after `idle_time` s without a screen and without a run. The caller
    closes the engine. `reachable` is set once screens can attach.
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
        self._troubles = LogOnce(monotonic)
        self._most = most_screens()
        self._news = asyncio.Event()
        self._over = asyncio.Event()
        self._acceptors: list[Acceptor] = []
        self.listening: Listening | None = None
        self.reachable = asyncio.Event()

    async def serve(self, path: Path) -> None:
        """Serve until the end; the socket has mode 0600, is made again if lost, and removed."""
        asyncio.get_running_loop().set_exception_handler(self._troubles.of_loop)
        listening = Listening(path)
        self._accept_at(listening.open())
        self.listening = listening  # whoever asks is told of it once it is there
        self.reachable.set()
        try:
            tasks = [
                asyncio.create_task(self._troubles.lasting(self._end_when_idle)),
                asyncio.create_task(self._troubles.lasting(self._keep_showing)),
                asyncio.create_task(self._troubles.lasting(self._keep_reachable)),
            ]
            await self._over.wait()
            for task in tasks:
                task.cancel()
            for screen in self._screens:
                screen.writer.close()
            for acceptor in self._acceptors:
                acceptor.close()
                await acceptor.wait(1.0)
        finally:
            for acceptor in self._acceptors:
                acceptor.close()
            listening.close()

    def stop(self) -> None:
        """End the server; from the loop's own thread."""
        self._over.set()

    def presence(self, known: WhoAnswer) -> WhoAnswer:
        """What the engine says of itself to consoles of all versions; from any thread."""
        snapshot, listening = self._engine.snapshot(), self.listening
        lost = None if listening is None else listening.problem
        known = known.with_run(snapshot.run, busy=self._engine.busy, unsaved=self._engine.unsaved)
        return replace(
            known,
            phase=ENDING if self._over.is_set() else known.phase,
            testbed=snapshot.label,
            socket="" if listening is None else str(listening.path),
            screens=len(self._screens),
            remarks=(
                *known.remarks,
                *filter(None, (snapshot.pulse.words, lost)),
                *self._engine.not_on_disk,
                *self._engine.open_protests,
            ),
        )

    def _accept_at(self, listening: socket.socket) -> None:
        """Let screens attach at this socket only; attached screens stay."""
        for acceptor in self._acceptors:
            acceptor.close()
        self._acceptors.append(
            Acceptor(listening, self._attend, self._most + SPARE, self._troubles)
        )

    async def _keep_reachable(self) -> None:
        assert self.listening is not None
        pool = ThreadPoolExecutor(1, "socket")  # a disk may hold it up
        loop = asyncio.get_running_loop()
        try:
            while True:
                await asyncio.sleep(LOOKING_PERIOD)
                again = await loop.run_in_executor(pool, self.listening.open_again)
                if again is not None:
                    self._accept_at(again)
        finally:
            pool.shutdown(wait=False)

    # ------------------------------------------------------------------ screens

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            hello = await _greeting(reader, writer)
            self._refuse_too_many(hello.role)
        except (MadrobError, TimeoutError, OSError, asyncio.IncompleteReadError) as error:
            with suppress(OSError):
                writer.write(wire.frame(wire.Rejected(str(error) or "no greeting came")))
        else:
            screen = _Screen(hello.role, terminal_safe(hello.who)[:100], writer)
            await self._serve_screen(screen, reader)

    def _refuse_too_many(self, role: Role) -> None:
        """Leave file handles for the engine's own files, and a place for a referee."""
        most = self._most + (SPARE // 2 if role is Role.REFEREE else 0)
        if len(self._screens) >= most:
            raise MadrobError(
                f"{len(self._screens)} screens are attached, more than the engine has file handles "
                "for: close one, or raise `ulimit -n` before the engine starts"
            )

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
                await self._take(screen, *wire.call_of(await _read(reader)))
                await screen.writer.drain()  # who does not read the answers asks no more
                await asyncio.sleep(0)  # the others' turn, however much it has sent
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
        while True:
            try:
                if self._screens:
                    self._look()
            except MadrobError as error:
                for screen in self._screens:
                    screen.send(wire.Rejected(str(error)))
                self.stop()
                return
            await self._show_all()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), SENDING_PERIOD)
            self._news.clear()

    async def _show_all(self) -> None:
        """Send what is new to all screens but those that stall: they get the latest later."""
        for screen in sorted(self._screens, key=lambda screen: screen is not self._referee):
            if screen.backlog == 0:
                self._show(screen)
            await asyncio.sleep(0)  # however many screens there are, requests are taken meanwhile

    def _look(self) -> None:
        self._outgoing.show(self._engine.snapshot(), self._monotonic())

    def _show(self, screen: _Screen) -> None:
        alone = self._referee in (None, screen)
        right = RightToAct(
            screen.role, "" if alone else self._referee_name(), free=self._referee is None
        )
        if right != screen.right:
            screen.right = right
            screen.send(wire.State({OWN: wire.raw(right)}))
        if screen.version != self._outgoing.version:
            screen.write(self._outgoing.since(screen.version))
            screen.version = self._outgoing.version

    def _referee_name(self) -> str:
        return "" if self._referee is None else self._referee.who

    # ------------------------------------------------------------------ requests

    async def _take(self, screen: _Screen, call: wire.Call, request: Request[Any]) -> None:
        """Have a request carried out; waits where a screen that only watches asks for much."""
        if (refused := self._no_right(screen, request)) is not None:
            screen.send(wire.Reply(call.number, wire.raw(refused)))
            return
        under_way = screen.urgent if request.urgent else screen.others
        if screen.role is Role.WATCH:
            while len(under_way) >= MOST_OF_WATCHERS:
                await asyncio.wait(under_way, return_when=asyncio.FIRST_COMPLETED)
        elif len(under_way) >= MOST_UNDER_WAY:
            screen.send(wire.Reply(call.number, failed=TOO_MANY))
            return
        task = asyncio.create_task(self._reply(screen, call, request))
        under_way.add(task)
        task.add_done_callback(under_way.discard)

    async def _reply(self, screen: _Screen, call: wire.Call, request: Request[Any]) -> None:
        first = screen is self._referee
        now = self._monotonic()
        deadline = min(now + request.latest_begin, call.deadline)
        patience = deadline + request.effect_time - now
        try:
            answer = self._engine.begin_request(request, deadline, first=first)
            value = await asyncio.wait_for(asyncio.wrap_future(answer), patience)
            reply = wire.Reply(call.number, wire.raw(value))
        except TimeoutError:
            why = given_up(answer)
            unsure = isinstance(why, UnsureError)
            reply = wire.Reply(call.number, failed=str(why), unsure=unsure)
        except MadrobError as error:
            reply = wire.Reply(call.number, failed=str(error))
        except Exception as error:  # noqa: BLE001 - the screen waits for an answer
            self._troubles.log_trouble("a request failed", error)
            reply = wire.Reply(call.number, failed=f"the engine cannot do that now ({error})")
        if isinstance(request, Command):
            with suppress(MadrobError):  # it has failed: all screens are told at the next look
                self._look()
            self._show(screen)  # before the answer: it shows what was done
            screen.send(reply)
            self._news.set()
        else:
            screen.send(reply)

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
            # what the disk refuses is nowhere else
            busy = self._screens or self._engine.busy or self._engine.unsaved
            if busy:
                idle_since = self._monotonic()
        self.stop()


async def _greeting(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> wire.Hello:
    """The first message of a screen; `TimeoutError` if it sends nothing."""
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
    if peer_of(writer.get_extra_info("socket")).user not in (os.getuid(), 0):
        raise MadrobError("this engine belongs to another user")


async def _read(reader: asyncio.StreamReader) -> bytes:
    (length,) = wire.LENGTH.unpack(await reader.readexactly(wire.LENGTH.size))
    if length > wire.LARGEST_REQUEST:
        raise MadrobError(f"a request of {length} bytes is too long")
    return await reader.readexactly(length)
