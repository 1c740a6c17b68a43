"""From any state that any input can reach, F8 y ends the run and Escape leads back to the panes."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Coroutine, Iterator
from contextlib import AsyncExitStack
from functools import partial
from itertools import count
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from textual import events

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.engine.snapshot import RightToAct
from madrob_console.referee import run as runs
from madrob_console.referee.acts import Abort
from tests.madrob_console.ui.driver import Driver, driving, mouse
from tests.madrob_console.ui.inline_engine import RATE, HandEngine, start

MOST_ESCAPES = 8
STEP = 1 / RATE


async def type_keys(driver: Driver, *keys: str) -> None:
    """Keys as fast as a script sends them."""
    await driver.send(*(events.Key(key, key if len(key) == 1 else None) for key in keys))


async def let_pass(driver: Driver, duration: float) -> None:
    """Also the time of the referee and of the screens."""
    driver.hand.now += duration
    driver.seconds[0] += duration
    await driver.let_pass(duration)


# What can come: keys, mouse, pastes, the terminal's focus and size, time, the engine.


Deed = Callable[[Driver], Coroutine[Any, Any, None]]

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
    async def deed(driver: Driver) -> None:
        driver.hand.gap = gap
        await type_keys(driver, *keys)

    return deed


def sends(*happened: Callable[[], events.Event]) -> Deed:
    return lambda driver: driver.send(*(event() for event in happened))


def clicks(at: tuple[int, int], kinds: list[type[events.MouseEvent]]) -> Deed:
    return sends(*(partial(mouse, kind, *at) for kind in kinds))


LOST = "the engine has ended"


def sets(**values: Any) -> Deed:  # noqa: ANN401
    """The engine is lost or comes back; another console takes the right; a question opens."""

    async def deed(driver: Driver) -> None:
        driver.engine.put(**values)
        await let_pass(driver, STEP)

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
    st.builds(lambda text: sends(lambda: events.Paste(text)), st.text("ab1y\n\x1b[~", max_size=20)),
    st.builds(sends, st.sampled_from([events.AppFocus, events.AppBlur])),
    st.builds(lambda size: lambda driver: driver.resize(*size), st.sampled_from(SIZES)),
    st.builds(lambda s: lambda driver: let_pass(driver, s), st.sampled_from([STEP, 0.3, 1.0, 3.0])),
    st.builds(lambda why: sets(failure=why), st.sampled_from([None, LOST])),
    st.builds(
        lambda holder, free: sets(right=RightToAct(holder=holder, free=free)),
        st.sampled_from(["", "bo@tent"]),
        st.booleans(),
    ),
    st.builds(lambda some: sets(unfinished=some), st.sampled_from([(), (CUT_OFF,)])),
)


class Hall:
    """One console for many sequences; a new one after a failure, and when it was left."""

    def __init__(self) -> None:
        self._runner = asyncio.Runner()
        self._stack = AsyncExitStack()
        self._driver: Driver | None = None
        self._numbers = count(100)

    def play(self, deeds: list[Deed], *, counting_down: bool, gap: float) -> None:
        try:
            self._runner.run(self._play(deeds, counting_down=counting_down, gap=gap))
        except BaseException:
            self._runner.run(self._leave())
            raise

    def close(self) -> None:
        self._runner.run(self._leave())
        self._runner.close()

    async def _leave(self) -> None:
        self._driver = None
        await self._stack.aclose()

    async def _enter(self) -> Driver:
        engine = HandEngine()

        def find(_may_start: bool) -> HandEngine:
            engine.snapshot()  # there is none while it is lost
            return engine

        driver = await self._stack.enter_async_context(driving(engine, gap=0.1, find=find))
        await driver.answered()
        return driver

    async def _play(self, deeds: list[Deed], *, counting_down: bool, gap: float) -> None:
        if self._driver is not None and not self._driver.app.is_running:
            await self._leave()
        driver = self._driver = self._driver or await self._enter()
        engine = driver.engine
        engine.put(failure=None, right=RightToAct())
        if engine.run.active:
            engine.act(Abort("the test before"))
        engine.rest()
        start(engine, STEP if counting_down else 6.0, run_number=next(self._numbers))
        await let_pass(driver, STEP)
        for deed in deeds:
            await deed(driver)
            if not driver.app.is_running:
                return  # the referee has left
        engine.put(failure=None)
        await let_pass(driver, 3.0)  # a console finds its engine by itself
        await driver.answered()
        await let_pass(driver, STEP)
        if engine.run.active:
            driver.hand.gap = gap
            await type_keys(driver, "f8", "y")
            await let_pass(driver, STEP)
            assert not engine.run.active, driver.text
        for _ in range(MOST_ESCAPES):
            driver.hand.now += 1.0
            await type_keys(driver, "escape")
        assert driver.app.screen is driver.console, driver.app.screen_stack
        assert not driver.console.dialogs, driver.text


@pytest.fixture(scope="module")
def hall() -> Iterator[Hall]:
    hall = Hall()
    yield hall
    hall.close()


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
    def hold(hall: Hall, deeds: list[Deed], last: Deed, counting_down: bool, gap: float) -> None:
        hall.play([*deeds, last], counting_down=counting_down, gap=gap)

    return hold


def test_after_any_input_f8_y_ends_the_run_and_escape_leads_back(hall: Hall) -> None:
    _property(30)(hall=hall)


def _flood_property(examples: int) -> Callable[..., None]:
    @settings(
        max_examples=examples,
        deadline=None,
        suppress_health_check=[*HealthCheck],
        phases=[Phase.generate],
        database=None,
    )
    @given(st.lists(st.sampled_from(NAMES), min_size=20, max_size=150), st.booleans())
    def hold(hall: Hall, keys: list[str], counting_down: bool) -> None:
        flood = types([*keys, "f8", "y"], 0.0)
        hall.play([flood, ends_the_run], counting_down=counting_down, gap=0.0)

    return hold


async def ends_the_run(driver: Driver) -> None:
    await let_pass(driver, STEP)
    assert not driver.engine.run.active, driver.text


def test_f8_y_behind_a_flood_ends_the_run(hall: Hall) -> None:
    _flood_property(20)(hall=hall)


def test_a_key_that_waits_for_a_question_that_is_gone_takes_no_key_from_f8(hall: Hall) -> None:
    keys = types(["f8", "o", "f8", "o", "f8", "y"], 0.0)
    hall.play([keys, ends_the_run], counting_down=True, gap=0.0)


@pytest.mark.slow
@pytest.mark.timeout(100_000)
def test_f8_y_behind_many_floods_ends_the_run(hall: Hall) -> None:
    _flood_property(int(os.environ.get("SEQUENCES", "300")))(hall=hall)


@pytest.mark.parametrize("keys", [["f10", "ctrl+p"], ["ctrl+p", "f10"]])
def test_a_console_that_is_left_without_an_engine_ends_in_no_error(
    hall: Hall, keys: list[str]
) -> None:
    for _ in range(5):  # what is left over depends on the moment
        hall.play([sets(failure=LOST), types(keys, 1.0)], counting_down=False, gap=0.0)


@pytest.mark.slow
@pytest.mark.timeout(100_000)
def test_after_many_inputs_f8_y_ends_the_run_and_escape_leads_back(hall: Hall) -> None:
    _property(int(os.environ.get("SEQUENCES", "300")))(hall=hall)
