"""The engine's end of the socket: its screens, one of which may act."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from madrob_console.common.errors import MadrobError
from madrob_console.referee.acts import act_named
from tests.slice import wire
from tests.slice.acts import Acts

STATE_PERIOD = 0.1
"""How often screens get the state, s."""

GREETING_TIME = 2.0
"""Who does not say what it is within this time is let go, s."""

MOST_SCREENS = 20
MOST_UNDER_WAY = 16
"""Requests of one screen under way at the same time."""


class Shown(Protocol):
    """The engine, as its screens see it."""

    acts: Acts

    def state(self, holder: str) -> wire.State:
        """Return what screens show now."""


@dataclass(eq=False)
class _Screen:
    hello: wire.Hello
    writer: asyncio.StreamWriter
    requests: set[asyncio.Task[None]] = field(default_factory=set)


class Server:
    """Shows the engine to its screens and has their requests carried out."""

    def __init__(self, engine: Shown) -> None:
        self._engine = engine
        self._screens: list[_Screen] = []
        self._holder: _Screen | None = None

    async def serve(self, socket: Path) -> None:
        """Serve screens on a socket, as long as the program runs."""
        async with await asyncio.start_unix_server(self._attend, socket):
            while True:
                self.show()
                await asyncio.sleep(STATE_PERIOD)

    def show(self) -> None:
        """Send the state to each screen that has read the one before."""
        if not self._screens:
            return
        holder = "" if self._holder is None else self._holder.hello.who
        state = wire.frame(self._engine.state(holder))
        for screen in self._screens:
            if screen.writer.transport.get_write_buffer_size() == 0:
                screen.writer.write(state)

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection to its end."""
        try:
            async with asyncio.timeout(GREETING_TIME):
                hello = await wire.receive(reader)
            await self._serve_screen(self._admit(hello, writer), reader)
        except MadrobError as error:
            writer.write(wire.frame(wire.Rejected(str(error))))
        except (OSError, EOFError, TimeoutError, asyncio.CancelledError):
            pass  # it has gone, or said nothing, or the engine ends
        finally:
            writer.close()

    def _admit(self, hello: wire.Message, writer: asyncio.StreamWriter) -> _Screen:
        if not isinstance(hello, wire.Hello):
            raise MadrobError("no greeting")
        if len(self._screens) >= MOST_SCREENS:
            raise MadrobError(f"{MOST_SCREENS} screens are attached, the most: close one")
        return _Screen(hello, writer)

    async def _serve_screen(self, screen: _Screen, reader: asyncio.StreamReader) -> None:
        self._screens.append(screen)
        if screen.hello.role is wire.Role.REFEREE and self._holder is None:
            self._holder = screen
        try:
            self.show()
            while True:
                self._take(screen, await wire.receive(reader))
                await screen.writer.drain()  # who does not read the answers asks no more
        finally:
            self._screens.remove(screen)
            if self._holder is screen:
                self._holder = None

    def _take(self, screen: _Screen, request: wire.Message) -> None:
        if not isinstance(request, wire.Perform | wire.TakeOver):
            raise MadrobError("no request")
        if len(screen.requests) >= MOST_UNDER_WAY:
            refused = "too many requests are under way: wait for their answers"
            screen.writer.write(wire.frame(wire.Answer(request.number, refused)))
            return
        task = asyncio.create_task(self._reply(screen, request))
        screen.requests.add(task)
        task.add_done_callback(screen.requests.discard)

    async def _reply(self, screen: _Screen, request: wire.Perform | wire.TakeOver) -> None:
        refusal = self._no_right(screen, request)
        if refusal is None and isinstance(request, wire.Perform):
            refusal = await self._perform(request)
        self.show()  # before the answer: it shows what was done
        screen.writer.write(wire.frame(wire.Answer(request.number, refusal)))

    async def _perform(self, request: wire.Perform) -> str | None:
        if time.monotonic() > request.deadline:
            return "the engine did not answer in time: nothing was done"
        try:
            act = act_named(request.name, request.details)
        except MadrobError as error:
            return str(error)
        return await self._engine.acts.perform(act, request.id)

    def _no_right(self, screen: _Screen, request: wire.Perform | wire.TakeOver) -> str | None:
        """Why a screen may not act.

        A free right goes to the first that asks.
        """
        if screen.hello.role is wire.Role.WATCH:
            return "this screen only watches"
        if self._holder is None or isinstance(request, wire.TakeOver):
            self._holder = screen
        if self._holder is not screen:
            return f"{self._holder.hello.who} has the right to act"
        return None
