"""From any state that any input can reach, F8 y ends the run and Escape leads back to the panes."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from textual import events

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.engine.ipc.engine_interface import EngineClient
from madrob_console.engine.snapshot import RightToAct
from madrob_console.referee import run as runs
from madrob_console.referee.acts import Abort, Start
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.type_ahead import TypeAhead
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.ui.driver import DEFAULTS, Hand, Shown
from tests.madrob_console.ui.inline_engine import InlineEngine

MOST_ESCAPES = 8


@dataclass
class Control(Shown):
    """A referee's console on a real engine."""

    app: MadrobApp
    drive: Drive
    engine: InlineEngine
    hand: Hand
    seconds: list[float]
    numbers: Iterator[int] = field(default_factory=lambda: iter(range(1, 1_000_000)))

    @property
    def console(self) -> ConsoleScreen:
        return next(one for one in self.app.screen_stack if isinstance(one, ConsoleScreen))

    @property
    def run(self) -> runs.Run:
        return self.engine.run

    async def let_pass(self, duration: float) -> None:
        """The engine goes on, and the screens look at it."""
        self.engine.tick(duration, STEP)
        self.hand.now += duration
        self.seconds[0] += duration
        await self.drawn()
        self.console.poll()
        await self.drawn()

    @property
    def state(self) -> str:
        """What is in front, and where the keys go."""
        front = [one.name or "" for one in self.console.dialogs]
        front += [type(one).__name__ for one in self.app.screen_stack[1:]]
        into = type(self.app.focused).__name__
        return " ".join((self.run.phase, self.console.pane, *front, into))

    def begin_run(self, *, counting_down: bool) -> None:
        """A run goes on, or is about to; another console may have started it."""
        drive = self.drive
        self.engine.put(failure=None, right=RightToAct())
        if self.run.active:
            drive.act(Abort("the test before"))
        drive.wait_until(lambda: not drive.engine.busy)
        drive.prepare(make_setup(run_number=next(self.numbers)))
        drive.act(Start())
        if not counting_down:
            drive.wait_until(lambda: self.run.phase is runs.Phase.RUNNING)
        self.engine.tick(STEP)

    async def send(self, *events: events.Event) -> None:
        """The same as the terminal tells."""
        driver = self.app._driver
        assert driver is not None
        for event in events:
            event.set_sender(self.app)
            driver.send_message(event)
        await asyncio.sleep(0)
        await self.drawn()

    async def type(self, *keys: str) -> None:
        """Keys as fast as a script sends them."""
        await self.send(*(_key(key) for key in keys))

    async def back(self) -> None:
        """Escape leads back to the panes."""
        for _ in range(MOST_ESCAPES):
            self.hand.now += 1.0
            await self.type("escape")
        assert self.app.screen is self.console, self.app.screen_stack
        assert not self.console.dialogs, self.text


def _key(name: str) -> events.Key:
    return events.Key(name, name if len(name) == 1 else None)


# What can come: keys, mouse, pastes, the terminal's focus and size, time, the engine.


Deed = Callable[[Control], Any]

OPENERS = [*("f1", "f2", "f4", "f8", "f9", "f10", "enter", "ctrl+p", "tab"), *"ihn1cwPy/"]
"""Keys that lead into questions, panes and fields."""

NAMES = [
    *(f"f{number}" for number in range(1, 10)),
    *("enter", "escape", "tab", "shift+tab", "up", "down", "left", "right", "space"),
    *("pageup", "pagedown", "home", "end", "backspace", "delete", "ctrl+p", "ctrl+r"),
    *"abcdefghijklmnopqrstuvwxzPRXE",
    *"yyy123456/?[]<>",
]
SIZES = [(80, 24), (120, 36), (200, 50), (60, 18), (40, 12), (20, 5), (10, 3), (2, 2), (1, 1)]
POINTS = st.tuples(st.integers(-1, 210), st.integers(-1, 55))


def types(keys: list[str], gap: float) -> Deed:
    async def deed(control: Control) -> None:
        control.hand.gap = gap
        await control.type(*keys)

    return deed


def clicks(at: tuple[int, int], kinds: list[type[events.MouseEvent]]) -> Deed:
    async def deed(control: Control) -> None:
        x, y = at
        await control.send(
            *(kind(None, x, y, 0, 0, 1, False, False, False, x, y) for kind in kinds)
        )

    return deed


def pastes(text: str) -> Deed:
    async def deed(control: Control) -> None:
        await control.send(events.Paste(text))

    return deed


def focuses(seen: bool) -> Deed:
    async def deed(control: Control) -> None:
        await control.send(events.AppFocus() if seen else events.AppBlur())

    return deed


def resizes(size: tuple[int, int]) -> Deed:
    async def deed(control: Control) -> None:
        await control.pilot.resize_terminal(*size)
        await control.drawn()

    return deed


def passes(duration: float) -> Deed:
    async def deed(control: Control) -> None:
        await control.let_pass(duration)

    return deed


LOST = "the engine has ended"


def sets(**values: Any) -> Deed:  # noqa: ANN401
    """The engine is lost or comes back; another console takes the right; a question opens."""

    async def deed(control: Control) -> None:
        control.engine.put(**values)
        await control.let_pass(STEP)

    return deed


