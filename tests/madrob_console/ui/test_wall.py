"""The wall display: read from far away, and it can do nothing."""

from __future__ import annotations

import time
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
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.lists import TeamList
from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.large_text import large_text
from madrob_console.ui.look.themes import to_ascii
from madrob_console.ui.wall import PAGE_TIME, WallApp
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
        for _ in range(2):  # what is read meanwhile is shown at the next look
            self.app.poll()
            with suppress(WorkerCancelled):  # another one took its place
                await self.app.workers.wait_for_complete()
            await self.pilot.pause()
        await drawn(self.pilot)

    def rows(self) -> Sequence[str]:
        return rows_of(self.app)

    @property
    def text(self) -> str:
        return "\n".join(self.rows())

    def size_of(self, text: str) -> int:
        """How large a text is: 0 in ordinary letters, -1 if it is not there at all."""
        found = (size for size in range(12, 0, -1) if self._has(large_text(text, size)))
        return next(found, 0 if text in self.text else -1)

    def _has(self, large: Sequence[str] | None) -> bool:
        """Whether these rows stand one below the other."""
        if large is None:
            return False
        first, *more = (to_ascii(row) if self.app.ascii else row for row in large)
        screen = self.rows()
        return any(
            all(below[at:].startswith(row.rstrip()) for below, row in zip(rest, more, strict=False))
            for number, begin in enumerate(screen)
            if len(rest := screen[number + 1 :]) >= len(more)
            for at in range(len(begin))
            if begin.startswith(first.rstrip(), at)
        )


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
            await pilot.pause()
        await shown.look()
        yield shown


def running(engine: FakeEngine, team: str = "Delft") -> None:
    setup = replace(a_setup(), team=team)
    engine.run = Run(Phase.RUNNING, setup, True, start=engine.now)


STEPS = ["✓1 1.000", ">2 UNLOCK", "□3 OPEN", "□4 CROSS", "□5 CLOSE", "□6 LOCK"]


@pytest.mark.parametrize(
    ("size", "clock", "team", "steps", "state"),
    [
        ((40, 10), 1, 0, 0, 0),
        ((60, 18), 2, 2, 0, 1),
        ((80, 24), 2, 1, 1, 1),
        ((120, 36), 4, 3, 1, 2),
        ((200, 50), 4, 4, 2, 2),
        ((240, 67), 5, 4, 3, 3),
    ],
)
async def test_clock_team_steps_and_state_are_as_large_as_there_is_room(
    engine: FakeEngine,
    tmp_path: Path,
    size: tuple[int, int],
    clock: int,
    team: int,
    steps: int,
    state: int,
) -> None:
    running(engine)
    async with hall(engine, tmp_path, size) as wall:
        await wall.let_pass(1.0)
        engine.do_step(Step.TOUCH)
        await wall.let_pass(1.5)
        assert wall.size_of("0:02.5") == clock
        assert wall.size_of("1 Delft") == team
        assert [wall.size_of(step) for step in STEPS] == [steps] * 6
        assert wall.size_of("RUNNING") == state
        assert "WATCHING" in wall.rows()[0]
        assert wall.size_of("run 1, condition 1: pull") >= 0
        assert sum(not row.strip() for row in wall.rows()) <= size[1] // 4


async def test_what_the_plan_has_next_is_shown_with_its_time_and_delay(
    engine: FakeEngine, tmp_path: Path
) -> None:
    at = time.strftime("%H:%M", time.localtime(engine.now - 12 * 60))
    engine.kind, engine.simulated = SourceKind.ROS, None
    engine.plan = Plan((PlanLine(Task(2, 7), 1, at),))
    engine.teams = TeamList({2: "Ghent"})
    async with hall(engine, tmp_path, (120, 36)) as wall:
        assert wall.size_of("NEXT") > 0
        assert wall.size_of("2 Ghent") > 0
        assert wall.size_of(at) > 0
        assert wall.size_of("12 min LATE") >= 0
        assert "condition 7: " in wall.text
        running(engine)
        await wall.let_pass(1.0)
        assert wall.size_of("NEXT") == -1


async def test_a_time_that_may_still_change_is_marked(engine: FakeEngine, tmp_path: Path) -> None:
    running(engine)
    async with hall(engine, tmp_path) as wall:
        for step in (Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS):
            engine.do_step(step)
        await wall.let_pass(1.0)
        assert wall.size_of("✓3 0.000") > 0
        assert wall.size_of("✓4 ~0.0") > 0


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
        for _ in range(2):
            assert "execution time" in wall.text
            assert wall.size_of("6 steps") > 0
            assert wall.size_of("17.43 s") > 0
            await wall.let_pass(PAGE_TIME)
            assert wall.size_of("STANDINGS 1 of 2") >= 0
            assert "1 Team 1" in wall.text
            await wall.let_pass(PAGE_TIME)
            assert wall.size_of("STANDINGS 2 of 2") >= 0
            assert "30 Team 30" in wall.text
            await wall.let_pass(PAGE_TIME)
        running(engine)
        await wall.let_pass(PAGE_TIME)
        for _ in range(3):
            await wall.let_pass(PAGE_TIME)
            assert wall.size_of(">1 TOUCH") > 0


@pytest.mark.parametrize(
    ("size", "numbers", "name"),
    [((80, 24), 1, 0), ((120, 36), 1, 1), ((200, 50), 1, 1), ((240, 67), 2, 2)],
)
async def test_levels_and_times_of_few_teams_are_large(
    engine: FakeEngine, tmp_path: Path, size: tuple[int, int], numbers: int, name: int
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    for subject, team in ((1, "Taipei Door Bots"), (2, "東京大学"), (3, "IIT")):
        write(tmp_path, summary(subject=subject, team=team, hour=subject))
    async with hall(engine, tmp_path, size) as wall:
        await wall.let_pass(PAGE_TIME)
        assert wall.size_of("STANDINGS") > 0
        assert wall.size_of("17.43") == numbers
        assert wall.size_of("1 Taipei Door Bots") == name
        assert "2 東京大学" in wall.text


async def test_practice_runs_are_not_among_official_ones(
    engine: FakeEngine, tmp_path: Path
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    write(tmp_path, summary(subject=5, hour=1))
    write(tmp_path, summary(subject=6, hour=2, source="simulated"))
    async with hall(engine, tmp_path) as wall:
        await wall.let_pass(PAGE_TIME)
        assert wall.size_of("STANDINGS") > 0
        assert wall.size_of("5 Team 5") >= 0
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
        assert wall.size_of("5 Team 5") >= 0


@pytest.mark.parametrize("team", ["東京大学", "Zürich", "A" * 60, ""])
@pytest.mark.parametrize("ascii_only", [False, True])
async def test_every_name_is_there_in_letters_or_large(
    engine: FakeEngine, tmp_path: Path, team: str, *, ascii_only: bool
) -> None:

    running(engine, team)
    async with hall(engine, tmp_path, (160, 50), ascii_only=ascii_only) as wall:
        assert len(wall.rows()) == 50
        assert wall.size_of("0:00.0") >= 4
        if large_text(team, 1) is None and team:
            assert wall.size_of("1 ????????" if ascii_only else team) == 0
        else:
            assert wall.size_of(f"1 {team}".rstrip()) == (0 if len(team) > 50 else 3)


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
        assert wall.size_of("NO ENGINE") >= 1
        engines.append(FakeEngine(right=RightToAct(Role.WATCH)))
        running(engines[-1], "Next")
        await wall.let_pass(4.0)
        await wall.look()
        assert "ended" not in wall.text
        assert wall.size_of("1 Next") >= 1


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
