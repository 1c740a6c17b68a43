"""A competition's plan on the screens: what is next is proposed, and all of it can be seen."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import SetUp
from madrob_console.referee.competition_plan import Attempts, Plan, PlanLine, Task
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.dialog import Field
from madrob_console.ui.link import ConsoleDefaults
from madrob_console.ui.panes.plan_pane import about, cell
from madrob_console.ui.panes.team_picker import matching
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import DEFAULTS, LARGE, SMALL, Driver, driving
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


def setup_of(engine: FakeEngine) -> RunSetup:
    assert engine.run.setup is not None
    return engine.run.setup


def task(engine: FakeEngine) -> Task:
    setup = setup_of(engine)
    return Task(setup.subject, setup.condition.number)


async def first(driver: Driver) -> None:
    """The first run of the plan is set up."""
    await driver.answered()
    await driver.press("f2", "enter")


async def end(driver: Driver, outcome: Outcome = Outcome.COMPLETED, source: str = "ros") -> None:
    """The run that is set up goes on and ends; its result is in the results folder."""
    engine = driver.engine
    await driver.press("f6", "f5")
    await driver.let_pass(6.0)
    number, hour = setup_of(engine).run_number, float(len(engine.history))
    run = summary(*task(engine), number, hour=hour, outcome=outcome, source=source)
    engine.history.append(run)
    engine.finish(outcome)
    await driver.answered()


async def test_the_first_run_of_the_plan_is_proposed(planned: FakeEngine) -> None:
    planned.plan = plan((3, 20, 2))

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f2", "enter")
        assert task(planned) == Task(3, 20)
        assert setup_of(planned).team == "Delft University Door Openers"
        assert setup_of(planned).start_pose.side is setup_of(planned).condition.starting_side
        assert "Run 1 of subject 3, attempt 1 of 2 is set up." in " ".join(driver.text.split())


async def test_after_each_result_x_goes_to_the_next_run_of_the_plan(
    planned: FakeEngine, driver: Driver
) -> None:
    await first(driver)
    ran: list[Task] = []
    while planned.snapshot().plan.lines and len(ran) < 5:
        ran.append(task(planned))
        await end(driver)
        await driver.answered("enter", "f", "a", "enter", "x")
        assert planned.run.phase is Phase.READY
    assert ran == [Task(1, 1), Task(2, 7), Task(1, 1), Task(3, 20), Task(3, 20)]


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
async def test_what_has_used_up_no_attempt_is_set_up_again(
    planned: FakeEngine, driver: Driver, outcome: Outcome, source: str, following: Task
) -> None:
    await first(driver)
    await end(driver, outcome, source)
    await driver.answered("x")
    assert planned.run.phase is Phase.READY
    assert task(planned) == following


async def test_who_practises_goes_on_with_the_same_team_and_condition(planned: FakeEngine) -> None:
    planned.simulated = "nominal"

    async with driving(planned) as driver:
        await first(driver)
        assert task(planned) == Task(1, 1)
        await end(driver, source="simulated")
        await driver.answered("p", "down", "enter")
        await driver.answered("enter")
        assert task(planned) == Task(2, 1)
        await end(driver, source="simulated")
        await driver.answered("x")
        assert task(planned) == Task(2, 1)
        assert setup_of(planned).practice
        assert not setup_of(planned).out_of_plan  # practice never is


async def test_one_key_repeats_the_team_and_condition_and_says_that_it_is_out_of_plan(
    planned: FakeEngine,
) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async with driving(planned) as driver:
        await first(driver)
        await end(driver)
        await driver.answered("enter", "X")
        setup = setup_of(planned)
        assert (task(planned), setup.run_number, setup.out_of_plan) == (Task(1, 1), 2, True)
        text = " ".join(driver.text.split())
        assert "x F2 corrects the team: this run is out of plan (Enter waives)" in text
        assert "OUT OF PLAN" not in text  # said once
        await driver.press("x")  # it was the wrong key
        await driver.answered()
        assert (task(planned), setup_of(planned).out_of_plan) == (Task(1, 1), True)


async def test_a_run_out_of_plan_that_the_plan_takes_in_needs_no_waiver(
    planned: FakeEngine,
) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async with driving(planned) as driver:
        await first(driver)
        await end(driver)
        await driver.answered("enter", "X")
        await driver.press("f6", "f5")
        assert planned.run.start is None  # out of plan
        planned.plan = plan((1, 1, 2), (2, 7, 1))
        await driver.answered()
        await driver.answered("f6", "f5")
        assert (task(planned), setup_of(planned).out_of_plan) == (Task(1, 1), False)
        assert planned.run.start is not None


async def test_an_aborted_attempt_is_repeated_within_the_plan(
    planned: FakeEngine, driver: Driver
) -> None:
    await first(driver)
    await end(driver, Outcome.ABORTED)
    await driver.answered("enter", "X")
    assert "Run 2 of subject 1, attempt 2 of 2 is set up." in " ".join(driver.text.split())
    assert (task(planned), setup_of(planned).out_of_plan) == (Task(1, 1), False)


async def test_a_repeated_attempt_is_called_that(planned: FakeEngine) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))

    async with driving(planned) as driver:
        await first(driver)
        await end(driver, Outcome.ABORTED)
        await driver.answered("enter", "X")
        assert not setup_of(planned).out_of_plan
        assert "an attempt repeated is set up" in " ".join(driver.text.split())


async def test_after_a_result_the_screen_says_what_x_sets_up(planned: FakeEngine) -> None:
    hint = "x: 2 門の騎士, condition 7, attempt 1 of 1. p shows the plan."

    async with driving(planned) as driver:
        await first(driver)
        assert hint not in driver.text
        await end(driver)
        await driver.press("down")  # the message of the result goes with the next key
        assert hint in driver.text
        await driver.answered("x")
        await driver.press("f3")
        assert hint not in driver.text


async def test_until_the_plan_knows_of_a_run_nothing_is_said_of_what_x_sets_up(
    planned: FakeEngine, driver: Driver
) -> None:
    await driver.answered()
    await driver.press("f2", "enter", "f6", "f5")
    await driver.let_pass(6.0)
    planned.finish()
    result, planned.result = planned.result, None  # it is recorded on, and not scored
    await driver.answered()
    await driver.press("down")
    assert planned.run.phase is Phase.STOPPED
    assert driver.console.status == ""
    planned.result = result
    planned.history.append(summary(1, 1, 1, source="ros"))
    await driver.answered()
    await driver.press("down")
    assert driver.console.status.startswith("x: 2 ")


async def test_what_the_referee_has_chosen_is_not_changed_by_the_plan(
    planned: FakeEngine, driver: Driver
) -> None:
    await first(driver)
    await end(driver)
    await driver.press("f2", "3", "tab", "escape")
    planned.plan = plan((2, 2, 1), (1, 1, 1))
    await driver.answered()
    await driver.answered("x")
    assert setup_of(planned).subject == 3


async def test_a_plan_that_changes_is_followed_at_once(planned: FakeEngine, driver: Driver) -> None:
    await first(driver)
    await end(driver)
    planned.plan = plan((1, 1, 1), (3, 5, 1))
    await driver.answered()
    await driver.answered("x")
    assert task(planned) == Task(3, 5)


async def test_what_is_set_up_stays_as_it_is_when_the_plan_changes(
    planned: FakeEngine, driver: Driver
) -> None:
    await driver.answered()
    await driver.press("f2", "enter", "f6")
    planned.plan = plan((3, 5, 1))
    await driver.answered()
    acts = len(planned.acts)
    await driver.press("f5")
    assert planned.run.phase is Phase.COUNTDOWN
    assert not any(isinstance(act, SetUp) for act in planned.acts[acts:])


async def test_the_pane_shows_teams_and_conditions_and_marks_what_is_next(
    planned: FakeEngine,
) -> None:
    planned.history = [
        summary(1, 1, 1, values={"capability_level": 4}),
        summary(2, 7, 1, hour=1, outcome=Outcome.ABORTED, values={}),
        summary(9, 2, 1, hour=2),
    ]

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f3", "p")
        rows = [" ".join(row.split()) for row in driver.rows()]
        assert "subj▲ team done 1 2 7 20" in rows
        assert "1 Walkers 1/2[>1/2]" in rows
        assert "2 門の騎士 1/1 1/1" in rows
        assert "3 Delft University Door Openers 0/2 0/2" in rows
        assert "9 0/0 +1" in rows
        text = " ".join(rows)
        assert "2 of 5 attempts done, 3 left. Next: 1 Walkers, condition 1" in text
        assert "attempt 2 of 2. Then 3 in 20." in text
        assert "1 of 2 attempts done; 1 valid; best level 4; 1 left; NEXT" in text
        await driver.press("right", "down")
        assert "2 門の騎士, condition 2: " in driver.text
        assert "not in the plan" in driver.text


async def test_the_pane_says_what_goes_on_what_is_next_and_how_late_it_is(
    planned: FakeEngine,
) -> None:
    at = time.strftime("%H:%M", time.localtime(planned.now - 12 * 60))
    planned.plan = Plan((PlanLine(Task(1, 1), 2, at), PlanLine(Task(2, 7), 1, at)))

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f3", "p")
        said = " ".join(driver.text.split())
        assert f"attempt 1 of 2, planned for {at}, 12 min LATE. Then 2 in 7." in said
        await driver.let_pass(120.0)
        assert f"planned for {at}, 14 min LATE" in " ".join(driver.text.split())
        await driver.press("f2", "enter", "f6", "f5")
        await driver.let_pass(6.0)
        await driver.answered("f3", "p")
        said = " ".join(driver.text.split())
        walkers = "1 Walkers, condition 1 (pull, from CCW to CW, No Force)"
        now = f"Now: {walkers}, attempt 1 of 2, planned for {at}."
        assert f"{now} Next: {walkers}, attempt 2 of 2. Then" in said


@pytest.mark.parametrize("size", [SMALL, LARGE, (160, 50)])
async def test_all_of_a_large_plan_can_be_seen_and_reached(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    engine.plan = plan(*((subject, cond, 2) for subject in range(1, 13) for cond in range(1, 21)))
    engine.teams = TeamList({subject: f"Team number {subject}" for subject in range(1, 13)})

    async with driving(engine, size) as driver:
        await driver.answered()
        await driver.answered("f3", "p")
        seen = set()
        for _ in range(20):
            title = next(row for row in driver.rows() if row.lstrip().startswith("subj▲ team"))
            seen |= {int(word) for word in title.split()[3:]}
            assert driver.text.count("0/2") >= 12 * 10  # all teams at once, half the conditions
            await driver.press("right")
        assert seen == set(range(1, 21))
        for _ in range(12):
            await driver.press("down")
        assert "12 Team number 12, condition 20" in " ".join(driver.text.split())
        await driver.answered("enter")
        await driver.answered("f2", "enter")
        assert task(engine) == Task(12, 20)


async def test_enter_on_a_cell_proposes_it_and_again_sets_it_up(
    planned: FakeEngine, driver: Driver
) -> None:
    await first(driver)
    await end(driver)
    await driver.answered("enter", "f", "a", "enter", "p", "up", "left", "enter")
    assert planned.run.phase is Phase.FINAL  # nothing is set up yet
    assert "Draft for subject 1, attempt 2 of 2: Enter sets it up." in " ".join(driver.text.split())
    await driver.answered("enter")
    assert task(planned) == Task(1, 1)
    await driver.answered("f3", "p", "right", "right", "end", "enter")
    await driver.answered("enter")
    assert task(planned) == Task(3, 20)


async def test_a_click_marks_a_cell_and_a_double_click_proposes_it(
    planned: FakeEngine, driver: Driver
) -> None:
    await driver.answered()
    await driver.answered("f3", "p")
    y, row = next((y, row) for y, row in enumerate(driver.rows()) if "3 Delft University" in row)
    await driver.pilot.click(offset=(row.rindex("0/2") + 1, y))
    await driver.answered()
    assert driver.console.pane == "plan"
    assert "3 Delft University Door Openers, condition 20" in driver.text
    await driver.pilot.click(offset=(row.rindex("0/2") + 1, y), times=2)
    await driver.answered()
    assert driver.console.pane == "setup"
    await driver.answered("enter")
    assert task(planned) == Task(3, 20)


async def test_a_plan_that_is_done_marks_its_first_cell(planned: FakeEngine) -> None:
    planned.plan = plan((1, 1, 1), (2, 7, 1))
    planned.history = [summary(1, 1, 1), summary(2, 7, 1, hour=1)]

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f3", "p")
        assert "2 of 2 attempts done, 0 left." in driver.text
        assert "[1/1]" in driver.text
        assert "1 Walkers, condition 1: " in driver.text


async def test_lines_that_cannot_be_used_are_said(planned: FakeEngine) -> None:
    planned.plan = Plan(planned.plan.lines, ("plan.csv line 9: condition '21' is no number",))

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f3", "p")
        assert "plan.csv line 9: condition '21' is no number" in driver.text


async def test_without_a_plan_the_pane_says_how_to_make_one(driver: Driver) -> None:
    await driver.answered("f3", "p")
    assert "no plan: name a file with lines `subject,condition,attempts`" in driver.text
    await driver.press("enter", "v", "x")
    assert driver.app.is_running


@pytest.mark.parametrize(
    ("attempts", "text"),
    [
        (Attempts(Task(1, 1), 2), "0/2"),
        (Attempts(Task(1, 1), 2, 1, 1, 6), "1/2"),
        (Attempts(Task(1, 1), 2, 2, 1, 0, 1), "2/2P"),
        (Attempts(Task(1, 1), 0, 1, 0), "+1"),
    ],
)
def test_a_cell_says_one_thing(attempts: Attempts, text: str) -> None:
    assert cell(attempts, is_next=False).text == text
    assert cell(attempts, is_next=True).text == f">{text}"


async def test_an_attempt_beyond_the_plan_is_none_of_those_that_were_planned(
    planned: FakeEngine,
) -> None:
    planned.history = [
        summary(1, 1, run, hour=run, values={"capability_level": run}) for run in (1, 2, 3)
    ]

    async with driving(planned) as driver:
        await driver.answered()
        await driver.answered("f3", "p", "home", "left", "left")
        assert "[2/2]" in driver.text
        text = " ".join(driver.text.split())
        assert "2 of 2 attempts done; 1 more than planned; 3 valid; best level 3" in text


def test_the_line_below_says_all_of_a_cell() -> None:
    teams = {3: "Delft"}
    assert about(Attempts(Task(3, 7), 3, 2, 1, 5), teams) == (
        "3 Delft, condition 7: push, from CCW to CW, Constant Force; 2 of 3 attempts done; 1 valid;"
        " best level 5; 1 left"
    )
    assert "OUT OF PLAN, 1 done" in about(Attempts(Task(3, 7), 0, 1, 1, 5), teams)
    assert about(Attempts(Task(4, 7)), teams).endswith("not in the plan")


LONG = "The Very Long Name of a Team that Goes On to Sixty Letters!!"
NAMES = {
    1: "Delft Walkers",
    2: "門の騎士とロボットの会",
    3: "Équipe Müller",
    13: "Team 3",
    31: LONG,
}
MANY = {number: f"Team {number}" for number in range(1, 201)}


@pytest.fixture
def engine() -> FakeEngine:
    return FakeEngine(teams=TeamList(NAMES))


def team(driver: Driver) -> str:
    """What stands in the row of the team."""
    (row,) = [row for row in driver.rows() if row.startswith(" Team (/ list)")]
    return row[15:34].strip()


def found(driver: Driver) -> Sequence[str]:
    """The rows of the picker."""
    rows = [row.strip() for row in driver.rows()]
    begin = next(number for number, row in enumerate(rows) if row.startswith("sub"))
    end = next(n for n, row in enumerate(rows) if " of " in row and n > begin and "by sub" in row)
    return [" ".join(row.split()) for row in rows[begin + 1 : end] if row]


@pytest.mark.parametrize(
    ("text", "subjects"),
    [
        ("", [1, 2, 3, 13, 31]),
        ("3", [3, 31]),
        ("003", [3, 31]),
        ("13", [13]),
        ("99", []),
        ("MULLER", [3]),
        ("equipe mü", [3]),
        ("walk delft", [1]),
        ("騎士", [2]),
        ("team", [13, 31]),
        ("nobody", []),
    ],
)
def test_a_search_finds_numbers_by_their_beginning_and_names_by_their_parts(
    text: str, subjects: list[int]
) -> None:
    assert [team.subject for team in matching(NAMES, text)] == subjects


def test_a_number_that_no_team_has_is_looked_for_in_the_names() -> None:
    assert [team.subject for team in matching({1: "Robots 2026"}, "2026")] == [1]


async def test_the_name_of_the_list_stands_there_as_the_number_is_typed(
    driver: Driver, engine: FakeEngine
) -> None:
    assert team(driver) == "Delft Walkers"
    await driver.type("3")
    assert team(driver) == "Équipe Müller"
    await driver.type("1")
    assert team(driver).startswith("The Very Long")
    await driver.type("1")
    assert team(driver) == "(not in the list)"
    await driver.press("enter")
    assert (setup_of(engine).subject, setup_of(engine).team) == (311, "")
    assert "x F2 corrects the team: 311 is not in the list (Enter waives)" in driver.text


@pytest.mark.parametrize("where", [(), ("tab",), ("tab", "tab"), ("escape",)])
async def test_slash_asks_for_the_list_from_everywhere_but_a_name(
    driver: Driver, engine: FakeEngine, where: tuple[str, ...]
) -> None:
    await driver.press(*where, "slash")
    assert "Teams: 5" in driver.text
    await driver.type("muller")
    assert found(driver)[0] == "> 3 Équipe Müller"
    await driver.press("enter")
    assert (setup_of(engine).subject, setup_of(engine).team) == (3, "Équipe Müller")
    assert setup_of(engine).team_reason == ""
    await driver.press("f6")
    assert engine.run.pose_confirmed


async def test_a_slash_in_a_name_is_typed(driver: Driver) -> None:
    await driver.press(*["tab"] * 6, "enter", "shift+tab", "slash")
    assert "Teams: " not in driver.text
    assert driver.console.query_one("#referee", Field).value == "/"


async def test_arrows_go_through_the_list_and_escape_leaves_it_as_it_was(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("slash", "down", "down")
    assert found(driver)[2] == "> 3 Équipe Müller"
    await driver.press("escape")
    assert team(driver) == "Delft Walkers"
    assert engine.acts == []
    await driver.press("slash", "down", "enter")
    assert setup_of(engine).subject == 2


@pytest.mark.parametrize("size", [(80, 24), (60, 18), (120, 36)])
async def test_two_hundred_teams_are_shown_page_by_page(size: tuple[int, int]) -> None:
    engine = FakeEngine(teams=TeamList(MANY))

    async with driving(engine, size=size) as driver:
        await driver.press("slash")
        rows = found(driver)
        assert len(rows) >= 4
        assert "of 201, by subject" in driver.text  # and one for another name
        await driver.press("pagedown")
        assert found(driver)[0] != rows[0]
        await driver.type("team 177")
        assert found(driver)[0] == "> 177 Team 177"
        await driver.press("enter")
        assert setup_of(engine).subject == 177


@pytest.mark.parametrize("size", [(80, 24), (60, 18)])
@pytest.mark.parametrize("number", [2, 31])
async def test_a_long_name_is_shown_whole_before_it_is_taken(
    size: tuple[int, int], number: int
) -> None:
    engine = FakeEngine(teams=TeamList(NAMES))

    async with driving(engine, size=size) as driver:
        await driver.press("slash")
        await driver.type(str(number))
        assert f"{number} {NAMES[number]}" in " ".join(driver.text.split())


async def test_another_name_is_asked_about_and_its_reason_stands_with_the_set_up(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("slash")
    await driver.type("Delft Runners")
    assert found(driver) == ["> - another name for subject 1: Delft Runners"]
    await driver.press("enter")
    assert "ANOTHER NAME for subject 1: it is Delft Walkers in the list" in driver.text
    await driver.press("enter", "2")
    assert setup_of(engine).team == "Delft Runners"
    assert setup_of(engine).team_reason == "renamed since"
    assert team(driver) == "Delft Runners"
    assert "Other name than the list's: renamed since." in " ".join(driver.text.split())
    await driver.press("f6")
    assert engine.run.pose_confirmed


@pytest.mark.parametrize("keys", [("escape",), ("enter", "enter"), ("enter", "escape")])
async def test_without_a_reason_the_name_stays_that_of_the_list(
    driver: Driver, engine: FakeEngine, keys: tuple[str, ...]
) -> None:
    await driver.press("enter", "slash")
    await driver.type("Runners")
    await driver.press("enter", *keys)
    assert not driver.console.dialogs
    assert team(driver) == "Delft Walkers"
    assert setup_of(engine).team == "Delft Walkers"


async def test_the_lists_own_team_takes_another_name_back(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("slash")
    await driver.type("Runners")
    await driver.press("enter", "enter", "1")
    assert setup_of(engine).team == "Runners"
    await driver.press("slash", "1", "enter")
    assert team(driver) == "Delft Walkers"
    assert setup_of(engine).team == "Delft Walkers"
    assert setup_of(engine).team_reason == ""


async def test_another_name_is_of_its_subject_alone(driver: Driver, engine: FakeEngine) -> None:
    await driver.press("slash")
    await driver.type("Runners")
    await driver.press("enter", "enter", "1", "f2")
    await driver.type("2")
    await driver.press("enter")
    assert setup_of(engine).team == NAMES[2]
    await driver.press("f2")
    await driver.type("1")
    await driver.press("enter")
    assert setup_of(engine).team == NAMES[1]


async def test_another_name_stays_for_the_next_run_of_the_team(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("slash")
    await driver.type("Runners")
    await driver.press("enter", "enter", "1", "f6", "f5")
    await driver.let_pass(6.0)
    await driver.finish()
    await driver.press("enter", "f", "a", "enter", "x")
    assert setup_of(engine).run_number == 2
    assert setup_of(engine).team == "Runners"
    assert setup_of(engine).team_reason == "the list is wrong"


async def test_a_list_that_changes_is_taken_at_once(driver: Driver, engine: FakeEngine) -> None:
    await driver.press("enter", "f6")
    engine.teams = TeamList({**NAMES, 1: "Delft Walkers II"})
    await driver.settle()
    assert "The list of teams was read again: 5 teams" in driver.console.status
    assert team(driver).startswith("Delft Walkers II")
    assert "Not set up yet" in driver.text
    await driver.press("f5")
    assert setup_of(engine).team == "Delft Walkers II"
    assert engine.run.phase is Phase.READY  # its pose was confirmed for the other
    engine.teams = replace(engine.teams, problems=("teams file t.csv: it names no team",))
    await driver.settle()
    assert "teams file t.csv: it names no team" in driver.console.status
    await driver.press("tab")
    assert "! teams file t.csv: it names no team" in driver.text


async def test_without_a_list_the_name_is_typed_and_slash_says_how_to_get_one() -> None:
    engine = FakeEngine()

    async with driving(engine) as driver:
        await driver.press("slash")
        assert "There is no list of teams, names are free." in " ".join(driver.text.split())
        await driver.press("enter", "escape", "f2", "tab")
        await driver.type("Any Name")
        await driver.press("enter")
        assert setup_of(engine).team == "Any Name"


async def test_a_list_that_comes_while_a_name_is_typed_sends_no_letter_into_another_field() -> None:
    engine = FakeEngine(teams=NO_TEAMS)

    async with driving(engine) as driver:
        await driver.press("tab")
        await driver.type("Del")
        engine.teams = TeamList(NAMES)
        await driver.settle()
        await driver.type("ft")
        assert driver.console.query_one("#referee", Field).value == DEFAULTS.referee
        assert team(driver) == "Delft Walkers"


async def test_another_pane_closes_the_list(engine: FakeEngine) -> None:
    async with driving(engine, defaults=ConsoleDefaults()) as driver:
        await driver.press("slash", "f3", "f2")
        assert "Teams: " not in driver.text
        assert driver.app.focused is not None
        assert driver.app.focused.id == "subject"