CUT_OFF = Unfinished(
    "subject_003_cond_001_run_900_20231114_221320",
    3,
    "Delft",
    900,
    1,
    runs.Phase.RUNNING,
    None,
    None,
    "",
    0,
)
KEYS = st.one_of(st.sampled_from(OPENERS), st.sampled_from(NAMES))
LAST = st.builds(types, st.lists(st.sampled_from(OPENERS), max_size=2), st.just(1.0))
"""Most sequences would end in a pane: many of these leave something open."""
PRESS = [events.MouseDown, events.MouseUp]
DEEDS = st.one_of(
    st.builds(
        types,
        st.lists(KEYS, min_size=1, max_size=6),
        st.sampled_from([0.0, 0.1, 1.0]),
    ),
    st.builds(clicks, POINTS, st.sampled_from([PRESS, PRESS * 2, PRESS[:1], PRESS[1:]])),
    st.builds(
        clicks,
        POINTS,
        st.sampled_from([[events.MouseScrollUp], [events.MouseScrollDown], [events.MouseMove]]),
    ),
    st.builds(pastes, st.text("ab1y\n\x1b[~", max_size=20)),
    st.builds(focuses, st.booleans()),
    st.builds(resizes, st.sampled_from(SIZES)),
    st.builds(passes, st.sampled_from([STEP, 0.3, 1.0, 3.0])),
    st.builds(lambda why: sets(failure=why), st.sampled_from([None, LOST])),
    st.builds(
        lambda holder, free: sets(right=RightToAct(holder=holder, free=free)),
        st.sampled_from(["", "bo@tent"]),
        st.booleans(),
    ),
    st.builds(lambda some: sets(unfinished=some), st.sampled_from([(), (CUT_OFF,)])),
)


class Halls:
    """One console for many sequences; a new one after a failure, and when it was left."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._runner = asyncio.Runner()
        self._stack: AsyncExitStack | None = None
        self._control: Control | None = None
        self._drives: list[Drive] = []
        self.states: Counter[str] = Counter()
        """From which F8 y has ended a run."""

    def play(self, deeds: list[Deed], *, counting_down: bool, gap: float) -> None:
        try:
            self._runner.run(self._play(deeds, counting_down=counting_down, gap=gap))
        except BaseException:
            self._runner.run(self._close())
            raise

    def close(self) -> None:
        self._runner.run(self._close())
        self._runner.close()
        for drive in self._drives:
            drive.engine.close()

    async def _open(self) -> Control:
        drive = Drive(self._folder / str(len(self._drives)))
        self._drives.append(drive)
        engine, hand, seconds = InlineEngine(drive.engine), Hand(0.1), [0.0]

        def find(*_may_start: bool) -> EngineClient:
            engine.snapshot()  # there is none while it is lost
            return engine

        app = MadrobApp(
            find,
            DEFAULTS,
            monotonic=lambda: seconds[0],
            wall=drive.engine.now,
            ahead=TypeAhead(lambda: hand.now, hand.typed),
            beside=lambda _words: 0,
        )
        self._stack = AsyncExitStack()
        pilot = await self._stack.enter_async_context(app.run_test(size=(80, 24)))
        control = Control(app, pilot, drive, engine, hand, seconds)
        await control.settle()
        return control

    async def _close(self) -> None:
        self._control = None
        if self._stack is not None:
            stack, self._stack = self._stack, None
            await stack.aclose()

    async def _play(self, deeds: list[Deed], *, counting_down: bool, gap: float) -> None:
        if self._control is not None and not self._control.app.is_running:
            await self._close()
        control = self._control = self._control or await self._open()
        control.begin_run(counting_down=counting_down)
        await control.let_pass(STEP)
        for deed in deeds:
            await deed(control)
            if not control.app.is_running:
                return  # the referee has left
        control.engine.put(failure=None)
        await control.let_pass(3.0)  # a console finds its engine by itself
        await control.settle()
        await control.let_pass(STEP)
        if control.run.active:
            self.states[control.state] += 1
            control.hand.gap = gap
            await control.type("f8", "y")
            await control.let_pass(STEP)
            assert not control.run.active, control.text
        await control.back()


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Halls]:
    halls = Halls(tmp_path_factory.mktemp("halls"))
    yield halls
    halls.close()


def _property(examples: int) -> Callable[..., None]:
    @settings(
        max_examples=examples,
        deadline=None,
        suppress_health_check=[*HealthCheck],
        phases=[Phase.generate, Phase.shrink],
        database=None,
    )
    @given(
        st.lists(DEEDS, min_size=2, max_size=12),
        LAST,
        st.booleans(),
        st.sampled_from([0.0, 0.1, 1.0]),
    )
    def hold(halls: Halls, deeds: list[Deed], last: Deed, counting_down: bool, gap: float) -> None:
        halls.play([*deeds, last], counting_down=counting_down, gap=gap)

    return hold


def test_after_any_input_f8_y_ends_the_run_and_escape_leads_back(halls: Halls) -> None:
    _property(30)(halls=halls)


@pytest.mark.parametrize("keys", [["f10", "ctrl+p"], ["ctrl+p", "f10"]])
def test_a_console_that_is_left_without_an_engine_ends_in_no_error(
    halls: Halls, keys: list[str]
) -> None:
    for _ in range(5):  # what is left over depends on the moment
        halls.play([sets(failure=LOST), types(keys, 1.0)], counting_down=False, gap=0.0)


@pytest.mark.slow
@pytest.mark.timeout(100_000)
def test_after_many_inputs_f8_y_ends_the_run_and_escape_leads_back(halls: Halls) -> None:
    _property(int(os.environ.get("SEQUENCES", "300")))(halls=halls)
    print(f"\nF8 y ended {halls.states.total()} runs from {len(halls.states)} states")
    print("\n".join(f"{count:6} {state}" for state, count in halls.states.most_common()))
