from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from textual import events

from madrob_console.common.names import SourceKind
from madrob_console.engine.requests import NextRunNumber
from madrob_console.referee.acts import SetUp
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.team_list import TeamList
from madrob_console.ui.cells.field import Field
from madrob_console.ui.link import ConsoleDefaults
from scoring.indicator_table import RulesetName
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, Signal, StartPose
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    Driver,
    Stories,
    acting,
    ages,
    did_nothing,
    engine_does,
    focused,
    follow,
    has,
    in_sizes,
    no,
    no_question,
    on_engine,
    opened,
    passes,
    play,
    remember,
    says,
    says_only,
    set_up_with,
    sets,
    setup_of,
    slows,
    waits,
)
from tests.madrob_console.ui.inline_engine import HandEngine
from tests.madrob_console.ui.prepared import a_setup

BAD_VALUES = [
    ("subject", "abc", "subject 'abc': use a whole number"),
    ("subject", "1000", "subject 1000: use a number from 1 to 999"),
    ("run-number", "1000", "run number 1000: use a number from 1 to 999"),
    ("team", "x" * 61, "team has 61 characters: use at most 60"),
    ("pose-x", "left", "pose x 'left': use a number, as 1.5"),
    ("pose-x", "-1.5", "start pose lies on the CW side: it must lie on the CCW side"),
    ("pose-x", "0", "start pose lies on the threshold"),
    ("pose-yaw", "nan", "pose yaw 'nan': use a number, as 1.5"),
    ("timeout", "", "timeout '': use a number, as 1.5"),
    ("timeout", "0", "timeout 0 s: use 1 to 86400 s"),
    ("countdown", "1e999", "countdown '1e999': use a number, as 1.5"),
]
"""A field, what is typed there, what is said."""


async def test_a_bad_value_is_named_while_typing_and_blocks_the_start(driver: Driver) -> None:
    await driver.press(*["tab"] * 7, "enter", "f6")
    for name, text, message in BAD_VALUES:
        field = driver.console.query_one(f"#{name}", Field)
        driver.console.set_focus(field)
        await driver.settle()
        good, field.value = field.value, text
        await follow(driver, [(Driver.settle, message), ("f5", Phase.READY, says(message))])
        field.value = good
        await driver.settle()


def at_once(*keys: str) -> Callable[[Driver], object]:
    """Without a pause in between."""

    async def press(driver: Driver) -> None:
        for key in keys:
            driver.app.post_message(events.Key(key, key if len(key) == 1 else None))
        await driver.settle()
        await driver.settle()

    return press


ON_ROS = "LIVE ros domain 0"
FOLDED = "+ More: pose CCW 1.5 m, 300 s, countdown 5 s, protocol, lock by auto, Ada"
ALL = RunSetup(
    subject=7,
    team="Die Tür",
    run_number=4,
    condition=Condition(BenchmarkType.SUDDEN_FORCE, Side.CW, Side.CW),
    start_pose=StartPose(-2.5, 0.25, 12.5),
    referee="Bo Larsen",
    timeout=120.0,
    countdown=3.0,
    ruleset=RulesetName.EUROBENCH_2020,
    lock_detection=LockDetection.SENSOR,
    practice=True,
)


def top(words: str) -> Callable[[Driver], object]:
    return lambda driver: driver.rows()[0].startswith(words)


def run_of_its_team(driver: Driver) -> object:
    return f"run 1 of subject 1 {setup_of(driver).team}" in driver.text


def in_row(driver: Driver, number: int, words: str) -> object:
    return words in driver.rows()[number]


def pose_is(confirmed: bool) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.run.pose_confirmed is confirmed


def name_is(text: str) -> Callable[[Driver], object]:
    return lambda driver: driver.console.query_one("#team", Field).value == text


NAMES = (
    *("Subject", "Run", "Run is", "Opening side", "Starting side", "Benchmark", "Condition"),
    *("Start pose", "x, m", "y, m", "Yaw, deg", "Timeout, s", "Countdown, s"),
    *("Ruleset", "Lock by", "Referee"),
)


