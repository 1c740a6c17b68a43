"""The wall display: read from far away, and it can do nothing."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.worker import WorkerCancelled

from madrob_console.common.names import SourceKind
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.requests import Role
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.run import Phase, Run
from madrob_console.ui.wall import PAGE_TIME, WallApp, WallScreen
from scoring.protocol import Outcome, Step
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import DEFAULTS, drawn, rows_of
from tests.madrob_console.ui.fake_engine import FakeEngine, a_setup

SIZES = pytest.mark.parametrize("size", [(60, 18), (80, 24), (120, 36), (160, 50), (300, 80)])


@dataclass
class Hall:
    """A wall display under test."""

    app: WallApp
    engine: FakeEngine
    pilot: Pilot[None]
    clock: list[float]

    async def let_pass(self, duration: float) -> None:
        """Time in the hall, and of the engine."""
        self.clock[0] += duration
        self.engine.tick(duration)
        await self.look()

    async def look(self) -> None:
        screen = self.app.screen
        assert isinstance(screen, WallScreen)
        for _ in range(2):  # what is read meanwhile is shown at the next look
            screen.poll()
            with suppress(WorkerCancelled):  # another one took its place
                await self.app.workers.wait_for_complete()
            await self.pilot.pause()
        await drawn(self.pilot)

    def rows(self) -> Sequence[str]:
        return rows_of(self.app)

    @property
    def text(self) -> str:
        return "\n".join(self.rows())

    @property
    def tallest(self) -> int:
        """The most rows one below the other with large letters in them."""
        most = count = 0
        for row in self.rows():
            count = count + 1 if {"█", "▀", "▄"} & set(row) else 0
            most = max(most, count)
        return most


@asynccontextmanager
async def hall(
    engine: FakeEngine,
    results: Path,
    size: tuple[int, int] = (80, 24),
    *,
    ascii_only: bool = False,
    find: Callable[[], FakeEngine] | None = None,
) -> AsyncIterator[Hall]:
    clock = [0.0]
    engine.right = RightToAct(Role.WATCH)
    defaults = replace(DEFAULTS, results=results)
    look = ConsoleSettings(ascii=ascii_only)
    app = WallApp(find or (lambda: engine), defaults, look, lambda: clock[0])
    async with app.run_test(size=size) as pilot:
        shown = Hall(app, engine, pilot, clock)
        while "WATCHING" not in shown.text:  # until the engine is there; the test has a time limit
            await shown.look()
        yield shown


def running(engine: FakeEngine, team: str = "Door Bots") -> None:
    setup = replace(a_setup(), team=team)
    engine.run = Run(Phase.RUNNING, setup, True, start=engine.now)


@SIZES
async def test_a_run_is_one_large_clock_with_state_team_and_steps(
    engine: FakeEngine, tmp_path: Path, size: tuple[int, int]
) -> None:

    running(engine)
    async with hall(engine, tmp_path, size) as wall:
        await wall.let_pass(1.0)
        engine.do_step(Step.TOUCH)
        await wall.let_pass(1.5)
        assert wall.tallest >= size[1] // 4
        assert "WATCHING" in wall.rows()[0]
        assert "✓ 1 touch the handle 1.000" in wall.text
        assert "> 2 unlock the door" in wall.text
        assert "  6 lock the door" in wall.text
        assert "condition 1: pull, from CCW to CW" in wall.text
        assert len(wall.rows()) == size[1]


async def test_the_clock_is_larger_in_a_larger_terminal(engine: FakeEngine, tmp_path: Path) -> None:

    running(engine)
    tallest = []
    for size in ((60, 18), (80, 24), (120, 36), (160, 50), (300, 80)):
        async with hall(engine, tmp_path, size) as wall:
            tallest.append(wall.tallest)
    assert tallest == sorted(set(tallest))


@SIZES
async def test_nothing_says_what_a_referee_could_press(
    engine: FakeEngine, tmp_path: Path, size: tuple[int, int]
) -> None:

    write(tmp_path, summary())
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    seen = []
    async with hall(engine, tmp_path, size) as wall:
        for phase in Phase:
            outcome = Outcome.COMPLETED if phase in (Phase.STOPPED, Phase.FINAL) else None
            engine.run = Run(phase, a_setup(), start=engine.now - 3.0, outcome=outcome)
            for _ in range(4):
                await wall.let_pass(PAGE_TIME)
                seen.append(wall.text)
    for text in seen:
        assert not [key for key in ("F2", "F5", "F8", " f ", "1-6", "PgDn") if key in text]


async def test_result_and_standings_come_in_turn_while_nothing_runs(
    engine: FakeEngine, tmp_path: Path
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    for subject in range(1, 31):
        write(tmp_path, summary(subject=subject, hour=subject))
    async with hall(engine, tmp_path) as wall:
        seen = []
        for _ in range(4):
            seen.append(wall.text)
            await wall.let_pass(PAGE_TIME)
        assert "execution time" in seen[0]
        assert "STANDINGS 1 of 2" in seen[1]
        assert "1 Team 1" in seen[1]
        assert "30 Team 30" in seen[2]
        assert "execution time" in seen[3]
        running(engine)
        await wall.let_pass(PAGE_TIME)
        for _ in range(3):
            await wall.let_pass(PAGE_TIME)
            assert "1 touch the handle" in wall.text


async def test_practice_runs_are_not_among_official_ones(
    engine: FakeEngine, tmp_path: Path
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    write(tmp_path, summary(subject=5, hour=1))
    write(tmp_path, summary(subject=6, hour=2, source="simulated"))
    async with hall(engine, tmp_path) as wall:
        await wall.let_pass(PAGE_TIME)
        assert "STANDINGS" in wall.text
        assert "5 Team 5" in wall.text
        assert "Team 6" not in wall.text


async def test_teams_of_another_competition_are_not_on_the_wall(
    engine: FakeEngine, tmp_path: Path
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    write(tmp_path, summary(subject=5, hour=1))
    write(tmp_path, summary(subject=6, hour=2, competition="Spring Cup"))
    async with hall(engine, tmp_path) as wall:
        for _ in range(3):
            assert "Team 6" not in wall.text
            await wall.let_pass(PAGE_TIME)
        assert "5 Team 5" in wall.text


@pytest.mark.parametrize("team", ["東京大学", "Zürich", "A" * 60, ""])
@pytest.mark.parametrize("ascii_only", [False, True])
async def test_every_name_is_there_in_letters_or_large(
    engine: FakeEngine, tmp_path: Path, team: str, *, ascii_only: bool
) -> None:

    running(engine, team)
    async with hall(engine, tmp_path, (160, 50), ascii_only=ascii_only) as wall:
        assert len(wall.rows()) == 50
        assert wall.tallest >= 10 or ascii_only
        if not team.isascii() and team != "Zürich" and not ascii_only:
            assert team in wall.text


async def test_an_engine_that_is_silent_or_gone_is_said(engine: FakeEngine, tmp_path: Path) -> None:

    running(engine)
    async with hall(engine, tmp_path) as wall:
        engine.pulse = Pulse(server=3)
        await wall.let_pass(1.0)
        assert "silent for 3 s" in wall.rows()[1]
        engine.failure = "the engine has ended"
        await wall.look()
        assert "ended" in wall.rows()[1]
        engine.failure = None
        engine.pulse = Pulse()
        await wall.let_pass(60.0)
        assert "ended" not in wall.text


async def test_the_next_engine_is_found_by_itself(engine: FakeEngine, tmp_path: Path) -> None:

    running(engine)
    engines = [engine]

    async with hall(engine, tmp_path, find=lambda: engines[-1]) as wall:
        engine.failure = "the engine has ended"
        await wall.let_pass(1.0)
        assert wall.tallest >= 3  # NO ENGINE
        engines.append(FakeEngine(right=RightToAct(Role.WATCH)))
        running(engines[-1], "Next")
        await wall.let_pass(4.0)
        await wall.look()
        assert "ended" not in wall.text
        assert wall.tallest > 5


async def test_no_key_but_those_that_leave_does_anything(
    engine: FakeEngine, tmp_path: Path
) -> None:

    running(engine)
    async with hall(engine, tmp_path) as wall:
        await wall.pilot.press("f8", "y", "f9", "1", "f", "x", "ctrl+p", "t", "enter")
        await wall.look()
        assert engine.acts == []
        assert wall.app.is_running
        await wall.pilot.press("q")
        assert not wall.app.is_running
