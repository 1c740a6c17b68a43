"""What the screens say and can do when the engine is not there: not yet, not any more."""

from __future__ import annotations

import threading

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.requests import Role
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.engine.wire import EngineClient
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.keys.console_app import ConsoleCommands
from madrob_console.ui.keys.key_table import FINDS_BY_ITSELF
from madrob_console.ui.link import LOOKING_PERIOD
from tests.madrob_console.ui.driver import DEFAULTS, Driver, Hand, driving
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine

GONE = "the engine has ended"


async def test_the_screen_says_what_it_waits_for_until_the_engine_is_there() -> None:
    ready, engine = threading.Event(), FakeEngine()

    def open_client() -> EngineClient:
        ready.wait(20.0)
        return engine

    app = MadrobApp(open_client, DEFAULTS)
    async with app.run_test(size=(80, 24)) as pilot:
        driver = Driver(app, engine, pilot, Hand())
        await driver.settle()
        assert "Looking for the engine; one is started where none runs" in driver.text
        await driver.press("f5")
        why = "this screen is not attached to the engine yet"
        assert driver.console.status == f"Refused: start: {why}"
        ready.set()
        await app.workers.wait_for_complete()
        await driver.settle()
        assert "Looking for the engine" not in driver.text
        assert "SIMULATED nominal" in driver.rows()[0]
        assert "Opening side" in driver.text


async def test_nothing_of_an_engine_that_has_ended_looks_live(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.set_up()
    assert "all passed or waived" in driver.text
    engine.failure = GONE
    await driver.settle()
    assert driver.rows()[0].startswith(" ENDED  SIMULATED nominal, as it was at 22:13:20")
    assert "age <0.5s" not in driver.text
    assert "all passed" not in driver.text
    assert "Checks  old: of 22:13:20" in driver.text
    assert "F5 starts" not in driver.text
    assert "^R start the engine again" in driver.rows()[-1]
    await driver.press("f5")
    assert driver.console.status == f"Refused: start: {GONE}"


async def test_the_engine_is_started_again_by_a_key_and_only_when_it_has_ended() -> None:
    engines = [FakeEngine()]
    problems: list[str] = []

    def open_client() -> EngineClient:
        if problems:
            raise MadrobError(problems.pop())
        return engines[-1]

    app = MadrobApp(open_client, DEFAULTS, monotonic=lambda: 0.0)
    async with app.run_test(size=(80, 24)) as pilot:
        driver = Driver(app, engines[0], pilot, Hand())
        await app.workers.wait_for_complete()
        await driver.settle()
        await driver.press("ctrl+r")
        assert "the engine has not ended" in driver.console.status
        engines[0].failure = GONE
        problems.append("no testbed on ROS domain 7")
        await driver.settle()
        await driver.press("ctrl+r")
        await app.workers.wait_for_complete()
        await driver.settle()
        assert "no testbed on ROS domain 7" in driver.console.status
        engines.append(FakeEngine(label="SIMULATED slow"))
        await driver.press("ctrl+r")
        await app.workers.wait_for_complete()
        await driver.settle()
        assert driver.console.status == "The engine is there again."
        assert "SIMULATED slow" in driver.rows()[0]
        assert engines[0].closed


@pytest.mark.parametrize("role", Role)
async def test_only_a_screen_that_watches_finds_the_next_engine_by_itself(role: Role) -> None:
    engines = [FakeEngine(right=RightToAct(role))]
    clock, looks, here = [0.0], [0], threading.get_ident()

    def open_client() -> EngineClient:
        assert threading.get_ident() != here  # the screen goes on
        looks[0] += 1
        if engines[-1].failure:
            raise MadrobError("no engine runs here")
        return engines[-1]

    app = MadrobApp(open_client, DEFAULTS, monotonic=lambda: clock[0])
    async with app.run_test(size=(80, 24)) as pilot:
        driver = Driver(app, engines[0], pilot, Hand())

        async def wait(duration: float) -> None:
            clock[0] += duration
            for _ in range(2):
                await driver.settle()
                await app.workers.wait_for_complete()
            await driver.settle()

        await wait(0.0)
        engines[0].failure = GONE
        await wait(0.0)
        assert "as it was at" in driver.rows()[0]
        watches = role is Role.WATCH
        assert (FINDS_BY_ITSELF in driver.rows()[-1]) is watches
        assert ("^R start" in driver.text) is not watches
        await wait(LOOKING_PERIOD)
        await wait(LOOKING_PERIOD)
        assert looks[0] == (4 if watches else 1)
        if watches:
            await driver.press("ctrl+r")
            assert FINDS_BY_ITSELF in driver.console.status
        engines.append(FakeEngine(label="SIMULATED slow", right=RightToAct(role)))
        await wait(LOOKING_PERIOD)
        assert ("SIMULATED slow" in driver.rows()[0]) is watches
        assert engines[0].closed is watches


async def test_that_another_console_may_act_is_no_fault(driver: Driver, engine: FakeEngine) -> None:
    engine.right = RightToAct(holder="bo@tent")
    await driver.settle()
    assert driver.rows()[1].startswith(" NOTE  bo@tent has the right to act")
    assert "FAULT" not in driver.text
    engine.faults = ("the door is on fire",)
    await driver.settle()
    assert driver.rows()[1].startswith(" NOTE ")
    assert "FAULT the door is on fire" in driver.rows()[2]
    engine.failure = GONE
    await driver.settle()
    assert "has the right to act" not in driver.text


async def test_what_is_not_possible_comes_last_in_the_palette(driver: Driver) -> None:
    hits = [hit async for hit in ConsoleCommands(driver.console).discover()]
    assert len({hit.score for hit in hits}) == 2
    for hit in hits:
        assert (hit.score == 1.0) is ("not now" not in str(hit.prompt))


async def test_a_number_that_could_not_be_asked_for_is_asked_for_again(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.set_up()
    engine.used_numbers = {(1, 1): 1}  # a start was withdrawn, its number is used
    engine.no_number = "the disk is silent"
    driver.console.panes.setup.number_used = True
    await driver.press("enter")
    assert "x the disk is silent" in driver.text
    engine.no_number = None
    await driver.press("f5")
    setup = engine.run.setup
    assert setup is not None
    assert setup.run_number == 2


async def test_a_withdrawn_abort_is_told_until_a_key_is_pressed(slow_engine: SlowEngine) -> None:

    async with driving(slow_engine) as driver:
        await driver.run()
        slow_engine.slow = True
        await driver.press("f8", "1", "y")
        slow_engine.pulse = Pulse(server=6)
        (_, answer), slow_engine.waiting = slow_engine.waiting[-1], []
        answer.set_exception(MadrobError("the engine does not answer: nothing was done"))
        await driver.settle()
        said = "Refused: abort: the engine does not answer: nothing was done"
        assert driver.console.status == said
        slow_engine.pulse, slow_engine.slow = Pulse(), False
        await driver.finish()
        await driver.settle()
        assert driver.console.pane == "results"
        assert driver.console.status == said
        await driver.press("down")
        assert driver.console.status == ""


async def test_a_message_carries_its_time_fades_and_goes_with_the_next_key(
    engine: FakeEngine,
) -> None:
    now = 0.0

    async with driving(engine, monotonic=lambda: now) as driver:
        await driver.press("f8")
        row = driver.rows()[-2]
        assert row.startswith(" 22:13:20 Refused: abort: no run is set up yet")
        line = driver.console._status
        fresh = line.lines(80)
        now += 6.0
        await driver.settle()
        assert line.lines(80) != fresh
        assert driver.rows()[-2] == row
        await driver.press("f3")
        assert "Refused" not in driver.text
