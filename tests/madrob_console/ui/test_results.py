from __future__ import annotations

import asyncio

import pytest

from madrob_console.kinds import SourceKind
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import LARGE, SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine


async def finished(driver: Driver, outcome: Outcome = Outcome.COMPLETED) -> None:
    await driver.run()
    for step in Step:
        driver.engine.do_step(step)
    driver.engine.finish(outcome, "because")
    await driver.settle()


async def whole_text(driver: Driver) -> str:
    """The pane from top to bottom."""
    text = driver.text
    for _ in range(4):
        await driver.press("pagedown")
        text += driver.text
    return text


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_a_result_is_shown_whole(engine: FakeEngine, size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            await driver.press("i", "c", "n", *"dent", "enter")
            for step in Step:
                engine.do_step(step)
            engine.finish()
            await driver.settle()
            text = await whole_text(driver)
            for words in (
                "COMPLETED (step 6 is done)",
                "run 1 of subject 1 Door Bots, condition 1: No Force, pull, from CCW to CW",
                "ruleset protocol, issue 1, not final yet: f finalises it",
                "SIMULATED: not an official result",
                "execution time *                17.4320 s",
                "smoothness of door actuation     0.0625 s^3/rad",
                "capability level                      6 steps",
                "✓ 6 lock the door         1.000  -           1.000",
                "door angle           1221  50.0    21.3    0    0.8    4.0    0     0    0",
                "incident          +1.00 s collision",
                "note              +1.00 s dent",
                f"files             {FOLDER}",
            ):
                assert words in " ".join(text.splitlines()) or words in text
            assert "…" not in text.replace(driver.rows()[0], "")

    asyncio.run(drive())


def test_the_first_screen_shows_outcome_and_all_indicators(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            assert "COMPLETED" in driver.text
            assert "execution time" in driver.text
            assert "capability level" in driver.text

    asyncio.run(drive())


def test_a_missing_indicator_says_why(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver, Outcome.TIMEOUT)
            assert "TIMEOUT (because)" in driver.text
            reason = "passage time                 none: robot never reached the destination side"
            assert reason in driver.text

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome.ABORTED, "ABORTED: the run is invalid (because)"),
        (Outcome.INTERRUPTED, "INTERRUPTED: the machine failed, left out of every aggregate"),
    ],
)
def test_an_outcome_that_does_not_count_says_so(
    engine: FakeEngine, outcome: Outcome, words: str
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver, outcome)
            assert words in driver.text

    asyncio.run(drive())


def test_a_live_result_is_not_marked_as_simulated(engine: FakeEngine) -> None:
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"

    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            assert "not an official result" not in driver.text

    asyncio.run(drive())


def test_before_a_result_the_pane_says_so(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f4")
            assert "No result yet" in driver.text

    asyncio.run(drive())


def test_nothing_of_an_old_result_stays_behind_an_abort(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            await driver.press("x", "y", "f4")
            assert "No result yet" in driver.text
            assert "execution time" not in driver.text

    asyncio.run(drive())


def test_another_result_begins_at_its_top(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            await driver.press("pagedown", "pagedown")
            assert "COMPLETED" not in driver.text
            await driver.press("x", "y", "f6", "f5")
            await driver.let_pass(6.0)
            engine.finish()
            await driver.settle()
            assert "COMPLETED" in driver.text
            assert "run 2 of subject 1" in driver.text

    asyncio.run(drive())
