"""Drives the console in a test: keys in, text of the screen out; stories as tables of keys."""

from __future__ import annotations

import asyncio
import inspect
import shlex
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from textual.app import App, ComposeResult
from textual.containers import Container
from textual.events import Event
from textual.message import Message
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widget import Widget

from madrob_console.config.tables import ConsoleSettings
from madrob_console.referee.acts import Act
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.cells.table import Table
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.console_app import TypeAhead
from madrob_console.ui.link import ConsoleDefaults
from madrob_console.ui.panes.result_pane import ResultsPane
from madrob_console.ui.panes.runs_pane import HistoryPane, RunsPane
from madrob_console.ui.panes.standings_pane import StandingsPane
from scoring.protocol import Outcome
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
    remembered: Sequence[Act] = ()
    """The engine's acts when a story asked to keep them in mind."""

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

    async def look_thrice(self) -> None:
        """The log, and what is known so far, wait for every third look."""
        for _ in range(3):
            await self.settle()

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

    async def answered(self, *keys: str) -> None:
        """Press keys; what waits for the engine has its answer."""
        await self.pilot.press(*keys)
        await self.settle()
        await self.app.workers.wait_for_complete()
        await self.settle()

    async def finish(
        self, outcome: Outcome = Outcome.COMPLETED, reason: str = "step 6 is done"
    ) -> None:
        """The run ends by itself."""
        self.engine.finish(outcome, reason)
        await self.settle()

    def rows(self) -> Sequence[str]:
        """The screen as text."""
        return rows_of(self.app)

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


def rows_of(app: App[None]) -> list[str]:
    """What an app shows, as text."""
    width, height = app.size
    strips = app.screen._compositor.render_strips()
    return [strip.text[:width].rstrip() for strip in strips[:height]]


async def drawn(pilot: Pilot[None]) -> None:
    """Until nothing is left to be drawn.

    A pilot pauses until the process takes little of the processor, which on a busy machine says
    nothing: other programs may have it.
    """
    await pilot.pause()
    while pilot.app.is_running and _owes(pilot.app.screen):  # one that has ended draws no more
        await asyncio.sleep(0.005)
        await pilot.pause()


def _owes(screen: Screen[object]) -> bool:
    shown = screen._compositor.visible_widgets
    return (
        screen._layout_required
        or bool(screen._dirty_widgets)
        or any(widget._layout_required or widget._repaint_required for widget in shown)
    )


PANE = (80, 19)
"""What a terminal of 80x24 leaves to a pane."""


class PaneScreen(Screen[None]):
    """Holds the pane, or any other widget."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    AUTO_FOCUS = ""

    def __init__(self, pane: Widget) -> None:
        super().__init__()
        self.pane = pane

    def compose(self) -> ComposeResult:
        yield Container(self.pane, id="body")


class PaneApp(App[None]):
    """Keeps the messages that a pane sends to the console."""

    CSS_PATH = MadrobApp.CSS_PATH
    HORIZONTAL_BREAKPOINTS = MadrobApp.HORIZONTAL_BREAKPOINTS
    VERTICAL_BREAKPOINTS = MadrobApp.VERTICAL_BREAKPOINTS

    def __init__(self, pane: Widget) -> None:
        super().__init__()
        self.pane_screen = PaneScreen(pane)
        self.sent: list[Message] = []

    def get_default_screen(self) -> Screen[None]:
        return self.pane_screen

    def on_runs_pane_opened(self, event: RunsPane.Opened) -> None:
        self.sent.append(event)

    def on_table_chosen(self, event: Table.Chosen) -> None:
        self.sent.append(event)


@dataclass
class Shown:
    """A pane that has been entered."""

    app: PaneApp
    pilot: Pilot[None]

    async def settle(self) -> None:
        """What is being read is shown."""
        await self.app.workers.wait_for_complete()
        await self.pilot.pause()
        await drawn(self.pilot)

    async def press(self, *keys: str) -> None:
        """Press keys and let the pane follow."""
        await self.pilot.press(*keys)
        await self.settle()

    def rows(self) -> list[str]:
        """The screen as text."""
        return rows_of(self.app)

    @property
    def text(self) -> str:
        return "\n".join(self.rows())

    @property
    def marked(self) -> str:
        """The row under the mark."""
        return next(row for row in self.rows() if row.lstrip().startswith("> "))


@asynccontextmanager
async def showing(
    pane: HistoryPane | StandingsPane | ResultsPane, size: tuple[int, int] = PANE
) -> AsyncIterator[Shown]:
    """The pane, entered."""
    app = PaneApp(pane)
    async with app.run_test(size=size) as pilot:
        pane.enter()
        shown = Shown(app, pilot)
        await shown.settle()
        yield shown


# Stories: rows of what is done and what is seen then.


class Opening(NamedTuple):
    """How a story begins: in these sizes, on such an engine, with such screens."""

    sizes: Sequence[tuple[int, int]] = (SMALL,)
    engine: Mapping[str, object] = {}
    screens: Mapping[str, Any] = {}


Item = str | Act | Phase | Outcome | Callable[[Driver], object] | Opening
Story = Sequence[tuple[Item, ...]]
Stories = Mapping[str, Story]
"""By the promise. A row begins with what is done, and what can be seen then follows.

