"""The wall display: read from far away, and it can do nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import pytest
from textual.worker import WorkerCancelled

from madrob_console.common.names import SourceKind
from madrob_console.engine.requests import Role
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.acts import Start
from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.wall import PAUSED, WallApp
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    SMALL,
    Shown,
    Story,
    engine_does,
    follow,
    has,
    no,
    passes,
    resized,
    sets,
)
from tests.madrob_console.ui.inline_engine import EPOCH, HandEngine, start
from tests.madrob_console.ui.prepared import a_setup


@dataclass
class Hall(Shown):
    """A wall display under test."""

    app: WallApp
    engine: HandEngine
    clock: list[float] = field(default_factory=lambda: [0.0])

    async def let_pass(self, duration: float) -> None:
        """Time in the hall, and of the engine."""
        self.clock[0] += duration
        self.engine.tick(duration)
        await self.settle()

    async def settle(self) -> None:
        for _ in range(2):  # the next engine is found meanwhile
            self.app.poll()
            with suppress(WorkerCancelled):  # another one took its place
                await self.app.workers.wait_for_complete()
            await self.drawn()

    def large(self, text: str) -> bool:
        """Whether a number is there in large digits, one row below the other."""
        first, *more = map(str.strip, digit_rows(text))
        rows = self.rows()
        return any(
            first in row
            and all(one in below for one, below in zip(more, rows[at + 1 :], strict=False))
            for at, row in enumerate(rows)
        )

    def band(self) -> str:
        """The words in the coloured band."""
        skipped = 2 if "What you see" in self.rows()[1] else 1
        return next(row.strip() for row in self.rows()[skipped:] if row.strip())


class Case(NamedTuple):
    """A hall and what is seen there, with this engine."""

    rows: Story
    size: tuple[int, int] = SMALL
    engine: Mapping[str, Any] = {}
    team: str | None = None
    """Whose run goes on."""


LIVE = {"kind": SourceKind.ROS, "label": "LIVE ros"}


def goes_on(engine: HandEngine, team: str = "Delft") -> None:
    start(engine, 5.0, team=team)


def large(*numbers: str) -> Callable[[Hall], object]:
    return lambda wall: all(map(wall.large, numbers))


def says(words: str) -> Callable[[Hall], object]:
    """In the band."""
    return lambda wall: wall.band() == words


def in_row(number: int, words: str) -> Callable[[Hall], object]:
    return lambda wall: words in wall.rows()[number]


async def see(case: Case) -> None:
    engine = HandEngine(right=RightToAct(Role.WATCH), **case.engine)
    if case.team is not None:
        goes_on(engine, case.team)
    clock = [0.0]
    app = WallApp(engine.find, DEFAULTS, monotonic=lambda: clock[0])
    async with app.run_test(size=case.size) as pilot:
        wall = Hall(app, pilot, engine, clock)
        await Shown.until(wall, "WATCHING")
        await follow(wall, case.rows)
    engine.end()


def follows(wall: Hall) -> None:
    """The next engine is there, and a run goes on."""
    wall.engine.follower = HandEngine(right=RightToAct(Role.WATCH))
    goes_on(wall.engine.follower, "Next")


def says_no_key(wall: Hall) -> object:
    return not [key for key in ("F2", "F5", "F8", " f ", "1-6", "PgDn") if key in wall.text]


def in_phase(phase: Phase) -> Story:
    outcome = Outcome.COMPLETED if phase in (Phase.STOPPED, Phase.FINAL) else None
    run = Run(phase, a_setup(), start=EPOCH - 3.0, outcome=outcome)
    return [(sets(run=run, elapsed=3.0),), (passes(1.0), says_no_key)]


TEAMS = ("東京大学", 'Robo "Doors" Berlin', "Zürich 🤖", "A" * 60, "")
SIZES = ((40, 10), (60, 18), (80, 24), (120, 36), (200, 50))


def steps_are_there(wall: Hall) -> object:
    """Each with its word, done ones with their times."""
    text = wall.text
    words = (step.name.lower() for step in Step)
    return all(word in text for word in (*words, "1.000", "next"))


def team_has_its_row(team: str) -> Callable[[Hall], object]:
    def shown(wall: Hall) -> object:
        name, *_ = (row.strip() for row in wall.rows() if f"{row.strip()} ".startswith("1 "))
        return name in {f"1 {team}".strip(), f"1 {team}"[: wall.app.size.width - 1] + "…"}

    return shown


CASES = {
    **{
        f"state team clock level and steps are there at once: {size}": Case(
            [
                (passes(1.0),),
                (engine_does(HandEngine.do_step, Step.TOUCH),),
                (
                    passes(1.5),
                    large("0:02.5", "1"),
                    says("RUNNING"),
                    steps_are_there,
                    in_row(0, "WATCHING"),
                    "of 6 steps",
                    "1 Delft",
                    "run 1, condition 1: pull",
                ),
            ],
            size,
            team="Delft",
        )
        for size in SIZES
    },
    "a time that may still change is marked": Case(
        [
            *((engine_does(HandEngine.do_step, step),) for step in list(Step)[:4]),
            (passes(1.0), "0.000", "~0.0"),
        ],
        team="Delft",
    ),
    **{
        f"nothing says what a referee could press: {size}": Case(
            [row for phase in Phase for row in in_phase(phase)],
            size,
            LIVE,
        )
        for size in ((60, 18), SMALL, (160, 50))
    },
    **{
        f"a team's name has one row in any script: {team[:9]}": Case(
            [(resized(width, 24), team_has_its_row(team)) for width in (60, 80, 120)], team=team
        )
        for team in TEAMS
    },
    "the hall hears of a pause, and since when it has lasted": Case(
        [
            (sets(pulse=Pulse(server=3)),),
            (passes(1.0), says(PAUSED), in_row(1, "What you see is of")),
            (has(failure="the engine has ended"), says(PAUSED)),
            (sets(failure=None, pulse=Pulse()),),
            (passes(60.0), says("RUNNING"), no("What you see")),
        ],
        team="Delft",
    ),
    "the next engine is found by itself": Case(
        [
            (sets(failure="the engine has ended"),),
            (passes(1.0), says(PAUSED)),
            (follows,),
            (passes(4.0),),
            (Hall.settle, says("RUNNING"), "1 Next"),
        ],
        team="Delft",
    ),
    "no key but those that leave does anything": Case(
        [
            (
                "f8 y f9 1 f x ctrl+p t enter",
                lambda wall: isinstance(wall.engine.acts[-1], Start),
                lambda wall: wall.app.is_running,
            ),
            ("q", lambda wall: not wall.app.is_running),
        ],
        team="Delft",
    ),
    "a rehearsal is named": Case(
        [(passes(1.0), in_row(0, "REHEARSAL SIMULATED"))],
        SMALL,
        {"competition": "REHEARSAL Cup", "label": "SIMULATED nominal", "simulated": "nominal"},
    ),
}


@pytest.mark.parametrize("case", CASES)
async def test_what_the_hall_sees(case: str) -> None:
    await see(CASES[case])
