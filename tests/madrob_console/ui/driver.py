"""Drives screens in a test: keys in, text of the screen out; stories as tables of keys."""

from __future__ import annotations

import asyncio
import inspect
import re
import shlex
from base64 import b64decode
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import get_ident
from typing import Any, ClassVar, NamedTuple, TypeVar
from unicodedata import lookup

import pytest
from textual.app import App, ComposeResult
from textual.containers import Container
from textual.drivers.headless_driver import HeadlessDriver
from textual.events import Event, Key, MouseDown, MouseEvent, MouseMove, MouseUp, Resize
from textual.geometry import Size
from textual.keys import REPLACED_KEYS, _character_to_key, _get_unicode_name_from_key
from textual.message import Message
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widget import Widget
from textual.worker import WorkerCancelled

from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.ipc.engine_interface import EngineClient
from madrob_console.engine.requests import Request
from madrob_console.referee.acts import Act
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui import awaited
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.cells.table import Table
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.type_ahead import TypeAhead
from madrob_console.ui.link import ConsoleDefaults, OpenClient
from madrob_console.ui.panes.list_pane import RunsPane
from scoring.protocol import Outcome, Step
from tests.madrob_console.run_folders import write
from tests.madrob_console.ui.inline_engine import HandEngine

SMALL = (80, 24)
LARGE = (120, 36)
PANE = (80, 19)
"""What a terminal of 80x24 leaves to a pane."""
DEFAULTS = ConsoleDefaults(results=Path("/results"), team="Door Bots", referee="Ada")
OSC_52 = re.compile(r"\x1b\]52;c;(.*?)\a")
MOST_LOOKS = 2000
LOOKING = 3.0
"""Between two keys of somebody who looks at the screen, s."""


@dataclass
class Shown:
    """Any screens under test."""

    app: App[None]
    pilot: Pilot[None]

    async def press(self, *keys: str) -> None:
        """Press keys, each when the one before has done what it does, and let the screen follow."""
        for key in keys:
            name = _character_to_key(key) if len(key) == 1 and not key.isalnum() else key
            char = name if len(name) == 1 else None
            with suppress(KeyError):
                char = lookup(_get_unicode_name_from_key(REPLACED_KEYS.get(name, name)))
            self.app.post_message(Key(name, char))
            await self.drawn()
        await self.settle()

    async def settle(self) -> None:
        """What is being read is shown."""
        with suppress(WorkerCancelled):  # it was asked again
            await self.app.workers.wait_for_complete()
        await self.drawn()

    async def drawn(self) -> None:
        """Until every message is dealt with and nothing is left to be drawn.

        A pilot's own pause asks each widget, and waits until the process takes little of the
        processor: that takes long, and on a busy machine it says nothing.
        """
        loop: Any = asyncio.get_running_loop()
        owing = True
        while owing:
            await self.app.animator.wait_until_complete()  # a page that scrolls, at its next tick
            await asyncio.sleep(0)
            if not loop._ready:
                owing = self.app.is_running and _owes(
                    self.app.screen
                )  # one that ended draws no more
                if owing:
                    self.app.screen._on_timer_update()
                    await asyncio.sleep(0.001)

    async def until(self, seen: Item) -> None:
        """Wait for what needs time; the test has a limit."""
        while not _is_so(self, seen):
            await asyncio.sleep(0.01)
            await self.drawn()

    async def click(self, text: str, within: str = "", times: int = 1) -> None:
        """Click on the first character of a text, in the first row that holds it and `within`."""
        y, row = next(
            (y, row) for y, row in enumerate(self.rows()) if text in row and within in row
        )
        await self.click_at(row.index(text), y, times)

    async def click_at(self, x: int, y: int, times: int = 1) -> None:
        """Click there, as a terminal tells of it."""
        await self.send(*(mouse(kind, x, y) for kind in (MouseMove, *[MouseDown, MouseUp] * times)))
        await self.settle()

    async def resize(self, width: int, height: int) -> None:
        """The terminal has another size."""
        size = Size(width, height)
        assert isinstance(self.app._driver, HeadlessDriver)
        self.app._driver._size = size
        self.app.post_message(Resize(size, size))
        await self.settle()

    async def send(self, *events: Event) -> None:
        """The same as the terminal tells."""
        terminal = self.app._driver
        assert terminal is not None
        for event in events:
            event.set_sender(self.app)
            terminal.send_message(event)
        await self.drawn()

    def rows(self) -> Sequence[str]:
        """The screen as text."""
        width, height = self.app.size
        strips = self.app.screen._compositor.render_strips()
        return [strip.text[:width].rstrip() for strip in strips[:height]]

    @property
    def text(self) -> str:
        return "\n".join(self.rows())

    @property
    def marked(self) -> str:
        """The row under the mark."""
        return next(row for row in self.rows() if row.lstrip().startswith("> "))


