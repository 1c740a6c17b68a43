"""A competition's plan on the screens: what is next is proposed, and all of it can be seen."""

from __future__ import annotations

import asyncio

import pytest

from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import SetUp
from madrob_console.referee.competition_plan import Attempts, Plan, PlanLine, Task
from madrob_console.referee.run import Phase
from madrob_console.referee.teams import TeamList
from madrob_console.ui.panes.plan_pane import CellView, about, cell
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import LARGE, SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

TEAMS = TeamList({1: "Walkers", 2: "門の騎士", 3: "Delft University Door Openers"})


def plan(*lines: tuple[int, int, int]) -> Plan:
    return Plan(tuple(PlanLine(Task(subject, cond), count) for subject, cond, count in lines))


@pytest.fixture
def planned(engine: FakeEngine) -> FakeEngine:
    """A plan in two rounds, on a real testbed."""
    engine.kind, engine.simulated = SourceKind.ROS, None
    engine.plan = plan((1, 1, 1), (2, 7, 1), (1, 1, 1), (3, 20, 2))
    engine.teams = TEAMS
    return engine


async def end(driver: Driver, outcome: Outcome = Outcome.COMPLETED, source: str = "ros") -> None:
    """The run that is set up goes on and ends; its result is in the results folder."""
    engine = driver.engine
    await driver.press("f6", "f5")
    await driver.let_pass(6.0)
    setup = engine.run.setup
    assert setup is not None
    hour = float(len(engine.history))
    run = summary(*task(engine), setup.run_number, hour=hour, outcome=outcome, source=source)
    engine.history.append(run)
    engine.finish(outcome)
    await ready(driver)


async def ready(driver: Driver) -> None:
    """What waits for the engine has its answer."""
    await driver.settle()
    await driver.app.workers.wait_for_complete()
    await driver.settle()


def task(engine: FakeEngine) -> Task:
    setup = engine.run.setup
    assert setup is not None
    return Task(setup.subject, setup.condition.number)


def test_the_first_run_of_the_plan_is_proposed(planned: FakeEngine) -> None:
    planned.plan = plan((3, 20, 2))

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await ready(driver)
            assert task(planned) == Task(3, 20)
            assert planned.run.setup is not None
            assert planned.run.setup.team == "Delft University Door Openers"
            assert planned.run.setup.start_pose.side is planned.run.setup.condition.starting_side
            assert "Run 1 of subject 3, attempt 1 of 2 is set up." in " ".join(driver.text.split())

    asyncio.run(drive())


def test_after_each_result_x_goes_to_the_next_run_of_the_plan(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            ran: list[Task] = []
            while planned.snapshot().plan.lines and len(ran) < 5:
                ran.append(task(planned))
                await end(driver)
                await driver.press("f", "a", "enter", "x")
                await ready(driver)
                assert planned.run.phase is Phase.READY
            assert ran == [Task(1, 1), Task(2, 7), Task(1, 1), Task(3, 20), Task(3, 20)]

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("outcome", "source", "following"),
    [
        (Outcome.COMPLETED, "ros", Task(2, 7)),
        (Outcome.TIMEOUT, "ros", Task(2, 7)),
        (Outcome.ABORTED, "ros", Task(2, 7)),
        (Outcome.INTERRUPTED, "ros", Task(1, 1)),
        (Outcome.COMPLETED, "simulated", Task(1, 1)),
    ],
)
def test_what_has_used_up_no_attempt_is_set_up_again(
    planned: FakeEngine, outcome: Outcome, source: str, following: Task
) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver, outcome, source)
            await driver.press("x", "y")
            await ready(driver)
            assert planned.run.phase is Phase.READY
            assert task(planned) == following

    asyncio.run(drive())


def test_who_practises_goes_on_with_the_same_team_and_condition(planned: FakeEngine) -> None:
    planned.simulated = "nominal"

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            assert task(planned) == Task(1, 1)
            await end(driver, source="simulated")
            await driver.press("p", "down", "x", "y")
            await ready(driver)
            assert task(planned) == Task(2, 1)
            await end(driver, source="simulated")
            await driver.press("x", "y")
            await ready(driver)
            assert planned.run.setup is not None
            assert task(planned) == Task(2, 1)
            assert planned.run.setup.practice
            assert not planned.run.setup.out_of_plan  # practice never is

    asyncio.run(drive())


def test_one_key_repeats_the_team_and_condition_and_says_that_it_is_out_of_plan(
    planned: FakeEngine,
) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver)
            await driver.press("X", "y")
            await ready(driver)
            setup = planned.run.setup
            assert setup is not None
            assert (task(planned), setup.run_number, setup.out_of_plan) == (Task(1, 1), 2, True)
            text = " ".join(driver.text.split())
            assert "x team failed out of plan: F2 corrects it, w waives" in text
            assert "OUT OF PLAN" not in text  # said once
            await driver.press("x")  # it was the wrong key
            await ready(driver)
            assert planned.run.setup is not None
            assert (task(planned), planned.run.setup.out_of_plan) == (Task(1, 1), True)

    asyncio.run(drive())


