"""The engine's end of the socket: what it is, its end, and its screens, one of which may act.

The server runs beside the engine's thread and holds no state of the run. A screen that does not
read gets the latest snapshot when it does; nothing waits for it. Errors around the engine, which
end nothing, are logged once for each kind.
"""

from __future__ import annotations

import asyncio
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, Self

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc import greeting, wire
from madrob_console.engine.ipc.engine_interface import ServedEngine, UnsureError, given_up
from madrob_console.engine.ipc.greeting import WhoAnswer
from madrob_console.engine.requests import Command, Request, Role, TakeOver
from madrob_console.engine.snapshot import RightToAct, Snapshot

SENDING_PERIOD = 0.1
"""How often the engine's state is sent, s."""

SIGN_OF_LIFE = 0.5
"""How often an engine without news sends its time, s; its pulse says if its core stands still."""

MOST_SCREENS = 20
"""Most screens attached."""

FOR_REFEREES = 4
"""Places among them that screens which only watch leave free."""

MOST_CALLERS = 32
"""Connections besides those of screens; more wait."""

MOST_UNDER_WAY = 16
"""Requests of one screen under way at the same time, and as many urgent ones."""

MOST_OF_WATCHERS = 2
"""The same for a screen that only watches: its next requests are not read before."""

TOO_MANY = "this screen has too many requests under way: wait for their answers"

STARTING = greeting.Rejected("is starting", again=True)
_ENDS = greeting.Rejected("is ending and not gone yet: a disk may hold it up", again=True)

_GREETING_TIME = 2.0
_PARTING_TIME = 0.5
"""Time of a caller to read the last message, s."""

_PAUSE = 0.2
"""Pause before a waiting connection is tried again, s."""


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
        if not self.writer.is_closing():
            self.writer.write(wire.frame(message))

    @property
    def backlog(self) -> int:
        """In bytes."""
        return self.writer.transport.get_write_buffer_size()


class LatestState:
    """The engine's state for its screens, encoded once when it has changed."""

    def __init__(self) -> None:
        self.version = 0
        self.encoded = msgspec.Raw()
        self._sent: Snapshot | None = None
        self._sent_at = 0.0

    def update(self, snapshot: Snapshot, now: float) -> None:
        """Take the engine's latest snapshot; `now` is s of a monotonic clock."""
        sent = self._sent
        lately = now - self._sent_at < SIGN_OF_LIFE
        if lately and sent is not None and replace(snapshot, time=sent.time) == sent:
            return
        self.version += 1
        self.encoded = wire.raw(snapshot)
        self._sent, self._sent_at = snapshot, now


