"""A screen's end of the socket, without a screen: it asks and keeps the newest state."""

from __future__ import annotations

import asyncio
import itertools
import os
import time
from collections.abc import Callable
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.referee.acts import Act, act_details
from tests.slice import wire

PATIENCE = 5.0
"""How long an answer may take, s.

What has not begun 2.5 s before its end never happens.
"""

EFFECT_TIME = 2.5

STATE_PATIENCE = 700.0
"""How long a state is waited for, s."""


class Client:
    """One screen attached to an engine.

    Attributes:
        state: the newest; None before the first.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[str | None]] = {}
        self._news = asyncio.Event()
        self.state: wire.State | None = None

    async def attach(self, socket: Path, role: wire.Role, who: str) -> None:
        """Attach to an engine.

        OSError where there is none.
        """
        reader, self._writer = await asyncio.open_unix_connection(socket)
        self._writer.write(wire.frame(wire.Hello(role, who)))
        self._listening = asyncio.create_task(self._listen(reader))

    async def perform(self, act: Act) -> str | None:
        """Have an act done and return its refusal, or None.

        TimeoutError without an answer.
        """
        deadline = time.monotonic() + PATIENCE - EFFECT_TIME
        number = next(self._numbers)
        act_id = os.urandom(8).hex()
        request = wire.Perform(number, deadline, act.name, act_details(act), act_id)
        answer = self._waiting[number] = asyncio.get_running_loop().create_future()
        self._writer.write(wire.frame(request))
        try:
            return await asyncio.wait_for(answer, PATIENCE)
        finally:
            del self._waiting[number]

    async def until(self, holds: Callable[[wire.State], bool]) -> wire.State:
        """Return the first state of which something holds."""
        async with asyncio.timeout(STATE_PATIENCE):
            while self.state is None or not holds(self.state):
                self._news.clear()
                await self._news.wait()
        return self.state

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        while True:
            match await wire.receive(reader):
                case wire.State() as state:
                    self.state = state
                    self._news.set()
                case wire.Answer(number, refusal) if number in self._waiting:
                    self._waiting[number].set_result(refusal)
                case wire.Rejected(reason):
                    raise MadrobError(reason)

    def close(self) -> None:
        self._listening.cancel()
        self._writer.close()