def mouse(kind: type[MouseEvent], x: int, y: int) -> MouseEvent:
    return kind(None, x, y, 0, 0, 1, False, False, False, x, y)


def _owes(screen: Screen[object]) -> bool:
    shown = screen._compositor.visible_widgets
    return (
        screen.app._resize_timer is not None  # it waits for another size
        or screen._layout_required
        or screen._scroll_required
        or bool(screen._dirty_widgets or screen._callbacks)
        or any(widget._layout_required or widget._repaint_required for widget in shown)
    )


@dataclass
class Hand:
    """When keys are typed: time passes with each of them, and otherwise stands still.

    Attributes:
        gap: between two keys, s.
        now: the time, s.
    """

    gap: float = LOOKING
    now: float = 1000.0
    _last: Event | None = None

    def typed(self, event: Event) -> float:
        """The time of a key."""
        if event is not self._last:
            self._last = event
            self.now += self.gap
        return self.now


@dataclass
class Driver(Shown):
    """The console under test."""

    app: MadrobApp
    engine: HandEngine
    hand: Hand = field(default_factory=Hand)
    seconds: list[float] = field(default_factory=lambda: [0.0])
    """The time of the screens."""
    remembered: Sequence[Act] = ()
    """The engine's acts when a story asked to keep them in mind."""
    copies: list[str] = field(default_factory=list)
    """What the terminal was handed for its clipboard, oldest first."""

    @property
    def console(self) -> ConsoleScreen:
        return next(one for one in self.app.screen_stack if isinstance(one, ConsoleScreen))

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
        await self.drawn()
        self.console.poll()
        await self.drawn()

    async def answered(self, *keys: str) -> None:
        """Press keys; what waits for the engine or a thread has its answer."""
        await self.press(*keys)
        await self.app.workers.wait_for_complete()
        await self.settle()

    async def drawn(self) -> None:
        """Also until what keys have asked for is done, unless the engine keeps it waiting."""
        await super().drawn()
        looks = 0 if awaited.PATIENCE < 1.0 else MOST_LOOKS
        while looks and any(one.group == "keys" for one in self.app.workers):
            looks -= 1
            await asyncio.sleep(0.001)
            await super().drawn()

    async def finish(self, outcome: Outcome = Outcome.COMPLETED, reason: str = "gave up") -> None:
        """The run ends by itself."""
        self.engine.finish(outcome, reason)
        await self.settle()

    async def complete(self, outcome: Outcome = Outcome.COMPLETED) -> None:
        """A run goes on, does all its steps and ends."""
        await self.run()
        await self.finish(outcome, "because")

    async def do_steps(self, *steps: Step) -> None:
        for step in steps:
            self.engine.do_step(step)
        await self.settle()


