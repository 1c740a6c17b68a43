"""The wall display: read from far away, and it can do nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from textual.worker import WorkerCancelled

from madrob_console.common.names import SourceKind
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.requests import Role
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.lists import TeamList
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.large_text import large_text
from madrob_console.ui.look.themes import to_ascii
from madrob_console.ui.wall import PAGE_TIME, WallApp
from scoring.protocol import Outcome, Step
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    SMALL,
    Shown,
    Story,
    engine_does,
    follow,
    has,
    no,
    passes,
    set_values,
    sets,
)
from tests.madrob_console.ui.fake_engine import EPOCH, FakeEngine, a_setup
from tests.madrob_console.ui.test_standings_pane import ALIKE


@dataclass
class Hall(Shown):
    """A wall display under test."""

    app: WallApp
    engine: FakeEngine
    clock: list[float] = field(default_factory=lambda: [0.0])

    async def let_pass(self, duration: float) -> None:
        """Time in the hall, and of the engine."""
        self.clock[0] += duration
        self.engine.tick(duration)
        await self.settle()

    async def settle(self) -> None:
        for _ in range(2):  # what is read meanwhile is shown at the next look
            self.app.poll()
            with suppress(WorkerCancelled):  # another one took its place
                await self.app.workers.wait_for_complete()
            await self.drawn()

    def size_of(self, text: str) -> int:
        """How large a text is: 0 in ordinary letters, -1 if it is not there at all."""
        width, height = self.app.size
        for size in range(12, 0, -1):
            rows = large_text(text, size)
            fits = rows and len(rows) <= height and len(rows[0].rstrip()) <= width
            if rows and fits and self._has(rows):
                return size
        return 0 if text in self.text else -1

    def _has(self, large: Sequence[str]) -> bool:
        """Whether these rows stand one below the other."""
        first, *more = ((to_ascii(row) if self.app.ascii else row).rstrip() for row in large)
        screen = self.rows()
        return any(
            all(below[at:].startswith(row) for below, row in zip(rest, more, strict=False))
            for number, begin in enumerate(screen)
            if first in begin and len(rest := screen[number + 1 :]) >= len(more)
            for at in range(len(begin))
            if begin.startswith(first, at)
        )


class Case(NamedTuple):
    """A hall and what is seen there, with this engine and these runs before."""

    rows: Story
    size: tuple[int, int] = SMALL
    engine: Mapping[str, object] = {}
    runs: Sequence[RunSummary] = ()
    ascii_only: bool = False


LIVE = {"kind": SourceKind.ROS, "label": "LIVE ros"}


def goes_on(team: str = "Delft", start: float = EPOCH) -> dict[str, Any]:
    return {"run": Run(Phase.RUNNING, replace(a_setup(), team=team), True, start=start)}


def large(text: str, size: int) -> Callable[[Hall], object]:
    """So large it is."""
    return lambda wall: wall.size_of(text) == size


def there(*texts: str, at_least: int = 0) -> Callable[[Hall], object]:
    """However large they are."""
    return lambda wall: all(wall.size_of(text) >= at_least for text in texts)


def missing(text: str) -> Callable[[Hall], object]:
    return large(text, -1)


def in_row(number: int, words: str) -> Callable[[Hall], object]:
    return lambda wall: words in wall.rows()[number]


def at_most_a_quarter_is_blank(wall: Hall) -> object:
    return sum(not row.strip() for row in wall.rows()) <= wall.app.size.height // 4


async def see(case: Case, results: Path) -> None:
    engine = FakeEngine(right=RightToAct(Role.WATCH))
    set_values(engine, case.engine)
    for run in case.runs:
        write(results, run)
    clock = [0.0]
    look = ConsoleSettings(ascii=case.ascii_only)
    defaults = replace(DEFAULTS, results=results)
    app = WallApp(engine.find, defaults, look, lambda: clock[0])
    async with app.run_test(size=case.size) as pilot:
        wall = Hall(app, pilot, engine, clock)
        await Shown.until(wall, "WATCHING")
        await follow(wall, case.rows)


def says_no_key(wall: Hall) -> object:
    return not [key for key in ("F2", "F5", "F8", " f ", "1-6", "PgDn") if key in wall.text]


def in_phase(phase: Phase) -> Story:
    outcome = Outcome.COMPLETED if phase in (Phase.STOPPED, Phase.FINAL) else None
    run = Run(phase, a_setup(), start=EPOCH - 3.0, outcome=outcome)
    return [(sets(run=run),), *[(passes(PAGE_TIME), says_no_key)] * 3]


ROUND: Story = [
    (Hall.settle, "execution time", there("6 steps", "17.43 s", at_least=1)),
    (passes(PAGE_TIME), there("STANDINGS 1 of 2"), "1 Team 1"),
    (passes(PAGE_TIME), there("STANDINGS 2 of 2"), "30 Team 30"),
    (passes(PAGE_TIME),),
]
STEPS = ["✓1 1.000", ">2 UNLOCK", "□3 OPEN", "□4 CROSS", "□5 CLOSE", "□6 LOCK"]
TWELVE_MINUTES_AGO = time.strftime("%H:%M", time.gmtime(EPOCH - 12 * 60))
NAMED = ("東京大学", "Zürich", "A" * 60, "")


def name_shown(team: str, ascii_only: bool) -> Callable[[Hall], object]:
    if large_text(team, 1) is None and team:
        return large("1 ????????" if ascii_only else team, 0)
    return large(f"1 {team}".rstrip(), 0 if len(team) > 50 else 3)


CASES = {
    **{
        f"clock team steps and state are as large as there is room: {size}": Case(
            [
                (passes(1.0),),
                (engine_does(FakeEngine.do_step, Step.TOUCH),),
                (
                    passes(1.5),
                    large("0:02.5", clock),
                    large("1 Delft", team),
                    *(large(step, steps) for step in STEPS),
                    large("RUNNING", state),
                    in_row(0, "WATCHING"),
                    there("run 1, condition 1: pull"),
                    at_most_a_quarter_is_blank,
                ),
            ],
            size,
            goes_on(),
        )
        for size, clock, team, steps, state in (
            ((40, 10), 1, 0, 0, 0),
            ((60, 18), 2, 2, 0, 1),
            ((80, 24), 2, 1, 1, 1),
            ((120, 36), 4, 3, 1, 2),
            ((200, 50), 4, 4, 2, 2),
            ((240, 67), 5, 4, 3, 3),
        )
    },
    "what the plan has next is shown with its time and delay": Case(
        [
            (
                "",
                there("NEXT", "2 Ghent", TWELVE_MINUTES_AGO, at_least=1),
                there("12 min LATE"),
                "condition 7: ",
            ),
            (sets(**goes_on()),),
            (passes(1.0), missing("NEXT")),
        ],
        LARGE,
        {
            "kind": SourceKind.ROS,
            "plan": Plan((PlanLine(Task(2, 7), 1, TWELVE_MINUTES_AGO),)),
            "teams": TeamList({2: "Ghent"}),
        },
    ),
    "a time that may still change is marked": Case(
        [
            *((engine_does(FakeEngine.do_step, step),) for step in list(Step)[:4]),
            (passes(1.0), there("✓3 0.000", "✓4 ~0.0", at_least=1)),
        ],
        engine=goes_on(),
    ),
    **{
        f"nothing says what a referee could press: {size}": Case(
            [row for phase in Phase for row in in_phase(phase)],
            size,
            LIVE,
            [summary()],
        )
        for size in ((60, 18), SMALL, (160, 50))
    },
    "result and standings come in turn while nothing runs": Case(
        [
            *ROUND,
            *ROUND,
            (sets(**goes_on()),),
            (passes(PAGE_TIME),),
            *[(passes(PAGE_TIME), there(">1 TOUCH", at_least=1))] * 3,
        ],
        SMALL,
        LIVE,
        [summary(subject=subject, hour=subject) for subject in range(1, 31)],
    ),
    **{
        f"levels and times of few teams are large: {size}": Case(
            [
                (
                    passes(PAGE_TIME),
                    there("STANDINGS", at_least=1),
                    large("17.43", numbers),
                    large("1 Taipei Door Bots", name),
                    "2 東京大学",
                ),
            ],
            size,
            LIVE,
            [
                summary(subject=subject, team=team, hour=subject)
                for subject, team in ((1, "Taipei Door Bots"), (2, "東京大学"), (3, "IIT"))
            ],
        )
        for size, numbers, name in (
            ((80, 24), 1, 0),
            ((120, 36), 1, 1),
            ((240, 67), 2, 2),
        )
    },
    **{
        f"{what} is not on the wall": Case(
            [
                *[(passes(PAGE_TIME), no("Team 6"))] * 2,
                (passes(PAGE_TIME), there("5 Team 5"), no("Team 6")),
            ],
            SMALL,
            LIVE,
            [summary(subject=5, hour=1), other],
        )
        for what, other in (
            ("a practice run", summary(subject=6, hour=2, source="simulated")),
            ("a run of another competition", summary(subject=6, hour=2, competition="Spring Cup")),
        )
    },
    **{
        f"every name is there in letters or large: {team[:9]}, {ascii_only}": Case(
            [
                (
                    "",
                    lambda wall: len(wall.rows()) == 50,
                    there("0:00.0", at_least=4),
                    name_shown(team, ascii_only),
                )
            ],
            (160, 50),
            goes_on(team),
            (),
            ascii_only,
        )
        for ascii_only in (False, True)
        for team in NAMED
    },
    "an engine that is silent or gone is said": Case(
        [
            (sets(pulse=Pulse(server=3)),),
            (passes(1.0), in_row(1, "silent for 3 s")),
            (has(failure="the engine has ended"), in_row(1, "ended")),
            (sets(failure=None, pulse=Pulse()),),
            (passes(60.0), no("ended")),
        ],
        engine=goes_on(),
    ),
    "the next engine is found by itself": Case(
        [
            (sets(failure="the engine has ended"),),
            (passes(1.0), there("NO ENGINE", at_least=1)),
            (sets(follower=FakeEngine(right=RightToAct(Role.WATCH), **goes_on("Next"))),),
            (passes(4.0),),
            (Hall.settle, no("ended"), there("1 Next", at_least=1)),
        ],
        engine=goes_on(),
    ),
    "no key but those that leave does anything": Case(
        [
            (
                "f8 y f9 1 f x ctrl+p t enter",
                lambda wall: wall.engine.acts == [],
                lambda wall: wall.app.is_running,
            ),
            ("q", lambda wall: not wall.app.is_running),
        ],
        engine=goes_on(),
    ),
    **{
        f"doubts are shown: {size}": Case(
            [
                (
                    "",
                    "execution time",
                    lambda wall: "17.44? +- 0.02" in " ".join(wall.text.split()),
                ),
                (passes(PAGE_TIME), there("2 Team 2", "17.44?"), "? doubted"),
            ],
            size,
            LIVE,
            ALIKE[::-1],
        )
        for size in ((60, 18), (80, 24), (160, 50))
    },
}


@pytest.mark.parametrize("case", CASES)
async def test_what_the_hall_sees(case: str, tmp_path: Path) -> None:
    await see(CASES[case], tmp_path)