Keys stand with blanks between them (`tab*7`), a text after `=` (`i n =dent`, `'=two words'`).
Seen is a text on the screen, however its lines are broken; an act, the engine's last; a phase or an
outcome, of the run; anything else is asked whether it is so.
"""


def in_sizes(*sizes: tuple[int, int]) -> Opening:
    return Opening(sizes=sizes)


def on_engine(**engine: object) -> Opening:
    return Opening(engine=engine)


def opened(size: tuple[int, int] = SMALL, **screens: object) -> Opening:
    return Opening((size,), screens=screens)


async def play(engine: Callable[[], FakeEngine], story: Story) -> None:
    """Play a story, in each of its sizes, on a new engine."""
    openings = [row[0] for row in story if isinstance(row[0], Opening)]
    sizes = next((one.sizes for one in openings if one.sizes != (SMALL,)), (SMALL,))
    for size in sizes:
        made = engine()
        screens: dict[str, Any] = {}
        for one in openings:
            _set(made, one.engine)
            screens |= one.screens
        async with driving(made, size, **screens) as driver:
            for row in story:
                if not isinstance(row[0], Opening):
                    await _do(driver, row[0])
                for item in row[1:]:
                    assert _is_so(driver, item), (size, row[0], item, driver.text)


async def _do(driver: Driver, deed: Item) -> None:
    if isinstance(deed, str):
        keys: list[str] = []
        for token in shlex.split(deed):
            key, _, times = token.partition("*")
            if token[0] != "=":
                keys += [key] * int(times or 1)
            else:
                keys += ("space" if char == " " else char for char in token[1:])
        await driver.press(*keys)
        return
    assert callable(deed)
    done = deed(driver)
    if inspect.isawaitable(done):
        await done


def _is_so(driver: Driver, item: Item) -> object:
    match item:
        case Act():
            return driver.engine.acts[-1] == item
        case Phase():
            return driver.engine.run.phase is item
        case Outcome():
            return driver.engine.run.outcome is item
        case str():
            return _reads(driver.text, item)
        case _:
            assert callable(item)
            found = item(driver)
            assert not inspect.isawaitable(found), "this is done, not seen"
            return found


def _reads(screen: str, words: str) -> bool:
    """Whether words stand on a screen, however its lines are broken."""
    return words in screen or " ".join(words.split()) in " ".join(screen.replace("│", " ").split())


def _set(engine: FakeEngine, values: Mapping[str, object]) -> None:
    for name, value in values.items():
        assert hasattr(engine, name)
        setattr(engine, name, copy(value))  # an engine changes its own


# What is done in a story.


def sets(**values: object) -> Callable[[Driver], object]:
    """The engine has these values, which the screen does not know yet."""
    return lambda driver: _set(driver.engine, values)


def has(**values: object) -> Callable[[Driver], object]:
    """The engine has these values, and the screen has looked."""

    async def look(driver: Driver) -> None:
        _set(driver.engine, values)
        await driver.settle()

    return look


def acting(
    deed: Callable[..., object], *values: object, **named: object
) -> Callable[[Driver], object]:
    return lambda driver: deed(driver, *values, **named)


def passes(duration: float) -> Callable[[Driver], object]:
    return partial(Driver.let_pass, duration=duration)


def answered(keys: str = "") -> Callable[[Driver], object]:
    """Keys, and what waits for the engine has its answer."""
    return lambda driver: driver.answered(*keys.split())


def types_every(gap: float) -> Callable[[Driver], object]:
    return lambda driver: setattr(driver.hand, "gap", gap)


def remember(driver: Driver) -> None:
    """Keeps in mind what the engine has done."""
    driver.remembered = list(driver.engine.acts)


# What is seen in a story.


def did_nothing(driver: Driver) -> object:
    """Since the story asked to keep it in mind."""
    return driver.remembered == driver.engine.acts


def no(words: str) -> Callable[[Driver], object]:
    return lambda driver: not _reads(driver.text, words)


def says(words: str) -> Callable[[Driver], object]:
    """In the line above the keys."""
    return lambda driver: words in driver.console.status


def says_only(words: str) -> Callable[[Driver], object]:
    return lambda driver: driver.console.status == words


def pane(name: str) -> Callable[[Driver], object]:
    return lambda driver: driver.console.pane == name


def focused(name: str) -> Callable[[Driver], object]:
    return lambda driver: driver.app.focused is not None and driver.app.focused.id == name


def no_question(driver: Driver) -> object:
    return not driver.console.dialogs


def setup_of(engine: FakeEngine) -> RunSetup:
    assert engine.run.setup is not None
    return engine.run.setup


# The same for a pane alone.


def row(words: str) -> Callable[[Driver | Shown], object]:
    """A row of the screen, its blanks aside."""
    return lambda shown: words in [" ".join(row.split()) for row in shown.rows()]


async def play_pane(
    pane: HistoryPane | StandingsPane | ResultsPane,
    *rows: tuple[str | Callable[[Shown], object], ...],
    size: tuple[int, int] = PANE,
) -> None:
    """Keys on a pane that has been entered, and what is seen after them."""
    async with showing(pane, size) as shown:
        for keys, *items in rows:
            assert isinstance(keys, str)
            await shown.press(*keys.split())
            for item in items:
                seen = _reads(shown.text, item) if isinstance(item, str) else item(shown)
                assert seen, (keys, item, shown.text)
