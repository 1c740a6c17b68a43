"""What is on the screen can be clicked."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from textual.events import MouseDown, MouseUp
from textual.widgets import Input

from madrob_console.referee.acts import Abort, SetUp
from madrob_console.referee.run import Phase
from madrob_console.ui.panes.history_pane import HistoryPane
from scoring.protocol import Side
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import DEFAULTS, LARGE, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine


async def click(driver: Driver, text: str, within: str = "", times: int = 1) -> None:
    """Click on the first character of a text, in the first row that holds it and `within`."""
    rows: Sequence[str] = driver.rows()
    y = next(y for y, row in enumerate(rows) if text in row and within in row)
    await driver.pilot.click(offset=(rows[y].index(text), y), times=times)
    await driver.settle()


async def press_button(driver: Driver, text: str) -> None:
    """The same as the terminal tells of it."""
    y, row = next((y, row) for y, row in enumerate(driver.rows()) if text in row)
    x = row.index(text)
    for kind in (MouseDown, MouseUp):
        event = kind(None, x, y, 0, 0, 1, False, False, False, x, y)
        event.set_sender(driver.app)
        assert driver.app._driver is not None
        driver.app._driver.send_message(event)
        await driver.pilot.pause()
    await driver.pilot.pause()


def test_the_keys_of_the_footer_are_clicked(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, LARGE) as driver:
            await click(driver, "F3")
            assert driver.console.pane == "live"
            await click(driver, "History")
            assert driver.console.pane == "history"
            await click(driver, "F8")
            assert "Refused: abort: no run is set up yet" in driver.console.status
            await driver.press("f3")
            await driver.run()
            await driver.press("f3")
            await click(driver, "6 ", "Step")
            assert "Step 6: lock the door" in driver.text

    asyncio.run(drive())


def test_answers_are_clicked(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await click(driver, "F8")
            await click(driver, "testbed fault")
            await click(driver, "no (also Enter, Escape)")
            assert engine.run.phase is Phase.RUNNING
            await click(driver, "F8")
            await click(driver, "robot unsafe")
            await click(driver, "y yes")
            assert engine.acts[-1] == Abort("robot unsafe")

    asyncio.run(drive())


def test_a_click_that_comes_as_the_question_changes_is_left_out(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f10")
            engine.finish()
            await driver.settle()
            assert "The result is not final" in driver.text
            driver.hand.gap = 0.0
            await press_button(driver, "y yes")
            assert driver.app.is_running
            assert "the click is left out" in driver.text
            driver.hand.gap = 1.0
            await press_button(driver, "y yes")
            assert not driver.app.is_running

    asyncio.run(drive())


def test_the_form_is_filled_by_the_mouse(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("escape")
            await click(driver, "Door Bots")
            assert isinstance(driver.app.focused, Input)
            await driver.press("escape")
            await click(driver, "CCW >", "Opening side")
            setup = engine.run.setup
            assert setup is not None
            assert setup.condition.opening_side is Side.CW
            await click(driver, "Set up this run")
            assert isinstance(engine.acts[-1], SetUp)
            await click(driver, "start pose", times=2)
            assert "Waive 'start pose' for this run" in driver.text

    asyncio.run(drive())


def test_rows_are_marked_and_opened_and_heads_sort(engine: FakeEngine, tmp_path: Path) -> None:
    for number in (1, 2, 3):
        write(tmp_path, summary(number))
    defaults = replace(DEFAULTS, results=tmp_path)

    async def drive() -> None:
        async with driving(engine, LARGE, defaults=defaults) as driver:
            await driver.press("escape", "h")
            await driver.app.workers.wait_for_complete()
            await driver.settle()
            table = driver.console.query_one(HistoryPane).table
            assert [run.subject for run in table.rows] == [3, 2, 1]
            await click(driver, "sub")
            assert [run.subject for run in table.rows] == [1, 2, 3]
            await click(driver, "sub")
            assert [run.subject for run in table.rows] == [3, 2, 1]
            y = next(y for y, row in enumerate(driver.rows()) if row.lstrip().startswith("> "))
            await driver.pilot.click(offset=(10, y + 1), times=2)
            await driver.settle()
            assert engine.opened == [table.rows[1].folder]

    asyncio.run(drive())