@asynccontextmanager
async def driving(
    engine: HandEngine,
    size: tuple[int, int] = SMALL,
    defaults: ConsoleDefaults = DEFAULTS,
    *,
    look: ConsoleSettings | None = None,
    gap: float = LOOKING,
    find: OpenClient | None = None,
    runs: Sequence[RunSummary] = (),
) -> AsyncIterator[Driver]:
    """The console on `engine`, in a terminal of `size`; time stands still for the screens.

    Keys are typed `gap` seconds one after the other. `find` looks for an engine, the one here
    unless something follows it, in a thread: the screen goes on. Where there are `runs`, the
    results folder holds them.
    """
    hand = Hand(gap)
    ahead = TypeAhead(lambda: hand.now, hand.typed)
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(awaited, "PATIENCE", 60.0)  # of keys, however busy the machine is
        patch.setattr(Request, "timeout", 600.0)  # a slow engine answers when it is told to
        for run in runs:
            write(Path(folder), run)
            defaults = replace(defaults, results=Path(folder))
        here, seconds = get_ident(), [0.0]

        def found(may_start: bool) -> EngineClient:
            assert get_ident() != here
            return (find or engine.find)(may_start)

        app = MadrobApp(found, defaults, look, lambda: seconds[0], lambda: engine.now, ahead)
        async with app.run_test(size=size) as pilot:
            driver = Driver(app, pilot, engine, hand, seconds)

            def keep(data: str) -> None:
                driver.copies += (b64decode(one).decode() for one in OSC_52.findall(data))

            patch.setattr(app._driver, "write", keep)
            if find is None:
                await driver.answered()
            yield driver
        engine.end()


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
class Alone(Shown):
    """A pane, or any other widget, on a screen of its own."""

    app: PaneApp


@asynccontextmanager
async def showing(pane: Widget, size: tuple[int, int] = PANE) -> AsyncIterator[Alone]:
    """A pane, entered."""
    app = PaneApp(pane)
    async with app.run_test(size=size) as pilot:
        if (enter := getattr(pane, "enter", None)) is not None:
            enter()
        shown = Alone(app, pilot)
        await shown.settle()
        yield shown


# Stories: rows of what is done and what is seen then.


class Opening(NamedTuple):
    """How a story begins: in these sizes, on such an engine, with such screens."""

    sizes: Sequence[tuple[int, int]] = (SMALL,)
    engine: Mapping[str, object] = {}
    screens: Mapping[str, Any] = {}


S = TypeVar("S", bound=Shown)
Item = str | Act | Phase | Outcome | Callable[[Any], object] | Opening
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


async def play(engine: Callable[..., HandEngine], story: Story) -> None:
    """Play a story on the console, in each of its sizes, on a new engine."""
    openings = [row[0] for row in story if isinstance(row[0], Opening)]
    sizes = next((one.sizes for one in openings if one.sizes != (SMALL,)), (SMALL,))
    screens = {name: value for one in openings for name, value in one.screens.items()}
    for size in sizes:
        values = {name: value for one in openings for name, value in one.engine.items()}
        async with driving(engine(**values), size, **screens) as driver:
            await follow(driver, story)


async def play_alone(pane: Widget, *rows: tuple[Item, ...], size: tuple[int, int] = PANE) -> None:
    """The same with a pane on a screen of its own."""
    async with showing(pane, size) as shown:
        await follow(shown, rows)


async def follow(shown: Shown, story: Story) -> None:
    """Do what the rows of a story say, and see what they say."""
    for deed, *items in story:
        if isinstance(deed, str):
            await shown.press(*_keys(deed))
        elif callable(deed) and inspect.isawaitable(done := deed(shown)):
            await done
        for item in items:
            assert _is_so(shown, item), (shown.app.size, deed, item, shown.text)


def _keys(deed: str) -> Sequence[str]:
    keys: list[str] = []
    for token in shlex.split(deed):
        key, _, times = token.partition("*")
        if token[0] != "=":
            keys += [key] * int(times or 1)
        else:
            keys += ("space" if char == " " else char for char in token[1:])
    return keys


