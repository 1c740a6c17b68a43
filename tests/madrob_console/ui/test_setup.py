from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from textual import events

from madrob_console.common.names import SourceKind
from madrob_console.engine.requests import NextRunNumber
from madrob_console.referee.acts import SetUp
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.dialog import Field
from madrob_console.ui.link import ConsoleDefaults
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    Driver,
    Stories,
    acting,
    did_nothing,
    driving,
    focused,
    has,
    in_sizes,
    no,
    no_question,
    on_engine,
    opened,
    passes,
    play,
    remember,
    says_only,
    setup_of,
)
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine, a_setup


def phase(engine: FakeEngine) -> Phase:
    return engine.run.phase


def shown(driver: Driver) -> str:
    """The screen, however its lines are broken."""
    return " ".join(driver.text.split())


UNFOLD = (*["tab"] * 7, "enter")
"""From the first field to the line that unfolds the others."""


async def fill(driver: Driver, text: str) -> None:
    """Replace what the field with the focus holds and go on."""
    await driver.type(text)
    await driver.press("tab")


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


async def test_a_bad_value_is_named_while_typing_and_blocks_the_start(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press(*UNFOLD, "f6")
    for name, text, message in BAD_VALUES:
        field = driver.console.query_one(f"#{name}", Field)
        driver.console.set_focus(field)
        await driver.settle()
        good, field.value = field.value, text
        await driver.settle()
        assert message in shown(driver)
        await driver.press("f5")
        assert engine.run.phase is Phase.READY
        assert message in driver.console.status
        field.value = good
        await driver.settle()


async def test_keys_go_into_a_field_as_they_are_typed_however_fast(driver: Driver) -> None:
    field = driver.console.query_one("#team", Field)
    for key in ("down", "end", "X"):  # no pause in between
        driver.app.post_message(events.Key(key, "X" if key == "X" else None))
    await driver.settle()
    assert field.value == f"{DEFAULTS.team}X"


async def test_a_name_never_goes_with_another_subject_however_fast_the_keys_are(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("f2")
    for key in ("2", "f6"):  # no pause in between
        driver.app.post_message(events.Key(key, key if key == "2" else None))
    await driver.settle()
    await driver.settle()
    assert (setup_of(engine).subject, setup_of(engine).team) == (2, "")


@pytest.mark.parametrize("name", ["[red]Bots[/b]", "門 ドア 🚪", "a\\[b] 100 %"])
async def test_a_team_shows_as_it_is(engine: FakeEngine, name: str) -> None:
    defaults = ConsoleDefaults(team=name, referee=name)
    engine.competition = f"Cup {name}"

    async with driving(engine, defaults=defaults) as driver:
        assert f"Cup {name}" in driver.rows()[1]
        await driver.run()
        cleaned = setup_of(engine).team
        assert f"run 1 of subject 1 {cleaned}" in driver.text
        engine.say(f"note: {name}")
        await driver.press("i", "n", *name, "enter")
        await driver.finish()
        assert f"run 1 of subject 1 {cleaned}" in driver.text


async def test_the_keys_go_on_while_a_run_number_is_looked_for_and_the_last_enter_counts(
    slow_engine: SlowEngine,
) -> None:
    slow_engine.used_numbers = {(2, 1): 8, (30, 1): 4}

    async with driving(slow_engine) as driver:
        slow_engine.slow = True
        await driver.press("f2", "2", "enter", "f2")
        await driver.type("30")
        await driver.press("enter")
        assert {type(request) for request, _ in slow_engine.waiting} == {NextRunNumber}
        before, last = [answer for _, answer in slow_engine.waiting]
        assert before.cancelled()
        assert not last.cancelled()
        slow_engine.slow = False
        slow_engine.answer()
        await driver.settle()
        assert (setup_of(slow_engine).subject, setup_of(slow_engine).run_number) == (30, 5)


@pytest.mark.parametrize(("used", "proposed"), [(30, 31), (4, 30)])
async def test_a_number_that_a_withdrawn_start_has_used_is_not_proposed_again(
    slow_engine: SlowEngine, used: int, proposed: int
) -> None:

    async with driving(slow_engine) as driver:
        await driver.press("tab", "tab")
        await fill(driver, "30")
        await driver.press("f6")
        slow_engine.slow = True
        await driver.press("f5")
        slow_engine.used_numbers = {(1, 1): used}
        slow_engine.slow = False
        slow_engine.waiting.pop()[1].set_result("the disk did not take it: it is withdrawn")
        await driver.settle()
        assert "Refused: start: the disk did not take it" in driver.console.status
        await driver.press("f6")
        assert setup_of(slow_engine).run_number == proposed


async def test_nothing_starts_after_a_set_up_that_took_too_long(slow_engine: SlowEngine) -> None:
    now = 0.0

    async with driving(slow_engine, monotonic=lambda: now) as driver:
        await driver.set_up()
        await driver.press("f2", "tab")
        await driver.type("x")
        slow_engine.slow = True
        await driver.press("f5")
        now += 2.0
        slow_engine.slow = False
        slow_engine.answer()
        await driver.settle()
        assert "the engine took 2 s to answer: press again" in driver.console.status
        assert slow_engine.run.phase is Phase.READY


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


async def click_fold(driver: Driver) -> None:
    y = next(y for y, row in enumerate(driver.rows()) if FOLDED in row)
    await driver.pilot.click(offset=(20, y))
    await driver.settle()


def top(words: str) -> Callable[[Driver], object]:
    return lambda driver: driver.rows()[0].startswith(words)


def run_is(number: int) -> Callable[[Driver], object]:
    return lambda driver: setup_of(driver.engine).run_number == number


def subject_is(number: int) -> Callable[[Driver], object]:
    return lambda driver: setup_of(driver.engine).subject == number


def pose_is(confirmed: bool) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.run.pose_confirmed is confirmed


def practises(driver: Driver) -> object:
    return setup_of(driver.engine).practice


def name_is(text: str) -> Callable[[Driver], object]:
    return lambda driver: driver.console.query_one("#team", Field).value == text


NAMES = (
    *("Subject", "Run", "Run is", "Opening side", "Starting side", "Benchmark", "Condition"),
    *("Start pose", "x, m", "y, m", "Yaw, deg", "Timeout, s", "Countdown, s"),
    *("Ruleset", "Lock by", "Referee"),
)


def beside(name: str) -> Callable[[Driver], object]:
    return lambda driver: re.search(rf" {name} +[\w<]", driver.text)


STORIES: Stories = {
    "every field is seen beside its name": [
        (in_sizes((80, 24), (160, 50)),),
        ("f2 tab*7 enter", *(beside(name) for name in NAMES)),
    ],
    **{
        f"enter sets up from every field choice and the button: {where}": [
            (f"f2 {where} enter", subject_is(7 if where == "7" else 1)),
            ("f6 f5",),
            (passes(6.0),),
            (Driver.finish,),
            (f"enter f a enter f2 {where} enter", run_is(2), Phase.READY),
        ]
        for where in ("", "7", "tab", "tab*4", "escape")
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
        (click_fold, "Timeout, s"),
    ],
    "every field is reached by tab in the natural order": [
        ("tab*7 enter f2",),
        ("=7 tab '=Die Tür' tab =4 tab",),
        ("right tab",),  # practice
        ("right tab right tab right right tab tab",),  # the presets: numbers instead
        ("=-2.5 tab =0.25 tab =12.5 tab =120 tab =3 tab",),
        ("right tab right right tab '=Bo Larsen' enter", lambda d: setup_of(d.engine) == ALL),
    ],
    "a practice run is plain on every screen and has a number of its own": [
        (on_engine(kind=SourceKind.ROS, label=ON_ROS, used_numbers={(1, 1): 3}),),
        (Driver.settle, top(f" {ON_ROS} ")),
        ("tab*3 right enter", practises, run_is(1), "Run 1 of subject 1 is set up."),
        ("left enter", lambda d: not setup_of(d.engine).practice, run_is(4)),
        ("right",),
        (Driver.set_up,),
        (Driver.run,),
        *((key, top(" ~~ PRACTICE ros domain 0 ~~ ")) for key in ("f2", "f3", "h", "s", "f4")),
        (Driver.finish, "PRACTICE: not an official result", "practice run 1 of subject 1"),
    ],
    **{
        f"start and pose set up what is seen: {key}": [
            (f"f3 {key}", lambda d: d.engine.run.setup is None),  # it is not seen
            (f"f2 {key}", subject_is(1), Phase.READY, pose_is(confirmed)),
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
        ("f2 2 f6", subject_is(2), lambda d: setup_of(d.engine).team == "Twos"),
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
            run_is(4),
            lambda d: re.search(" Run +4", d.text),
        ),
        ("f2 2 enter", run_is(9)),
        ("f2 tab*6 right", lambda d: re.search(" Run +next", d.text)),
        (
            "enter",
            lambda d: (
                (setup_of(d.engine).condition.number, setup_of(d.engine).run_number) == (2, 2)
            ),
        ),
        (
            "f2 tab tab 3 0 enter f6 f5",
            run_is(30),
            Phase.COUNTDOWN,
        ),
    ],
    "a team belongs to its subject": [
        (on_engine(teams=TeamList({1: "Ones", 2: "Twos"})),),
        (opened(defaults=ConsoleDefaults()),),
        ("enter", lambda d: setup_of(d.engine).team == "Ones"),
        ("f2 2 enter", lambda d: setup_of(d.engine).team == "Twos"),
        ("f2 3 enter", lambda d: setup_of(d.engine).team == ""),
    ],
    "what is typed last counts for the start": [
        (
            "enter f6 f2 =5",
            subject_is(1),
            "Not set up yet: Enter sets it up.",
        ),
        (
            "f5",
            subject_is(5),
            says_only("Refused: start: F6 confirms the start pose"),
        ),
        ("f6 f5", Phase.COUNTDOWN),
    ],
    "a preset pose changes sides with the robot and typed numbers stay": [
        ("tab*5 right enter", lambda d: setup_of(d.engine).start_pose == StartPose(-1.5, 0.0, 0.0)),
        ("tab tab enter f2 tab*8 =-1.2 f2 tab*5 right enter", "start pose lies on the CW side"),
        ("left enter", lambda d: setup_of(d.engine).start_pose == StartPose(-1.2, 0.0, 0.0)),
    ],
    "on a simulated testbed nothing can be put to official": [
        (on_engine(simulated="nominal"),),
        (Driver.set_up, lambda d: setup_of(d.engine).practice),
        (
            "f2 tab*3 right enter",
            lambda d: re.search(" Run is +< PRACTICE >", d.text),
            lambda d: setup_of(d.engine).practice,
        ),
    ],
    "a testbed that says late that it is simulated makes the next set up practice": [
        (on_engine(kind=SourceKind.ROS, label="LIVE ros domain 0"),),
        (Driver.set_up,),
        ("f6",),
        (
            has(simulated="nominal", label="SIMULATED over ROS domain 0"),
            lambda d: d.rows()[0].startswith(" ~~ SIMULATED over ROS"),
            lambda d: not setup_of(d.engine).practice,
        ),
        ("f5", lambda d: setup_of(d.engine).practice, Phase.READY),
        ("f6 f5", Phase.COUNTDOWN),
    ],
    "nothing is editable once the countdown runs": [
        (Driver.set_up,),
        ("f5 f2", "Nothing is set up now: the countdown is running."),
        (remember,),
        ("9 tab right enter escape", did_nothing),
    ],
    "the last runs settings are the next runs proposal": [
        ("tab",),
        (acting(fill, "Knockers"),),
        (Driver.run,),
        (Driver.finish,),
        ("enter f a enter f2", "Draft for subject 1: Enter sets it up.", Phase.FINAL),
        (
            "enter",
            run_is(2),
            lambda d: setup_of(d.engine).team == "Knockers",
            Phase.READY,
        ),
    ],
    "the checks of a draft are not those of the run before": [
        (on_engine(angle=0.2),),
        (Driver.set_up,),
        ("shift+tab enter 2 f5",),
        (passes(6.0),),
        (Driver.finish,),
        (
            "f2",
            "Checks  2 of 9 in the way of a start",
            "x close the door: angle +0.200 rad, closed below 0.03",
            "x F6 confirms the start pose",
        ),
    ],
    "a check is waived from the list": [
        (on_engine(angle=0.2),),
        (Driver.set_up,),
        ("shift+tab enter", "Waive 'door closed' for this run"),
        ("2", "~ door closed: waived, known testbed fault (close the door: angle"),
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
            lambda d: setup_of(d.engine).team == "Bots One",
            lambda d: d.console.query_one("#team", Field).value == "Bots One",
        ),
    ],
    "a number that cannot be proposed is no crash": [
        (on_engine(no_number="the results folder /results cannot be read: mount it"),),
        (
            "enter",
            "x the results folder /results cannot be read: mount it",
            lambda d: d.engine.acts == [],
        ),
    ],
    "the defaults are what is proposed": [
        (
            "",
            DEFAULTS.team,
            DEFAULTS.referee,
            lambda d: DEFAULTS.competition in d.rows()[1],
            "1: pull, CCW to CW",
        ),
    ],
    "the competition above is the engine's and not that of newer settings": [
        (on_engine(competition="Spring Cup"),),
        ("", lambda d: d.rows()[1].endswith("Spring Cup"), no(DEFAULTS.competition)),
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
    await play(FakeEngine, STORIES[story])
