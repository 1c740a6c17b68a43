"""Requests to the engine without an answer yet, and the words shown meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.engine_interface import UnsureError
from madrob_console.engine.requests import Perform
from madrob_console.referee.acts import Abort
from madrob_console.ui.cells.lines import Tone

if TYPE_CHECKING:
    from madrob_console.engine.playback import PlaybackCommand
    from madrob_console.engine.requests import (
        ExportDossier,
        ExportTeam,
        GiveFrames,
        OpenRun,
        Request,
        T,
        TakeOver,
    )
    from madrob_console.ui.frame.console_screen import ConsoleScreen
    from madrob_console.ui.link import EngineLink

PATIENCE = 0.2
"""A key waits so long for what the one before brings about, s."""


async def _at_most(duration: float, over: asyncio.Event) -> None:
    """Waits for an event, `duration` s at most."""
    with suppress(TimeoutError):
        await asyncio.wait_for(over.wait(), duration)


class PendingRequests:
    """Requests that keys have made; each is made once at a time."""

    def __init__(
        self,
        link: EngineLink,
        console: ConsoleScreen,
        beside: Callable[[Coroutine[Any, Any, None]], object],
    ) -> None:
        self._link = link
        self._console = console
        self._beside = beside
        self._durable: dict[str, bool] = {}

    async def soon(self, deed: Coroutine[Any, Any, None], what: str) -> None:
        """Starts what a key brings about; the next key waits for it, but not for long."""
        over = asyncio.Event()

        async def bring_about() -> None:
            try:
                await deed
            finally:
                over.set()

        self._beside(bring_about())
        await _at_most(PATIENCE, over)
        if not over.is_set() and not self._tell_wait(what):  # it comes soon, or is asked later

            async def tell() -> None:
                while not (over.is_set() or self._tell_wait(what)):
                    await _at_most(PATIENCE, over)

            self._beside(tell())

    async def carry_out(
        self,
        command: Perform | OpenRun | PlaybackCommand | TakeOver | ExportTeam | ExportDossier,
        words: str | None = None,
        *,
        durable: bool = False,
    ) -> bool:
        """Carries out a command, says what became of it, and returns whether it took effect.

        Meanwhile the keys work; a `durable` one waits for the disk and can be withdrawn.
        """
        try:
            refused = await self._once(command.name, command, durable=durable)
        except UnsureError as error:
            self._console.say(f"{command.name}: {error}", Tone.BAD)
            return False
        except MadrobError as error:
            refused = str(error)
        self._console.poll()  # first: what it shows takes the place of the message
        if refused is not None:
            self._console.refuse(command.name, refused)
        elif words is not None:
            self._console.say(words, Tone.GOOD)
        return refused is None

    async def frames(self, request: GiveFrames) -> None:
        try:
            self._console.frames = await self._once(request.name, request)
        except MadrobError as error:
            self._console.refuse(request.name, str(error))
        else:
            self._console.say(f"y copies where they are: {self._console.frames}", Tone.GOOD)

    async def _once(self, what: str, request: Request[T], *, durable: bool = False) -> T:
        if what in self._durable:
            raise MadrobError("the one before is not answered yet")
        self._durable[what] = durable
        try:
            return await self._link.answer(request)
        finally:
            del self._durable[what]

    def withdraw(self) -> bool:
        """Withdraws what waits for the disk; False if nothing does."""
        if (what := self._for_the_disk) is None:
            return False
        self._beside(self._withdraw(what))
        return True

    async def _withdraw(self, what: str) -> None:
        self._console.say(f"{what}: withdrawing it ...", Tone.WARN)
        if (refused := await self._link.refusal_of(Abort())) is not None:
            self._console.refuse(Abort.name, refused)

    @property
    def _for_the_disk(self) -> str | None:
        return next((what for what, durable in self._durable.items() if durable), None)

    def _tell_wait(self, what: str) -> bool:
        if not self._link.asking:
            return False
        words = "working ..., the keys go on"
        if (for_the_disk := self._for_the_disk) is not None:
            what, words = for_the_disk, "waiting for the disk; F8 or Escape withdraws it"
        self._console.say(f"{what}: {words}", Tone.WARN)
        return True
