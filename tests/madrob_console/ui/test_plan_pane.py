"""A competition's plan on the screens: what is next is proposed, and all of it can be seen."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import SetUp, Start
from madrob_console.referee.competition_plan import NO_PLAN, Attempts, Plan, PlanLine, Task
from madrob_console.referee.run import Phase
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.ui.cells.field import Field
from madrob_console.ui.link import ConsoleDefaults
from madrob_console.ui.panes.plan_pane import cell
from madrob_console.ui.panes.team_picker import matching
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    SMALL,
    Driver,
    Stories,
    Story,
    acting,
    answered,
    engine_does,
    focused,
    follow,
    has,
    in_sizes,
    no,
    no_question,
    on_engine,
    opened,
    pane,
    passes,
    play,
    row,
    says,
    says_only,
    set_up_with,
    sets,
    setup_of,
)
from tests.madrob_console.ui.inline_engine import EPOCH, HandEngine

TEAMS = TeamList({1: "Walkers", 2: "門の騎士", 3: "Delft University Door Openers"})


def plan(*lines: tuple[int, int, int]) -> Plan:
    return Plan(tuple(PlanLine(Task(subject, cond), count) for subject, cond, count in lines))


def planned(**values: Any) -> HandEngine:  # noqa: ANN401
    """A plan in two rounds, on a real testbed."""
    lines = plan((1, 1, 1), (2, 7, 1), (1, 1, 1), (3, 20, 2))
    return HandEngine(**{"kind": SourceKind.ROS, "plan": lines, "teams": TEAMS, **values})


def task(driver: Driver) -> Task:
    setup = setup_of(driver)
    return Task(setup.subject, setup.condition.number)


def is_set_up(subject: int, condition: int) -> Callable[[Driver], object]:
    return lambda driver: task(driver) == Task(subject, condition)


async def click(driver: Driver, team: str, cell: str, times: int = 1) -> None:
    y, row = next((y, row) for y, row in enumerate(driver.rows()) if team in row)
    await driver.click_at(row.rindex(cell) + 1, y, times)
    await driver.answered()


FIRST: Story = [(answered(),), ("f2 enter",)]
"""The first run of the plan is set up."""


async def end(driver: Driver, outcome: Outcome = Outcome.COMPLETED, source: str = "ros") -> None:
    """The run that is set up goes on and ends; its result is in the results folder."""
    engine = driver.engine
    await driver.press("f6", "f5")
    await driver.let_pass(6.0)
    number, hour = setup_of(driver).run_number, float(len(engine.history))
    run = summary(*task(driver), number, hour=hour, outcome=outcome, source=source)
    engine.history.append(run)
    engine.finish(outcome)
    await driver.answered()


async def types(driver: Driver, field: str, text: str) -> None:
    """Into a field of the set-up, which is set up then."""
    await driver.press("f2")
    driver.console.panes.setup.add_class("-unfolded")
    driver.console.query_one(f"#{field}", Field).focus()
    await driver.answered(*text, "enter")


AT = time.strftime("%H:%M", time.gmtime(EPOCH - 12 * 60))
WALKERS = "1 Walkers, condition 1 (pull, from CCW to CW, No Force)"


BIG = plan(*((subject, cond, 2) for subject in range(1, 13) for cond in range(1, 21)))


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_all_of_a_large_plan_can_be_seen_and_reached(driver: Driver) -> None:
    teams = TeamList({subject: f"Team number {subject}" for subject in range(1, 13)})
    await follow(driver, [(has(plan=BIG, teams=teams),), (answered("f3 p"),)])
    seen = set()
    for _ in range(11):
        title = next(row for row in driver.rows() if row.lstrip().startswith("subj▲ team"))
        seen |= {int(word) for word in title.split()[3:]}
        assert driver.text.count("0/2") >= 12 * 10  # all teams at once, half the conditions
        await driver.press("right", "right")
    assert seen == set(range(1, 21))
    rows: Story = [
        ("down*12", "12 Team number 12, condition 20"),
        (answered("enter"),),
        (answered("f2 enter"), is_set_up(12, 20)),
    ]
    await follow(driver, rows)


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


LONG = "The Very Long Name of a Team that Goes On to Sixty Letters!!"
NAMES = {
    1: "Delft Walkers",
    2: "門の騎士とロボットの会",
    3: "Équipe Müller",
    13: "Team 3",
    31: LONG,
}
MANY = {number: f"Team {number}" for number in range(1, 201)}


def listed(**values: Any) -> HandEngine:  # noqa: ANN401
    return HandEngine(**{"teams": TeamList(NAMES), **values})


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


SEEN = "teams file t.csv: it names no team"
BAD_LINE = "plan.csv line 9: condition '21' is no number"
CUT = "teams.csv line 5: more than 60 characters, cut: the team is 'Delft...'"

PLANNED: Stories = {
    "the pane says what goes on what is next and how late it is": [
        (on_engine(plan=Plan((PlanLine(Task(1, 1), 2, AT), PlanLine(Task(2, 7), 1, AT)))),),
        (answered(),),
        (answered("f3 p"), f"attempt 1 of 2, planned for {AT}, 12 min LATE. Then 2 in 7."),
        (passes(120.0), f"planned for {AT}, 14 min LATE"),
        ("f2 enter f6 f5",),
        (passes(6.0),),
        (
            answered("f3 p"),
            f"Now: {WALKERS}, attempt 1 of 2, planned for {AT}.",
            f"planned for {AT}. Next: {WALKERS}, attempt 2 of 2. Then",
        ),
    ],
    "after each result x goes to the next run of the plan": [
        *FIRST,
        ("", is_set_up(1, 1)),
        *(
            row
            for following in ((2, 7), (1, 1), (3, 20), (3, 20))
            for row in (
                (end,),
                (answered("enter f a enter x"), Phase.READY, is_set_up(*following)),
            )
        ),
    ],
    **{
        f"what has used up no attempt is set up again: {outcome}, {source}": [
            *FIRST,
            (acting(end, outcome, source),),
            (answered("x"), Phase.READY, is_set_up(*following)),
        ]
        for outcome, source, following in [
            (Outcome.ABORTED, "ros", (2, 7)),
            (Outcome.INTERRUPTED, "ros", (1, 1)),
            (Outcome.COMPLETED, "simulated", (1, 1)),
        ]
    },
    "until the plan knows of a run nothing is said of what x sets up": [
        (answered(),),
        ("f2 enter f6 f5",),
        (passes(6.0),),
        (engine_does(HandEngine.stop),),  # it is recorded on, and not scored
        (answered(),),
        ("down", Phase.STOPPED, says_only("")),
        (engine_does(HandEngine.score),),
        (lambda d: d.engine.history.append(summary(1, 1, 1, source="ros")),),
        (answered(),),
        ("down", says("x: 2 ")),
    ],
    "what is set up stays as it is when the plan changes": [
        (answered(),),
        ("f2 enter f6",),
        (sets(plan=plan((3, 5, 1))),),
        (answered(),),
        ("f5", Phase.COUNTDOWN, Start()),
        ("", lambda d: [type(act) for act in d.engine.acts].count(SetUp) == 1),
    ],
    "the pane shows teams and conditions and marks what is next": [
        (
            on_engine(
                history=[
                    summary(1, 1, 1, values={"capability_level": 4}),
                    summary(2, 7, 1, hour=1, outcome=Outcome.ABORTED, values={}),
                    summary(9, 2, 1, hour=2),
                ]
            ),
        ),
        (answered(),),
        (
            answered("f3 p"),
            row("subj▲ team done 1 2 7 20"),
            row("1 Walkers 1/2[>1/2]"),
            row("2 門の騎士 1/1 1/1"),
            row("3 Delft University Door Openers 0/2 0/2"),
            row("9 0/0 +1"),
            "2 of 5 attempts done, 3 left. Next: 1 Walkers, condition 1",
            "attempt 2 of 2. Then 3 in 20.",
            "1 of 2 attempts done; 1 valid; best level 4; 1 left; NEXT",
        ),
        ("right down", "2 門の騎士, condition 2: ", "not in the plan"),
    ],
    "a click marks a cell and a double click proposes it": [
        (answered(),),
        (answered("f3 p"),),
        (
            acting(click, "3 Delft University", "0/2"),
            pane("plan"),
            "3 Delft University Door Openers, condition 20",
        ),
        (acting(click, "3 Delft University", "0/2", times=2), pane("setup")),
        (answered("enter"), is_set_up(3, 20)),
    ],
    "lines that cannot be used are said": [
        (on_engine(plan=Plan(plan((1, 1, 1)).lines, (BAD_LINE,))),),
        (answered(),),
        (answered("f3 p"), BAD_LINE),
    ],
    "what is odd in a list is said once and not in the checks": [
        (on_engine(teams=replace(TEAMS, remarks=(CUT,)), plan=plan((1, 1, 1))),),
        (answered(), says(CUT)),
        (answered("f2 enter"), is_set_up(1, 1), no(CUT)),
        (has(plan=plan((2, 7, 1))), says_only("The plan was read again: 1 attempts.")),
    ],
    "a line that cannot be used stops its team until it is waived": [
        (on_engine(plan=replace(plan((1, 1, 1)), unusable={1: BAD_LINE})),),
        (answered(),),
        (answered("f2 enter f6"), f"x correct the plan, Enter waives: {BAD_LINE[:30]}"),
        ("f5", Phase.READY),
        (answered("escape tab enter space"), f"~ plan: waived, no reason given ({BAD_LINE[:20]}"),
        ("f5", Phase.COUNTDOWN),
    ],
    "the first run of the plan is proposed": [
        (on_engine(plan=plan((3, 20, 2))),),
        (answered(),),
        (
            answered("f2 enter"),
            is_set_up(3, 20),
            lambda d: setup_of(d).team == "Delft University Door Openers",
            lambda d: setup_of(d).start_pose.side is setup_of(d).condition.starting_side,
            "Run 1 of subject 3, attempt 1 of 2 is set up.",
        ),
    ],
    "who practises goes on with the same team and condition": [
        (on_engine(simulated="nominal"),),
        *FIRST,
        ("", is_set_up(1, 1)),
        (acting(end, source="simulated"),),
        (answered("p down enter"),),
        (answered("enter"), is_set_up(2, 1)),
        (acting(end, source="simulated"),),
        (
            answered("x"),
            is_set_up(2, 1),
            lambda d: setup_of(d).practice,
            lambda d: not setup_of(d).out_of_plan,
        ),
    ],
    "after practice both ways are named and the plan's next run is official": [
        (on_engine(plan=plan((1, 1, 1), (2, 7, 1))),),
        (answered(),),
        (answered("f2 tab tab right enter"), set_up_with(practice=True)),
        (acting(end, source="simulated"),),
        (answered("f4"), "x: practice again. p, then Enter: the plan's next."),
        (answered("x"), is_set_up(1, 1), set_up_with(practice=True)),
        (acting(end, source="simulated"),),
        (answered("p enter"), pane("setup")),
        (answered("enter"), is_set_up(1, 1), set_up_with(practice=False)),
    ],
    **{
        f"what was changed for one run is not for the next one: {name}": [
            (on_engine(plan=lines),),
            *FIRST,
            (acting(types, "timeout", "25"), set_up_with(timeout=25.0)),
            (acting(types, "pose-x", "1.25"), lambda d: setup_of(d).start_pose.x == 1.25),
            (end,),
            (answered("x"), set_up_with(timeout=300.0), lambda d: setup_of(d).start_pose.x == 1.5),
        ]
        for name, lines in (("without a plan", NO_PLAN), ("with one", plan((1, 1, 1), (2, 2, 1))))
    },
    "the abort question says which attempt it uses up": [
        *FIRST,
        ("f6 f5",),
        (passes(6.0),),
        ("f8", "run 1 of subject 1 Walkers, attempt 1 of 2"),
        ("", "It uses up the attempt, but for 'testbed fault'.", "Wrong team? Let the run end"),
    ],
    "at the end of the plan nothing is proposed": [
        (on_engine(plan=plan((1, 1, 1))),),
        *FIRST,
        (end,),
        (
            answered("x"),
            says("The plan is finished: 1 of 1. s shows the standings."),
            Phase.STOPPED,
        ),
        (answered("f2"), "The plan is finished: 1 of 1."),
        (answered("enter"), "The plan is finished: 1 of 1.", Phase.STOPPED),
    ],
    "one key repeats the team and condition and says that it is out of plan": [
        (on_engine(plan=plan((1, 1, 1), (2, 7, 1))),),
        *FIRST,
        (end,),
        (
            answered("enter X"),
            lambda d: (
                (task(d), setup_of(d).run_number, setup_of(d).out_of_plan) == (Task(1, 1), 2, True)
            ),
            "x F2 corrects the team, Enter waives: this run is out of plan",
            no("OUT OF PLAN"),
        ),
        ("x",),
        (
            answered(),
            lambda d: (task(d), setup_of(d).out_of_plan) == (Task(1, 1), True),
        ),
    ],
    "a run out of plan that the plan takes in needs no waiver": [
        (on_engine(plan=plan((1, 1, 1), (2, 7, 1))),),
        *FIRST,
        (end,),
        (answered("enter X"),),
        ("f6 f5", lambda d: d.engine.run.start is None),
        (sets(plan=plan((1, 1, 2), (2, 7, 1))),),
        (answered(),),
        (
            answered("f6 f5"),
            lambda d: (task(d), setup_of(d).out_of_plan) == (Task(1, 1), False),
            lambda d: d.engine.run.start is not None,
        ),
    ],
    "an aborted attempt is repeated within the plan": [
        *FIRST,
        (acting(end, Outcome.ABORTED),),
        (
            answered("enter X"),
            "Run 2 of subject 1, attempt 2 of 2 is set up.",
            lambda d: (task(d), setup_of(d).out_of_plan) == (Task(1, 1), False),
        ),
    ],
    "a repeated attempt is called that": [
        (on_engine(plan=plan((1, 1, 1), (2, 7, 1))),),
        *FIRST,
        (acting(end, Outcome.ABORTED),),
        (
            answered("enter X"),
            lambda d: not setup_of(d).out_of_plan,
            "an attempt repeated is set up",
        ),
    ],
    "after a result the screen says what x sets up": [
        *FIRST,
        ("", no("x: 2 門の騎士, condition 7, attempt 1 of 1. p shows the plan.")),
        (end,),
        ("down", "x: 2 門の騎士, condition 7, attempt 1 of 1. p shows the plan."),
        (answered("x"),),
        ("f3", no("x: 2 門の騎士, condition 7, attempt 1 of 1. p shows the plan.")),
    ],
    "what the referee has chosen is not changed by the plan": [
        *FIRST,
        (end,),
        ("f2 3 tab escape",),
        (sets(plan=plan((2, 2, 1), (1, 1, 1))),),
        (answered(),),
        (answered("x"), lambda d: setup_of(d).subject == 3),
    ],
    "a plan that changes is followed at once": [
        *FIRST,
        (end,),
        (sets(plan=plan((1, 1, 1), (3, 5, 1))),),
        (answered(),),
        (answered("x"), is_set_up(3, 5)),
    ],
    "enter on a cell proposes it and again sets it up": [
        *FIRST,
        (end,),
        (
            answered("enter f a enter p up left enter"),
            Phase.FINAL,
            "Draft for subject 1, attempt 2 of 2: Enter sets it up.",
        ),
        (answered("enter"), is_set_up(1, 1)),
        (answered("f3 p right right end enter"),),
        (answered("enter"), is_set_up(3, 20)),
    ],
    "a plan that is done marks its first cell": [
        (
            on_engine(
                plan=plan((1, 1, 1), (2, 7, 1)),
                history=[summary(1, 1, 1), summary(2, 7, 1, hour=1)],
            ),
        ),
        (answered(),),
        (answered("f3 p"), "2 of 2 attempts done, 0 left.", "[1/1]", "1 Walkers, condition 1: "),
    ],
    "without a plan the pane says how to make one": [
        (on_engine(plan=NO_PLAN),),
        (answered("f3 p"), "no plan: name a file with lines `subject,condition,attempts`"),
        ("enter v x", lambda d: d.app.is_running),
    ],
    "an attempt beyond the plan is none of those that were planned": [
        (
            on_engine(
                history=[
                    summary(1, 1, run, hour=run, values={"capability_level": run})
                    for run in (1, 2, 3)
                ]
            ),
        ),
        (answered(),),
        (
            answered("f3 p home left left"),
            "[2/2]",
            "2 of 2 attempts done; 1 more than planned; 3 valid; best level 3",
        ),
    ],
}


@pytest.mark.parametrize("story", PLANNED)
async def test_what_is_next_is_proposed_and_seen(story: str) -> None:
    await play(planned, PLANNED[story])


PICKED: Stories = {
    "two hundred teams are shown page by page": [
        (in_sizes((60, 18), (120, 36)),),
        (on_engine(teams=TeamList(MANY)),),
        ("slash", "> 1 Team 1 ", lambda d: len(found(d)) >= 4),
        ("", "of 201, by subject"),  # and one for another name
        ("pagedown", no("> 1 Team 1 ")),
        ("'=team 177'", lambda d: found(d)[0] == "> 177 Team 177"),
        ("enter", lambda d: setup_of(d).subject == 177),
    ],
    "a long name is shown whole before it is taken": [
        (in_sizes((60, 18)),),
        ("slash =2", f"2 {NAMES[2]}"),
        ("backspace =31", f"31 {LONG}"),
    ],
    "a list that changes is taken at once": [
        ("enter f6",),
        (
            has(teams=TeamList({**NAMES, 1: "Delft Walkers II"})),
            says("The list of teams was read again: 5 teams"),
            lambda d: team(d).startswith("Delft Walkers II"),
            "Not set up yet",
        ),
        # its pose was confirmed for the other
        ("f5", lambda d: setup_of(d).team == "Delft Walkers II", Phase.READY),
        (has(teams=TeamList({**NAMES, 1: "Delft Walkers II"}, (SEEN,))), says(SEEN)),
        ("tab", f"! {SEEN}"),
    ],
    "the name of the list stands there as the number is typed": [
        ("", lambda d: team(d) == "Delft Walkers"),
        ("=3", lambda d: team(d) == "Équipe Müller"),
        ("=1", lambda d: team(d).startswith("The Very Long")),
        ("=1", lambda d: team(d) == "(not in the list)"),
        (
            "enter",
            lambda d: (setup_of(d).subject, setup_of(d).team) == (311, ""),
            "x F2 corrects the team, Enter waives: 311 is not in the list",
        ),
    ],
    **{
        f"slash asks for the list from everywhere but a name: {where}": [
            (f"""{" ".join(where)} slash""", "Teams: 5"),
            ("=muller", lambda d: found(d)[0] == "> 3 Équipe Müller"),
            (
                "enter",
                lambda d: (setup_of(d).subject, setup_of(d).team) == (3, "Équipe Müller"),
                lambda d: setup_of(d).team_reason == "",
            ),
            ("f6", lambda d: d.engine.run.pose_confirmed),
        ]
        for where in [(), ("tab", "tab"), ("escape",)]
    },
    "a slash in a name is typed": [
        (
            "tab*6 enter shift+tab slash",
            no("Teams: "),
            lambda d: d.console.query_one("#referee", Field).value == "/",
        ),
    ],
    "arrows go through the list and escape leaves it as it was": [
        ("slash down down", lambda d: found(d)[2] == "> 3 Équipe Müller"),
        ("escape", lambda d: team(d) == "Delft Walkers", lambda d: d.engine.acts == []),
        ("slash down enter", lambda d: setup_of(d).subject == 2),
    ],
    "another name is asked about and its reason stands with the set up": [
        (
            "slash '=Delft Runners'",
            lambda d: found(d) == ["> - another name for subject 1: Delft Runners"],
        ),
        ("enter", "ANOTHER NAME for subject 1: it is Delft Walkers in the list"),
        (
            "enter 2",
            lambda d: setup_of(d).team == "Delft Runners",
            lambda d: setup_of(d).team_reason == "renamed since",
            lambda d: team(d) == "Delft Runners",
            "Other name than the list's: renamed since.",
        ),
        ("f6", lambda d: d.engine.run.pose_confirmed),
    ],
    **{
        f"without a reason the name stays that of the list: {keys}": [
            (
                f"""enter slash =Runners enter {" ".join(keys)}""",
                no_question,
                lambda d: team(d) == "Delft Walkers",
                lambda d: setup_of(d).team == "Delft Walkers",
            ),
        ]
        for keys in [("escape",), ("enter", "enter")]
    },
    "the lists own team takes another name back": [
        ("slash =Runners enter enter 1", lambda d: setup_of(d).team == "Runners"),
        (
            "slash 1 enter",
            lambda d: team(d) == "Delft Walkers",
            lambda d: setup_of(d).team == "Delft Walkers",
            lambda d: setup_of(d).team_reason == "",
        ),
    ],
    "another name is of its subject alone": [
        ("slash =Runners enter enter 1 f2 =2 enter", lambda d: setup_of(d).team == NAMES[2]),
        ("f2 =1 enter", lambda d: setup_of(d).team == NAMES[1]),
    ],
    "another name stays for the next run of the team": [
        ("slash =Runners enter enter 1 f6 f5",),
        (passes(6.0),),
        (Driver.finish,),
        (
            "enter f a enter x",
            lambda d: setup_of(d).run_number == 2,
            lambda d: setup_of(d).team == "Runners",
            lambda d: setup_of(d).team_reason == "the list is wrong",
        ),
    ],
    "without a list the name is typed and slash says how to get one": [
        (on_engine(teams=NO_TEAMS),),
        ("slash", "There is no list of teams, names are free."),
        (
            "enter escape f2 tab '=Any Name' enter",
            lambda d: setup_of(d).team == "Any Name",
        ),
    ],
    "a list that comes while a name is typed sends no letter into another field": [
        (on_engine(teams=NO_TEAMS),),
        ("tab =Del",),
        (has(teams=TeamList(NAMES)),),
        (
            "=ft",
            lambda d: d.console.query_one("#referee", Field).value == DEFAULTS.referee,
            lambda d: team(d) == "Delft Walkers",
        ),
    ],
    "another pane closes the list": [
        (opened(defaults=ConsoleDefaults()),),
        (
            "slash f3 f2",
            no("Teams: "),
            focused("subject"),
        ),
    ],
}


@pytest.mark.parametrize("story", PICKED)
async def test_a_team_is_looked_for_and_taken(story: str) -> None:
    await play(listed, PICKED[story])