def test_a_run_out_of_plan_that_the_plan_takes_in_needs_no_waiver(planned: FakeEngine) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver)
            await driver.press("X", "y")
            await ready(driver)
            await driver.press("f6", "f5")
            assert planned.run.start is None  # out of plan
            planned.plan = plan((1, 1, 2), (2, 7, 1))
            await ready(driver)
            await driver.press("f6", "f5")
            await ready(driver)
            assert planned.run.setup is not None
            assert (task(planned), planned.run.setup.out_of_plan) == (Task(1, 1), False)
            assert planned.run.start is not None

    asyncio.run(drive())


def test_an_aborted_attempt_is_repeated_within_the_plan(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver, Outcome.ABORTED)
            await driver.press("X")
            await ready(driver)
            assert "Run 2 of subject 1, attempt 2 of 2 is set up." in " ".join(driver.text.split())
            assert planned.run.setup is not None
            assert (task(planned), planned.run.setup.out_of_plan) == (Task(1, 1), False)

    asyncio.run(drive())


def test_a_repeated_attempt_is_called_that(planned: FakeEngine) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver, Outcome.ABORTED)
            await driver.press("X")
            await ready(driver)
            assert planned.run.setup is not None
            assert not planned.run.setup.out_of_plan
            assert "an attempt repeated is set up" in " ".join(driver.text.split())

    asyncio.run(drive())


def test_after_a_result_the_screen_says_what_x_sets_up(planned: FakeEngine) -> None:
    hint = "x: 2 門の騎士, condition 7, attempt 1 of 1. X repeats, p shows the plan."

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            assert hint not in driver.text
            await end(driver)
            await driver.press("down")  # the message of the result goes with the next key
            assert hint in driver.text
            await driver.press("x", "y")
            await ready(driver)
            await driver.press("f3")
            assert hint not in driver.text

    asyncio.run(drive())