def _is_so(shown: Shown, item: Item) -> object:
    if isinstance(item, Act | Phase | Outcome):
        assert isinstance(shown, Driver)
        run = shown.engine.run
        return item in (run.phase, run.outcome, *shown.engine.acts[-1:])
    if isinstance(item, str):
        return reads(shown.text, item)
    assert callable(item)
    found = item(shown)
    assert not inspect.isawaitable(found), "this is done, not seen"
    return found


def reads(screen: str, words: str) -> bool:
    """Whether words stand on a screen, however its lines are broken."""
    return words in screen or " ".join(words.split()) in " ".join(screen.replace("│", " ").split())


# What is done in a story.


def sets(**values: object) -> Callable[[Driver], object]:
    """The engine has these values, which the screen does not know yet."""
    return lambda driver: driver.engine.put(**values)


def has(**values: object) -> Callable[[Driver], object]:
    """The engine has these values, and the screen has looked."""

    async def look(driver: Driver) -> None:
        driver.engine.put(**values)
        await driver.settle()

    return look


def resized(width: int, height: int) -> Callable[[Any], object]:
    """The terminal has another size."""

    return lambda shown: shown.resize(width, height)


def engine_does(deed: Callable[..., object], *values: object) -> Callable[[Driver], object]:
    return lambda driver: deed(driver.engine, *values)


def pages(*words: str) -> Callable[[Shown], object]:
    """What is shown has these words from its top to its bottom."""

    async def turn(shown: Shown) -> None:
        text = ""
        for _ in range(8):
            text += "\n".join(["", *shown.rows()[1:]])
            await shown.press("pagedown")
        assert [one for one in words if not reads(text, one)] == [], text

    return turn


def acting(deed: Callable[..., object], *values: object, **named: object) -> Callable[[S], object]:
    return lambda shown: deed(shown, *values, **named)


def passes(duration: float) -> Callable[[Any], object]:
    return lambda shown: shown.let_pass(duration)


def ages(duration: float) -> Callable[[Driver], object]:
    """Time of the screens, which they have seen."""

    async def age(driver: Driver) -> None:
        driver.seconds[0] += duration
        await driver.settle()

    return age


def answered(keys: str = "") -> Callable[[Driver], object]:
    """Keys, and what waits for the engine has its answer."""
    return lambda driver: driver.answered(*_keys(keys))


def types_every(gap: float) -> Callable[[Driver], object]:
    return lambda driver: setattr(driver.hand, "gap", gap)


def waits(keys: str, seen: Item) -> Callable[[Shown], object]:
    """Keys, and what comes by itself has come."""

    async def wait(shown: Shown) -> None:
        await shown.press(*_keys(keys))
        await shown.until(seen)

    return wait


def slows(driver: Driver) -> None:
    """The engine answers when it is told to, and keys do not wait for that."""
    driver.engine.slow, awaited.PATIENCE = True, 0.01


def remember(driver: Driver) -> None:
    """Keeps in mind what the engine has done."""
    driver.remembered = list(driver.engine.acts)


# What is seen in a story.


def did_nothing(driver: Driver) -> object:
    """Since the story asked to keep it in mind."""
    return driver.remembered == driver.engine.acts


def no(words: str) -> Callable[[Shown], object]:
    return lambda shown: not reads(shown.text, words)


def row(words: str) -> Callable[[Shown], object]:
    """A row of the screen, its blanks aside."""
    return lambda shown: words in [" ".join(row.split()) for row in shown.rows()]


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


def engine_has(**values: object) -> Callable[[Driver], object]:
    return lambda driver: values == {name: getattr(driver.engine, name) for name in values}


def setup_of(driver: Driver) -> RunSetup:
    assert driver.engine.run.setup is not None
    return driver.engine.run.setup


def set_up_with(**values: object) -> Callable[[Driver], object]:
    """The run that is set up has these."""
    return lambda driver: values == {name: getattr(setup_of(driver), name) for name in values}