def beside(name: str) -> Callable[[Driver], object]:
    return lambda driver: re.search(rf" {name} +[\w<]", driver.text)


NO_ANGLE = Check(
    CheckName.DOOR,
    CheckState.NO_DATA,
    "no door angle comes now",
    remedy="look whether its driver runs",
)

STORIES: Stories = {
    "nothing starts after a set up that took too long": [
        (Driver.set_up,),
        ("f2 tab x",),
        (slows,),
        ("f5",),
        (ages(2.0),),
        (engine_does(HandEngine.answer),),
        (waits("", says("the engine took 2 s to answer: press again")), Phase.READY),
    ],
    "keys go into a field as they are typed however fast": [
        (at_once("down", "end", "X"), name_is(f"{DEFAULTS.team}X")),
    ],
    "a name never goes with another subject however fast the keys are": [
        ("f2",),
        (at_once("2", "f6"), set_up_with(subject=2, team="")),
    ],
    **{
        f"a team shows as it is: {name}": [
            (opened(defaults=ConsoleDefaults(team=name, referee=name)),),
            (on_engine(competition=f"Cup {name}"),),
            ("", acting(in_row, 1, f"Cup {name}")),
            (Driver.run, run_of_its_team),
            (acting(Driver.press, "i", "w", *name, "enter"),),
            (Driver.finish, run_of_its_team),
        ]
        for name in ("[red]Bots[/b]", "門 ドア 🚪", "a\\[b] 100 %")
    },
    "the keys go on while a run number is looked for and the last enter counts": [
        (on_engine(used_numbers={(2, 1): 8, (30, 1): 4}),),
        (slows,),
        ("f2 2 enter f2 =30 enter",),
        (
            "",
            lambda d: (
                [(type(request), answer.cancelled()) for request, answer in d.engine.waiting]
                == [(NextRunNumber, True), (NextRunNumber, False)]
            ),
        ),
        (lambda d: d.engine.answer(),),
        (waits("", set_up_with(subject=30, run_number=5)),),
    ],
    **{
        f"a number that a withdrawn start has used is not proposed again: {used}": [
            ("tab tab =30 tab f6",),
            (slows,),
            ("f5",),
            (sets(used_numbers={(1, 1): used}, slow=False),),
            (
                lambda d: d.engine.waiting.pop()[1].set_result(
                    "the disk did not take it: it is withdrawn"
                ),
            ),
            (waits("", says("Refused: start: the disk did not take it")),),
            ("f6", set_up_with(run_number=proposed)),
        ]
        for used, proposed in ((30, 31), (4, 30))
    },
    "every field is seen beside its name": [
        (in_sizes((80, 24), (160, 50)),),
        ("f2 tab*7 enter", *(beside(name) for name in NAMES)),
    ],
    **{
        f"enter sets up from every field choice and the button: {where}": [
            (f"f2 {where} enter", set_up_with(subject=7 if where == "7" else 1)),
            ("f6 f5",),
            (passes(6.0),),
            (Driver.finish,),
            (f"enter f a enter f2 {where} enter", set_up_with(run_number=2), Phase.READY),
        ]
        for where in ("7", "tab*4", "escape")
    },
    "what seldom changes is one line that opens and closes": [
        ("f2 tab*7",),
        *(
            row
            for key in ("enter", "space", "right")
            for row in (
                ("", FOLDED, no("Timeout, s")),
                (key, "- Less: pose CCW 1.5 m", "Timeout, s"),
                (key, lambda d: d.engine.acts == []),
            )
        ),
        (acting(Driver.click, "More: pose"), "Timeout, s"),
    ],
    "every field is reached by tab in the natural order": [
        ("tab*7 enter f2",),
        ("=7 tab '=Die Tür' tab =4 tab",),
        ("right tab",),  # practice
        ("right tab right tab right right tab tab",),  # the presets: numbers instead
        ("=-2.5 tab =0.25 tab =12.5 tab =120 tab =3 tab",),
        ("right tab right right tab '=Bo Larsen' enter", lambda d: setup_of(d) == ALL),
    ],
    "a practice run is plain on every screen and has a number of its own": [
        (on_engine(kind=SourceKind.ROS, label=ON_ROS, used_numbers={(1, 1): 3}),),
        (Driver.settle, top(f" {ON_ROS} ")),
        (
            "tab*3 right enter",
            set_up_with(practice=True),
            set_up_with(run_number=1),
            "Run 1 of subject 1 is set up.",
        ),
        ("left enter", set_up_with(practice=False), set_up_with(run_number=4)),
        ("right",),
        (Driver.set_up,),
        (Driver.run,),
        *((key, top(" ~~ PRACTICE ros domain 0 ~~ ")) for key in ("f2", "f3", "h", "s", "f4")),
        (Driver.finish, "PRACTICE: not an official result", "practice run 1 of subject 1"),
    ],
    **{
        f"start and pose set up what is seen: {key}": [
            (f"f3 {key}", lambda d: d.engine.run.setup is None),  # it is not seen
            (
                f"f2 {key}",
                set_up_with(subject=1),
                Phase.READY,
                pose_is(confirmed),
            ),
        ]
        for key, confirmed in (("f5", False), ("f6", True))
    },
    "the place in a list stands only beside a choice of more than two": [
        ("f2 tab*3", focused("practice"), "< official >", no("1/2")),
        ("tab*3", focused("benchmark"), f"1/{len(BenchmarkType)}"),
    ],
    "a typed name is its subjects alone and comes back with it": [
        ("f2 2", name_is("")),
        ("tab =Twos f2 1", name_is(DEFAULTS.team)),
        ("f2 2 f6", set_up_with(subject=2), set_up_with(team="Twos")),
    ],
    "enter sets up what is shown": [
        ("", "Not set up yet"),
        (
            "enter",
            lambda d: d.engine.acts == [SetUp(a_setup())],
            "Run 1 of subject 1 is set up. F6 confirms its pose.",
        ),
    ],
    "a wrong value that is folded away is shown": [
        ("f2 tab*7 enter shift+tab*8 2 tab*8 enter", no("x, m")),
        ("shift+tab shift+tab right", "start pose lies on the CCW side", "x, m"),
    ],
    "looking at another pane sets nothing up": [
        ("tab f3 f2 f4", lambda d: d.engine.acts == []),
    ],
    "without a typed number the next one of subject and condition is taken": [
        (
            on_engine(used_numbers={(1, 1): 3, (2, 1): 8, (2, 2): 1}),
            lambda d: re.search(" Run +next", d.text),
        ),
        (
            "enter",
            set_up_with(run_number=4),
            lambda d: re.search(" Run +4", d.text),
        ),
        ("f2 2 enter", set_up_with(run_number=9)),
        ("f2 tab*6 right", lambda d: re.search(" Run +next", d.text)),
        (
            "enter",
            lambda d: (setup_of(d).condition.number, setup_of(d).run_number) == (2, 2),
        ),
        (
            "f2 tab tab 3 0 enter f6 f5",
            set_up_with(run_number=30),
            Phase.COUNTDOWN,
        ),
    ],
    "a team belongs to its subject": [
        (on_engine(teams=TeamList({1: "Ones", 2: "Twos"})),),
        (opened(defaults=ConsoleDefaults()),),
        ("enter", set_up_with(team="Ones")),
        ("f2 2 enter", set_up_with(team="Twos")),
        ("f2 3 enter", set_up_with(team="")),
    ],
    "what is typed last counts for the start": [
        (
            "enter f6 f2 =5",
            set_up_with(subject=1),
            "Not set up yet: Enter sets it up.",
        ),
        (
            "f5",
            set_up_with(subject=5),
            says_only("Refused: start: F6 confirms the start pose"),
        ),
        ("f6 f5", Phase.COUNTDOWN),
    ],
    "a preset pose changes sides with the robot and typed numbers stay": [
        ("tab*5 right enter", set_up_with(start_pose=StartPose(-1.5, 0.0, 0.0))),
        ("tab tab enter f2 tab*8 =-1.2 f2 tab*5 right enter", "start pose lies on the CW side"),
        ("left enter", set_up_with(start_pose=StartPose(-1.2, 0.0, 0.0))),
    ],
    "on a simulated testbed nothing can be put to official": [
        (on_engine(simulated="nominal"),),
        (Driver.set_up, set_up_with(practice=True)),
        (
            "f2 tab*3 right enter",
            lambda d: re.search(" Run is +< PRACTICE >", d.text),
            set_up_with(practice=True),
        ),
    ],
    "a testbed that says late that it is simulated makes the next set up practice": [
        (on_engine(kind=SourceKind.ROS, label="LIVE ros domain 0"),),
        (Driver.set_up,),
        ("f6",),
        (
            has(simulated="nominal", label="SIMULATED over ROS domain 0"),
            lambda d: d.rows()[0].startswith(" ~~ SIMULATED over ROS"),
            set_up_with(practice=False),
        ),
        ("f5", set_up_with(practice=True), Phase.READY),
        ("f6 f5", Phase.COUNTDOWN),
    ],
    "nothing is editable once the countdown runs": [
        (Driver.set_up,),
        ("f5 f2", "No run can be set up now: the countdown is running."),
        (remember,),
        ("9 tab right enter escape", did_nothing),
    ],
    "the last runs settings are the next runs proposal": [
        ("tab",),
        ("=Knockers tab",),
        (Driver.run,),
        (Driver.finish,),
        ("enter f a enter f2", "Draft for subject 1: Enter sets it up.", Phase.FINAL),
        (
            "enter",
            set_up_with(run_number=2),
            set_up_with(team="Knockers"),
            Phase.READY,
        ),
    ],
    "a testbed that is silent is one line of the checks": [
        (Driver.set_up,),
        (sets(silent=list(Signal)),),
        (passes(3.0),),
        ("", "5 of 9 checks fail", "x no testbed: all", "4 ok, 4 without data for that reason"),
        ("", no("no door angle comes now"), no("no handle force comes now")),
        (sets(silent={Signal.DOOR}),),
        (passes(3.0), "x door angle: silent for", "7 ok, 1 without data for that reason"),
        (has(checks=(NO_ANGLE,)), "? look whether its driver runs: no door angle comes now"),
    ],
    "the checks of a draft are not those of the run before": [
        (on_engine(angle=0.2),),
        (Driver.set_up,),
        ("shift+tab enter 2 f5",),
        (passes(6.0),),
        (Driver.finish,),
        (sets(angle=0.2),),
        (
            "f2",
            "Checks  2 of 9 checks fail",
            "x close the door: angle +0.200 rad, closed below 0.03",
            "x F6 confirms the start pose",
        ),
    ],
    "a check is waived from the list": [
        (on_engine(angle=0.2),),
        (Driver.set_up,),
        ("shift+tab enter", "Waive 'door closed' for this run"),
        ("2", "~ door closed: waived, known testbed fault (angle +0.200 rad"),
        ("f5", Phase.COUNTDOWN),
    ],
    "a check that passes is not waived": [
        (Driver.set_up,),
        ("shift+tab enter", no_question, "✓ 9 ok"),
        ("up", focused("set-up")),
    ],
    "sides that must be set by hand are shown": [
        (
            on_engine(
                sides_problem="no node /madrob/door: set the opening side to CCW at the testbed"
            ),
            "! sides: no node /madrob/door",
            "at the testbed",
        ),
    ],
    "a name changed by cleaning is shown changed": [
        (
            "tab '=../Bots/  One' enter",
            set_up_with(team="Bots One"),
            lambda d: d.console.query_one("#team", Field).value == "Bots One",
        ),
    ],
    "a letter in a number is told below the fields until it is mended": [
        (
            "f2 x",
            "x subject: 'x' is no number. Escape, then letters are keys.",
            lambda d: "no number" not in d.console.status,
        ),
        ("4", no("no number")),
        ("x", "x subject: 'x' is no number. Escape, then letters are keys."),
        ("tab", no("no number")),
        ("shift+tab x f3 f2", no("no number")),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(HandEngine, STORIES[story])