def test_until_the_plan_knows_of_a_run_nothing_is_said_of_what_x_sets_up(
    planned: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter", "f6", "f5")
            await driver.let_pass(6.0)
            planned.finish()
            result, planned.result = planned.result, None  # it is recorded on, and not scored
            await ready(driver)
            await driver.press("down")
            assert planned.run.phase is Phase.STOPPED
            assert driver.console.status == ""
            planned.result = result
            planned.history.append(summary(1, 1, 1, source="ros"))
            await ready(driver)
            await driver.press("down")
            assert driver.console.status.startswith("x: 2 ")

    asyncio.run(drive())


def test_what_the_referee_has_chosen_is_not_changed_by_the_plan(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver)
            await driver.press("f2", "3", "tab", "escape")
            planned.plan = plan((2, 2, 1), (1, 1, 1))
            await ready(driver)
            await driver.press("x", "y")
            await ready(driver)
            assert planned.run.setup is not None
            assert planned.run.setup.subject == 3

    asyncio.run(drive())


def test_a_plan_that_changes_is_followed_at_once(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver)
            planned.plan = plan((1, 1, 1), (3, 5, 1))
            await ready(driver)
            await driver.press("x", "y")
            await ready(driver)
            assert task(planned) == Task(3, 5)

    asyncio.run(drive())


def test_what_is_set_up_stays_as_it_is_when_the_plan_changes(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter", "f6")
            planned.plan = plan((3, 5, 1))
            await ready(driver)
            acts = len(planned.acts)
            await driver.press("f5")
            assert planned.run.phase is Phase.COUNTDOWN
            assert not any(isinstance(act, SetUp) for act in planned.acts[acts:])

    asyncio.run(drive())


def test_the_pane_shows_teams_and_conditions_and_marks_what_is_next(planned: FakeEngine) -> None:
    planned.history = [
        summary(1, 1, 1, values={"capability_level": 4}),
        summary(2, 7, 1, hour=1, outcome=Outcome.ABORTED, values={}),
        summary(9, 2, 1, hour=2),
    ]

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f3", "p")
            await ready(driver)
            rows = [" ".join(row.split()) for row in driver.rows()]
            assert "subj team >1 2 7 20" in rows
            assert "> 1 Walkers 1/2 [1/2L4]" in rows
            assert "2 門の騎士 1/1 1!1L-" in rows
            assert "3 Delft University Door O… 0/2 0/2" in rows
            assert "9 0/0 +1L6" in rows
            text = " ".join(rows)
            assert "2 of 5 attempts done, 3 left. Next: 1 Walkers, condition 1" in text
            assert "attempt 2 of 2. Then 3 in 20." in text
            assert "1 of 2 attempts done; 1 valid; best level 4; 1 left; NEXT" in text
            await driver.press("right", "down")
            assert "2 門の騎士, condition 2: " in driver.text
            assert "not in the plan" in driver.text

    asyncio.run(drive())


@pytest.mark.parametrize("size", [SMALL, LARGE, (160, 50)])
def test_all_of_a_large_plan_can_be_seen_and_reached(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    engine.plan = plan(*((subject, cond, 2) for subject in range(1, 13) for cond in range(1, 21)))
    engine.teams = TeamList({subject: f"Team number {subject}" for subject in range(1, 13)})

    async def drive() -> None:
        async with driving(engine, size) as driver:
            await ready(driver)
            await driver.press("f3", "p")
            await ready(driver)
            seen = set()
            for _ in range(20):
                title = next(row for row in driver.rows() if row.lstrip().startswith("subj team"))
                seen |= {int(word.strip(">")) for word in title.split()[2:]}
                assert driver.text.count("0/2") >= 12 * 12  # all teams at once, most conditions
                await driver.press("right")
            assert seen == set(range(1, 21))
            if "v: " in driver.text:
                for words in ("v: valid/planned", "v: best level", "v: done/planned"):
                    await driver.press("v")
                    assert words in driver.text
            for _ in range(12):
                await driver.press("down")
            assert "12 Team number 12, condition 20" in " ".join(driver.text.split())
            await driver.press("enter")
            await ready(driver)
            await driver.press("f2", "enter")
            await ready(driver)
            assert task(engine) == Task(12, 20)

    asyncio.run(drive())


def test_enter_on_a_cell_proposes_it_and_x_sets_it_up(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f2", "enter")
            await end(driver)
            await driver.press("f", "a", "enter", "p", "up", "left", "enter")
            await ready(driver)
            assert planned.run.phase is Phase.FINAL  # nothing is set up yet
            assert "Draft of run 2 of subject 1, attempt 2 of 2" in " ".join(driver.text.split())
            await driver.press("escape", "x")
            await ready(driver)
            assert task(planned) == Task(1, 1)
            await driver.press("f3", "p", "end", "down", "down", "x")
            await ready(driver)
            assert task(planned) == Task(3, 20)

    asyncio.run(drive())


def test_a_click_marks_a_cell_and_a_second_one_proposes_it(planned: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f3", "p")
            await ready(driver)
            y, row = next(
                (y, row) for y, row in enumerate(driver.rows()) if "3 Delft University" in row
            )
            for times in (1, 2):
                await driver.pilot.click(offset=(row.rindex("0/2") + 1, y))
                await ready(driver)
                assert driver.console.pane == ("plan" if times == 1 else "setup")
                assert "3 Delft University Door Openers, condition 20" in driver.text or times == 2
            await driver.press("enter")
            await ready(driver)
            assert task(planned) == Task(3, 20)

    asyncio.run(drive())


def test_lines_that_cannot_be_used_are_said(planned: FakeEngine) -> None:
    planned.plan = Plan(planned.plan.lines, ("plan.csv line 9: condition '21' is no number",))

    async def drive() -> None:
        async with driving(planned) as driver:
            await ready(driver)
            await driver.press("f3", "p")
            await ready(driver)
            assert "plan.csv line 9: condition '21' is no number" in driver.text

    asyncio.run(drive())


def test_without_a_plan_the_pane_says_how_to_make_one(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f3", "p")
            await ready(driver)
            assert "no plan: name a file with lines `subject,condition,attempts`" in driver.text
            await driver.press("enter", "v", "x")
            assert driver.app.is_running

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("attempts", "texts"),
    [
        (Attempts(Task(1, 1), 2), ("0/2  ", "0/2", "0/2", ".")),
        (Attempts(Task(1, 1), 2, 1, 1, 6), ("1/2L6", "1/2", "1/2", "L6")),
        (Attempts(Task(1, 1), 2, 2, 1, 0), ("2!2L0", "2!2", "1!2", "L0")),
        (Attempts(Task(1, 1), 0, 1, 0), ("+1L-", "+1", "+0", "L-")),
        (None, ("", "", "", "")),
    ],
)
def test_a_cell_says_in_signs_what_the_line_below_says_in_words(
    attempts: Attempts | None, texts: tuple[str, ...]
) -> None:
    assert tuple(cell(attempts, view, is_next=False).text for view in (None, *CellView)) == texts


def test_the_line_below_says_all_of_a_cell() -> None:
    teams = {3: "Delft"}
    assert about(Attempts(Task(3, 7), 3, 2, 1, 5), teams) == (
        "3 Delft, condition 7: push, from CCW to CW, Constant Force; 2 of 3 attempts done; 1 valid;"
        " best level 5; 1 left"
    )
    assert "OUT OF PLAN, 1 done" in about(Attempts(Task(3, 7), 0, 1, 1, 5), teams)
    assert about(Attempts(Task(4, 7)), teams).endswith("not in the plan")
