"""Every screen as it was looked at and found good; `pytest --update-screens` stores new ones."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.engine.shown.snapshot import Weight
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.journal import Origin
from madrob_console.referee.teams import TeamList
from scoring.protocol import Outcome, Side, Step
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.test_doubts import doubted

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

    for name, text in asyncio.run(drive()).items():
        compare(name, size, text, request)


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_a_large_plan_is_as_it_was_looked_at(
    engine: FakeEngine, size: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    teams, conditions = range(1, 13), range(1, 21)
    lines = (PlanLine(Task(team, condition), 2) for team in teams for condition in conditions)
    engine.plan = Plan(tuple(lines))
    engine.teams = TeamList({team: f"Robots of university {team}" for team in teams})
    engine.history = [
        summary(
            *(team, condition, run),
            hour=team + condition / 50 + run / 1000,
            values={"capability_level": (team * condition) % 7},
            outcome=Outcome.ABORTED if (team + condition) % 9 == 0 else Outcome.COMPLETED,
        )
        for team in teams
        for condition in conditions
        for run in (1, 2)
        if team * condition * run < 60
    ]

    async def drive() -> str:
        async with driving(engine, size) as driver:
            await driver.press("f3", "p")
            await driver.app.workers.wait_for_complete()
            await driver.settle()
            return driver.text

    compare("plan", size, asyncio.run(drive()), request)


def compare(name: str, size: tuple[int, int], text: str, request: pytest.FixtureRequest) -> None:
    """A screen with the stored one."""
    path = STORED / f"{name}_{size[0]}x{size[1]}.txt"
    if request.config.getoption("--update-screens"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text + "\n")
    assert text + "\n" == path.read_text(), path.name


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_a_doubted_result_is_as_it_was_looked_at(
    engine: FakeEngine, size: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    async def drive() -> str:
        async with driving(engine, size) as driver:
            await doubted(driver)
            return driver.text

    compare("doubts", size, asyncio.run(drive()), request)


async def in_the_middle_of_a_run(driver: Driver) -> None:
    """The robot holds the door open and stands in the doorway."""
    engine = driver.engine
    for step in (Step.TOUCH, Step.UNLOCK, Step.OPEN):
        engine.do_step(step)
    engine.angle, engine.force, engine.maximum = 0.52, 7.4, 15.2
    engine.occupied = {(Side.CCW, 1), (Side.CCW, 3)}
    engine.provisional = {"time_to_handle": 1.0}
    engine.say("handle touched")
    engine.say("door opens")
    engine.say("incident: collision", Origin.REFEREE, Weight.NOTICE)
    for _ in range(4):  # top line and log wait for their turn
        await driver.settle()
