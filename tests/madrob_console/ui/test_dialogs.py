from __future__ import annotations

import asyncio

import pytest

from madrob_console.referee.acts import Abort, AddNote, Rule, Start
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import driving
from tests.madrob_console.ui.fake_engine import FakeEngine

SLIPS = [
    ["f8", "f8"],
    ["f8", "f8", "f8", "enter"],
    ["f8", "enter"],
    ["f8", "enter", "enter"],
    ["f8", "y"],
    ["f8", "n"],
    ["f8", "escape"],
    ["f8", "1", "enter"],
    ["f8", "1", "f8", "enter", "enter"],
    ["f8", "1", "escape"],
    ["f8", "1", "n"],
    ["f8", "down", "enter", "enter"],
    ["f8", "o", "x", "enter", "enter"],
    ["f8", "o", "enter", "enter", "escape"],
    ["f8", "space", "tab", "enter"],
    ["escape", "escape"],
    ["f9", "f9", "enter", "f9", "1", "enter"],
    ["f9", "f8", "escape", "escape"],
    ["f10", "enter"],
    ["f10", "n"],
    ["ctrl+c", "escape"],
    ["ctrl+q", "enter"],
    ["f5", "f5"],
]


@pytest.mark.slow
def test_no_slip_ends_a_run(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            acts = list(engine.acts)
            for keys in SLIPS:
                await driver.press(*keys)
                assert engine.run.phase is Phase.RUNNING, keys
                assert engine.acts == acts, keys
                assert driver.app.is_running, keys
                for _ in driver.console.dialogs.copy():
                    await driver.press("escape")

    asyncio.run(drive())


def test_abort_is_confirmed_by_y_after_a_reason(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            assert "ABORT the run" in driver.text
            assert "> n no, the run goes on" in driver.text
            await driver.press("1")
            assert "chosen: robot unsafe" in driver.text
            await driver.press("y")
            assert engine.run.outcome is Outcome.ABORTED
            assert engine.run.outcome_reason == "robot unsafe"

    asyncio.run(drive())


def test_the_reason_can_be_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "o", "enter")
            assert "a reason is needed" in driver.text
            await driver.type("smoke, [b]much[")
            await driver.press("enter", "y")
            assert engine.acts[-1] == Abort("smoke, [b]much[")

    asyncio.run(drive())


def test_the_clock_stays_in_view_and_runs_on_under_a_dialog(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            before = driver.rows()[2:5]
            await driver.let_pass(2.0)
            assert driver.rows()[2:5] != before
            assert "4:57 left" in driver.text

    asyncio.run(drive())


def test_abort_comes_before_a_note_that_is_being_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("n", "a", "f8", "1", "y")
            assert engine.run.outcome is Outcome.ABORTED
            await driver.press("b", "enter")
            assert engine.acts[-1] == AddNote("ab")

    asyncio.run(drive())


def test_other_keys_wait_for_the_open_question(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("i", "f9", "f2")
            assert "A question is open" in driver.console.status
            assert driver.console.pane == "live"
            assert len(driver.console.dialogs) == 1

    asyncio.run(drive())


def test_an_act_that_came_too_late_is_refused_in_words(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "1")
            engine.finish()
            await driver.press("y")
            assert engine.run.outcome is Outcome.COMPLETED
            assert "Refused: abort: the run has stopped" in driver.console.status

    asyncio.run(drive())


def test_a_ruling_shows_what_the_sensors_and_the_referee_say(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.do_step(Step.TOUCH)
            await driver.press("1")
            assert "Sensors: 1.000 s. Referee: nothing yet." in driver.text
            await driver.press("down", "enter", "o")
            await driver.type("only brushed")
            await driver.press("enter", "y")
            assert engine.acts[-1] == Rule(Step.TOUCH, confirmed=False, reason="only brushed")

    asyncio.run(drive())


def test_leaving_asks_while_a_run_goes_on_and_while_its_result_is_not_final(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f10")
            assert "LEAVE the console while a run goes on" in driver.text
            await driver.press("y")
            assert not driver.app.is_running
        engine.finish()
        async with driving(engine) as driver:
            await driver.press("f10")
            assert "the history (h) opens it later" in driver.text
            await driver.press("n", "f", "a", "enter", "ctrl+c")
            assert not driver.app.is_running
        assert not engine.closed  # who opened the client closes it

    asyncio.run(drive())


def test_next_run_asks_while_the_result_is_not_final(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("x")
            assert "The last result is not final" in driver.text
            await driver.press("enter")
            assert engine.acts[-1] == Start()
            await driver.press("x", "y")
            assert engine.run.phase is Phase.READY
            assert driver.console.pane == "setup"

    asyncio.run(drive())


def test_after_an_abort_the_next_run_is_one_key_away(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "1", "y")
            engine.score()
            await driver.settle()
            await driver.press("x")
            assert engine.run.phase is Phase.READY
            assert engine.run.setup is not None
            assert engine.run.setup.run_number == 2

    asyncio.run(drive())


def test_finalising_asks_for_the_name_where_none_was_set(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab", "tab", "backspace")
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("f", "a", "enter", "enter")
            assert "finalising needs the referee's name" in driver.text
            await driver.type("Bo")
            await driver.press("enter")
            assert engine.run.closure is not None
            assert engine.run.closure.referee == "Bo"
            assert "final: acknowledged by the team, signed Bo" in driver.text

    asyncio.run(drive())
