"""Drives the console in a test: keys in, text of the screen out."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from textual.events import Event
from textual.pilot import Pilot

from madrob_console.config.tables import ConsoleSettings
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.defaults import ConsoleDefaults
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.type_ahead import TypeAhead
from tests.madrob_console.ui.drawn import drawn
from tests.madrob_console.ui.fake_engine import FakeEngine

SMALL = (80, 24)
LARGE = (120, 36)
DEFAULTS = ConsoleDefaults(
    competition="Autumn Cup", results=Path("/results"), team="Door Bots", referee="Ada"
)


LOOKING = 3.0
"""Between two keys of somebody who looks at the screen, s."""


@dataclass
class Hand:
    """When keys are typed: time passes with each of them, and otherwise stands still.

    Attributes:
        gap: between two keys, s.
        now: the time, s.
    """

    gap: float = LOOKING
    now: float = 1000.0

    def __post_init__(self) -> None:
        self._last: Event | None = None

    def typed(self, event: Event) -> float:
        """The time of a key."""
        if event is not self._last:
            self._last = event
            self.now += self.gap
        return self.now


@dataclass
class Driver:
    """The console under test."""

    app: MadrobApp
    engine: FakeEngine
    pilot: Pilot[None]
    hand: Hand

    @property
    def console(self) -> ConsoleScreen:
        screen = self.app.screen
        assert isinstance(screen, ConsoleScreen)
        return screen

    async def press(self, *keys: str) -> None:
        """Press keys and let the screen follow."""
        await self.pilot.press(*keys)
        await self.settle()

    async def type(self, text: str) -> None:
        """Type a text."""
        await self.press(*("space" if char == " " else char for char in text))

    async def set_up(self) -> None:
        """A run is set up and its pose confirmed."""
        await self.press("f2", "enter", "f6")

    async def run(self) -> None:
        """A run goes on for a second."""
        await self.set_up()
        await self.press("f5")
        await self.let_pass(6.0)

    async def let_pass(self, duration: float) -> None:
        """Time of the engine."""
        self.engine.tick(duration)
        await self.settle()

    async def settle(self) -> None:
        """Look at the engine once more and let all messages pass."""
        await self.pilot.pause()
        if isinstance(self.app.screen, ConsoleScreen):  # else the palette is in front
            self.console.poll()
        await drawn(self.pilot)

    def rows(self) -> Sequence[str]:
        """The screen as text."""
        width, height = self.app.size
        strips = self.app.screen._compositor.render_strips()
        return [strip.text[:width].rstrip() for strip in strips[:height]]

    @property
    def text(self) -> str:
        return "\n".join(self.rows())


@asynccontextmanager
async def driving(
    engine: FakeEngine,
    size: tuple[int, int] = SMALL,
    defaults: ConsoleDefaults = DEFAULTS,
    monotonic: Callable[[], float] = lambda: 0.0,
    look: ConsoleSettings | None = None,
    gap: float = LOOKING,
) -> AsyncIterator[Driver]:
    """The console on `engine`, in a terminal of `size`; time stands still for the screens.

    Keys are typed `gap` seconds one after the other.
    """
    hand = Hand(gap)
    ahead = TypeAhead(lambda: hand.now, hand.typed)
    app = MadrobApp(lambda: engine, defaults, look, monotonic, lambda: engine.now, ahead)
    async with app.run_test(size=size) as pilot:
        driver = Driver(app, engine, pilot, hand)
        await app.workers.wait_for_complete()
        await driver.settle()
        yield driver
