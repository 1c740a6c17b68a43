"""Every screen as it was looked at and found good; `pytest --update-screens` stores new ones."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.engine.shown.snapshot import Weight
from madrob_console.referee.journal import Origin
from scoring.protocol import Side, Step
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

STORED = Path(__file__).parent / "screens"
SIZES = ((80, 24), (160, 50))


@pytest.fixture(autouse=True)
def _clock_of_the_screens(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_the_screens_are_as_they_were_looked_at(
    engine: FakeEngine, size: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    async def drive() -> dict[str, str]:
        seen = {}
        async with driving(engine, size) as driver:
            await driver.press("f2", "enter")
            seen["setup"] = driver.text
            await driver.press("f6", "f5")
            await driver.let_pass(6.0)
            await in_the_middle_of_a_run(driver)
            seen["live"] = driver.text
            await driver.press("f8")
            seen["abort"] = driver.text
            await driver.press("escape")
            engine.finish()
            await driver.settle()
            await driver.settle()
            seen["results"] = driver.text
            await driver.press("f1")
            seen["help"] = driver.text
        return seen

    update = request.config.getoption("--update-screens")
    for name, text in asyncio.run(drive()).items():
        path = STORED / f"{name}_{size[0]}x{size[1]}.txt"
        if update:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text + "\n")
        assert text + "\n" == path.read_text(), path.name


async def in_the_middle_of_a_run(driver: Driver) -> None:
    """The robot holds the door open and stands in the doorway."""
    engine = driver.engine
    for step in (Step.TOUCH, Step.UNLOCK, Step.OPEN):
        engine.do_step(step)
    engine.angle, engine.force, engine.maximum = 0.52, 7.4, 15.2
    engine.occupied = {(Side.CCW, 1), (Side.CCW, 3)}
    engine.provisional = {"time_to_handle": 1.0}
    engine.say("handle_is_touched")
    engine.say("door_opens")
    engine.say("incident: collision", Origin.REFEREE, Weight.NOTICE)
    for _ in range(4):  # top line and log wait for their turn
        await driver.settle()