class EngineServer:
    """Answers on an engine's socket while inside, in a thread of its own.

    From the beginning it says what the engine is (`describe`, which must not wait) and grants or
    refuses its end; a stop that is granted is a SIGTERM to this process. Screens attach after
    `admit_screens`; before, they are `rejected`. `over` gets an item when nobody needs the engine
    any more, or it has failed.
    """

    def __init__(
        self,
        listening: socket.socket,
        description: WhoAnswer,
        rejected: greeting.Rejected = STARTING,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        listening.setblocking(False)
        self._listening = listening
        self.describe: Callable[[], WhoAnswer] = lambda: description
        self._own_description = description
        self._rejected: greeting.Rejected | None = rejected
        self._monotonic = monotonic
        self.over: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._screens: set[_Screen] = set()
        self._referee: _Screen | None = None
        self._latest = LatestState()
        self._troubles = LogOnce(monotonic)
        self._callers: set[asyncio.Task[None]] = set()
        self._showing: list[asyncio.Task[None]] = []
        self._loop = asyncio.new_event_loop()
        self._news, self._stop = asyncio.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    def admit_screens(self, engine: ServedEngine, description: WhoAnswer, idle_time: float) -> None:
        """Let screens attach; `over` after `idle_time` s without a screen and without a run."""
        self._engine, self._own_description = engine, description
        self._loop.call_soon_threadsafe(self._admit, idle_time)

    def _admit(self, idle_time: float) -> None:
        self.describe, self._rejected = self._presence, None
        works = self._keep_showing, lambda: self._end_when_idle(idle_time)
        self._showing = [self._loop.create_task(self._troubles.lasting(work)) for work in works]

    def dismiss_screens(self) -> None:
        """Disconnect all screens: the engine ends, and tells new clients that it does."""
        self._loop.call_soon_threadsafe(self._dismiss)

    def _dismiss(self) -> None:
        self._rejected = _ENDS
        for task in self._showing:
            task.cancel()
        for screen in self._screens:
            screen.writer.close()

    def _run(self) -> None:
        self._loop.set_exception_handler(self._troubles.of_loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        self._listen()
        await self._stop.wait()
        self._loop.remove_reader(self._listening)
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=1.0)

    # ------------------------------------------------------------------ callers

    def _listen(self) -> None:
        """Accept connections; without room or file handles they wait."""
        if len(self._callers) < MOST_SCREENS + MOST_CALLERS and not self._stop.is_set():
            self._loop.add_reader(self._listening, self._accept)

    def _accept(self) -> None:
        try:
            connection, _ = self._listening.accept()
        except BlockingIOError:
            return
        except OSError as error:
            self._troubles.log_trouble("new screens must wait", error)
            self._loop.remove_reader(self._listening)
            self._loop.call_later(_PAUSE, self._listen)
            return

        def leave(task: asyncio.Task[None]) -> None:
            connection.close()
            self._callers.discard(task)
            self._listen()

        task = self._loop.create_task(self._attend(connection))
        self._callers.add(task)
        task.add_done_callback(leave)
        if len(self._callers) >= MOST_SCREENS + MOST_CALLERS:
            self._loop.remove_reader(self._listening)

    async def _attend(self, connection: socket.socket) -> None:
        reader, writer = await asyncio.open_unix_connection(sock=connection)
        try:
            async with asyncio.timeout(_GREETING_TIME):
                first = wire.first_of(await _read(reader))
            await self._answer(first, reader, writer)
        except MadrobError as error:
            writer.write(wire.frame(greeting.Rejected(str(error))))
        except (OSError, asyncio.IncompleteReadError):
            pass  # it has gone, or sent nothing
        except Exception as error:  # noqa: BLE001 - one screen's trouble is no other's
            self._troubles.log_trouble("a screen was let go", error)
        finally:
            writer.close()
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), _PARTING_TIME)
            writer.transport.abort()

    async def _answer(
        self, first: wire.First, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        match first:
            case greeting.Who():
                writer.write(wire.frame(self._description()))
            case greeting.Stop(force):
                against = "" if force else self._description().against_stopping
                writer.write(wire.frame(greeting.StopAnswer(against)))
                if not against:
                    os.kill(os.getpid(), signal.SIGTERM)
            case greeting.Hello(version) if version != wire.VERSION:
                self._troubles.log_trouble(
                    f"a console of version {version} was rejected: this engine speaks version "
                    f"{wire.VERSION}"
                )
                raise MadrobError(
                    f"the engine speaks version {wire.VERSION}, this console {version}: `madrob "
                    f"engine stop --pid {os.getpid()}` ends it, then start the console again"
                )
            case greeting.Hello() if self._rejected is not None:
                writer.write(wire.frame(self._rejected))
            case greeting.Hello(_, role, who):
                self._refuse_too_many(role)
                await self._serve_screen(_Screen(role, terminal_safe(who)[:100], writer), reader)

    def _description(self) -> WhoAnswer:
        try:
            return self.describe()
        except Exception as error:  # noqa: BLE001  whatever has failed: it can still be stopped
            return msgspec.structs.replace(self._own_description, phase="failed", run=str(error))

    def _presence(self) -> WhoAnswer:
        engine = self._engine
        snapshot = engine.snapshot()
        description = self._own_description.with_run(
            snapshot.run, busy=engine.busy, unsaved=engine.unsaved
        )
        pulse = snapshot.pulse.words
        return msgspec.structs.replace(
            description,
            phase=description.phase if self._rejected is None else wire.ENDING,
            testbed=snapshot.label,
            screens=len(self._screens),
            remarks=(
                *description.remarks,
                *([] if pulse is None else [pulse]),
                *engine.not_on_disk,
            ),
        )

    # ------------------------------------------------------------------ screens

    def _refuse_too_many(self, role: Role) -> None:
        most = MOST_SCREENS - (FOR_REFEREES if role is Role.WATCH else 0)
        if len(self._screens) >= most:
            raise MadrobError(f"{len(self._screens)} screens are attached, the most: close one")

    async def _serve_screen(self, screen: _Screen, reader: asyncio.StreamReader) -> None:
        if screen.role is Role.REFEREE and self._referee is None:
            self._referee = screen
        self._screens.add(screen)
        try:
            self._look()
            screen.send(wire.Welcome(str(self._engine.results), self._state_for(screen)))
            while True:
                await self._take(screen, *wire.call_of(await _read(reader)))
                await screen.writer.drain()  # who does not read the answers asks no more
                await asyncio.sleep(0)  # the others' turn, however much it has sent
        finally:
            self._screens.discard(screen)
            if self._referee is screen:
                self._referee = None

    async def _keep_showing(self) -> None:
        while True:
            try:
                if self._screens:
                    self._look()
            except MadrobError as error:
                for screen in self._screens:
                    screen.send(greeting.Rejected(str(error)))
                self.over.put(None)
                return
            # a screen that stalls gets the latest state when it reads again
            for screen in sorted(self._screens, key=lambda screen: screen is not self._referee):
                if screen.backlog == 0:
                    self._show(screen)
            with suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), SENDING_PERIOD)
            self._news.clear()

    def _look(self) -> None:
        self._latest.update(self._engine.snapshot(), self._monotonic())

    def _show(self, screen: _Screen) -> None:
        if (screen.version, screen.right) != (self._latest.version, self._right_of(screen)):
            screen.send(self._state_for(screen))

    def _state_for(self, screen: _Screen) -> wire.State:
        screen.version, screen.right = self._latest.version, self._right_of(screen)
        return wire.State(self._latest.encoded, wire.raw(screen.right))

    def _right_of(self, screen: _Screen) -> RightToAct:
        alone = self._referee in (None, screen)
        return RightToAct(
            screen.role, "" if alone else self._referee_name(), free=self._referee is None
        )

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
            try:
                value = await asyncio.wait_for(asyncio.wrap_future(answer), patience)
            except TimeoutError:
                value = given_up(answer)
            reply = wire.Reply(call.number, wire.raw(value))
        except MadrobError as error:
            unsure = isinstance(error, UnsureError)
            reply = wire.Reply(call.number, failed=str(error), unsure=unsure)
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
        """Why a screen may not act; a free right to act goes to the first that asks."""
        if not isinstance(request, Command):
            return None
        if screen.role is Role.WATCH:
            return "this screen only watches"
        if self._referee is None or isinstance(request, TakeOver):
            self._referee = screen
        if screen is not self._referee:
            return f"{self._referee_name()} has the right to act"
        return None

    async def _end_when_idle(self, idle_time: float) -> None:
        idle_since = self._monotonic()
        while self._monotonic() - idle_since < idle_time:
            await asyncio.sleep(min(0.2, idle_time / 4))
            # what the disk refuses is nowhere else
            if self._screens or self._engine.busy or self._engine.unsaved:
                idle_since = self._monotonic()
        self.over.put(None)


async def _read(reader: asyncio.StreamReader) -> bytes:
    (length,) = wire.LENGTH.unpack(await reader.readexactly(wire.LENGTH.size))
    if length > wire.LARGEST_REQUEST:
        raise MadrobError(f"a request of {length} bytes is too long")
    return await reader.readexactly(length)


AGAIN = 600.0
"""The same trouble is logged again after this, s: a log must not grow with every screen."""

_MOST_KINDS = 50
_RETRY_PAUSE = 1.0


class LogOnce:
    """Logs each kind of trouble once in a while, in one line."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._logged_at: dict[tuple[str, str], float] = {}

    def log_trouble(self, what: str, error: BaseException | None = None) -> None:
        why = "" if error is None else f" ({str(error) or type(error).__name__})"
        kind = (what, type(error).__name__)
        now = self._monotonic()
        if now - self._logged_at.get(kind, -AGAIN) < AGAIN or len(self._logged_at) >= _MOST_KINDS:
            return
        self._logged_at[kind] = now
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
