from __future__ import annotations

import re

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
from tests.madrob_console.ui.driver import DEFAULTS, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine, a_setup


def setup_of(engine: FakeEngine) -> RunSetup:
    assert engine.run.setup is not None
    return engine.run.setup


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


async def test_enter_sets_up_what_is_shown(driver: Driver, engine: FakeEngine) -> None:
    assert "Not set up yet" in driver.text
    await driver.press("enter")
    assert engine.acts == [SetUp(a_setup())]
    assert "Run 1 of subject 1 is set up. F6 confirms its pose." in driver.text


@pytest.mark.parametrize("where", [(), ("7",), ("tab",), ("tab",) * 4, ("escape",)])
async def test_enter_sets_up_from_every_field_choice_and_the_button(
    driver: Driver, engine: FakeEngine, where: tuple[str, ...]
) -> None:
    await driver.press("f2", *where, "enter")
    assert setup_of(engine).subject == (7 if where == ("7",) else 1)
    await driver.press("f6", "f5")
    await driver.let_pass(6.0)
    await driver.finish()
    await driver.press("enter", "f", "a", "enter", "f2", *where, "enter")
    assert setup_of(engine).run_number == 2
    assert phase(engine) is Phase.READY


async def test_what_seldom_changes_is_one_line_that_opens_and_closes(
    driver: Driver, engine: FakeEngine
) -> None:
    folded = "+ More: pose CCW 1.5 m, 300 s, countdown 5 s, protocol, lock by auto, Ada"
    await driver.press("f2", *["tab"] * 7)
    for key in ("enter", "space", "right"):
        assert folded in driver.text
        assert "Timeout, s" not in driver.text
        await driver.press(key)
        assert "- Less: pose CCW 1.5 m" in driver.text
        assert "Timeout, s" in driver.text
        await driver.press(key)
    assert engine.acts == []
    y = next(y for y, row in enumerate(driver.rows()) if folded in row)
    await driver.pilot.click(offset=(20, y))
    await driver.settle()
    assert "Timeout, s" in driver.text


async def test_a_wrong_value_that_is_folded_away_is_shown(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("f2", *UNFOLD, *["shift+tab"] * 8, "2", *["tab"] * 8, "enter")
    assert "x, m" not in driver.text
    await driver.press(*["shift+tab"] * 2, "right")
    assert "start pose lies on the CCW side" in driver.text
    assert "x, m" in driver.text


async def test_looking_at_another_pane_sets_nothing_up(driver: Driver, engine: FakeEngine) -> None:
    await driver.press("tab", "f3", "f2", "f4")
    assert engine.acts == []


async def test_every_field_is_reached_by_tab_in_the_natural_order(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press(*UNFOLD, "f2")
    for text in ("7", "Die Tür", "4"):
        await fill(driver, text)
    await driver.press("right", "tab")  # practice
    await driver.press("right", "tab", "right", "tab", "right", "right", "tab")
    await driver.press("tab")  # the presets: numbers instead
    for text in ("-2.5", "0.25", "12.5", "120", "3"):
        await fill(driver, text)
    await driver.press("right", "tab", "right", "right", "tab")
    await driver.type("Bo Larsen")
    await driver.press("enter")
    assert setup_of(engine) == RunSetup(
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


async def test_without_a_typed_number_the_next_one_of_subject_and_condition_is_taken(
    engine: FakeEngine,
) -> None:
    engine.used_numbers = {(1, 1): 3, (2, 1): 8, (2, 2): 1}

    async with driving(engine) as driver:
        assert re.search(r" Run +next", driver.text)
        await driver.press("enter")
        assert setup_of(engine).run_number == 4
        assert re.search(r" Run +4", driver.text)
        await driver.press("f2", "2", "enter")
        assert setup_of(engine).run_number == 9
        await driver.press("f2", *["tab"] * 6, "right")
        assert re.search(r" Run +next", driver.text)
        await driver.press("enter")
        assert (setup_of(engine).condition.number, setup_of(engine).run_number) == (2, 2)
        await driver.press("f2", "tab", "tab", "3", "0", "enter", "f6", "f5")
        assert setup_of(engine).run_number == 30
        assert phase(engine) is Phase.COUNTDOWN


async def test_a_team_belongs_to_its_subject(engine: FakeEngine) -> None:
    engine.teams = TeamList({1: "Ones", 2: "Twos"})

    async with driving(engine, defaults=ConsoleDefaults()) as driver:
        await driver.press("enter")
        assert setup_of(engine).team == "Ones"
        await driver.press("f2", "2", "enter")
        assert setup_of(engine).team == "Twos"
        await driver.press("f2", "3", "enter")
        assert setup_of(engine).team == ""


async def test_a_typed_name_is_its_subjects_alone_and_comes_back_with_it(
    driver: Driver, engine: FakeEngine
) -> None:
    name = driver.console.query_one("#team", Field)
    await driver.press("f2", "2")
    assert name.value == ""
    await driver.press("tab")
    await driver.type("Twos")
    await driver.press("f2", "1")
    assert name.value == DEFAULTS.team
    await driver.press("f2", "2", "f6")
    assert (setup_of(engine).subject, setup_of(engine).team) == (2, "Twos")


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


async def test_what_is_typed_last_counts_for_the_start(driver: Driver, engine: FakeEngine) -> None:
    await driver.press("enter", "f6", "f2")
    await driver.type("5")
    assert setup_of(engine).subject == 1
    assert "Not set up yet: Enter sets it up." in driver.text
    await driver.press("f5")
    assert setup_of(engine).subject == 5
    assert driver.console.status == "Refused: start: F6 confirms the start pose"
    await driver.press("f6", "f5")
    assert engine.run.phase is Phase.COUNTDOWN


@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
async def test_every_field_is_seen_beside_its_name(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    names = ["Subject", "Run", "Run is", "Opening side", "Starting side", "Benchmark"]
    names += ["Condition", "Start pose", "x, m", "y, m", "Yaw, deg", "Timeout, s", "Countdown, s"]
    names += ["Ruleset", "Lock by", "Referee"]

    async with driving(engine, size) as driver:
        await driver.press("f2", *UNFOLD)
        for name in names:
            assert re.search(rf" {name} +[\w<]", driver.text), name


async def test_a_preset_pose_changes_sides_with_the_robot_and_typed_numbers_stay(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press(*["tab"] * 5, "right", "enter")
    assert setup_of(engine).start_pose == StartPose(-1.5, 0.0, 0.0)
    await driver.press("tab", "tab", "enter", "f2", *["tab"] * 8)
    await driver.type("-1.2")
    await driver.press("f2", *["tab"] * 5, "right", "enter")
    assert "start pose lies on the CW side" in driver.text
    await driver.press("left", "enter")
    assert setup_of(engine).start_pose == StartPose(-1.2, 0.0, 0.0)


async def test_a_practice_run_is_plain_on_every_screen_and_has_a_number_of_its_own(
    engine: FakeEngine,
) -> None:
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"
    engine.used_numbers[1, 1] = 3

    async with driving(engine) as driver:
        await driver.settle()
        assert driver.rows()[0].startswith(" LIVE ros domain 0 ")
        await driver.press(*["tab"] * 3, "right", "enter")
        setup = setup_of(engine)
        assert (setup.practice, setup.run_number) == (True, 1)
        assert "Run 1 of subject 1 is set up." in driver.text
        await driver.press("left", "enter")
        assert (setup_of(engine).practice, setup_of(engine).run_number) == (False, 4)
        await driver.press("right")
        await driver.set_up()
        await driver.run()
        for key in ("f2", "f3", "h", "s", "f4"):
            await driver.press(key)
            assert driver.rows()[0].startswith(" ~~ PRACTICE ros domain 0 ~~ ")
        await driver.finish()
        assert "PRACTICE: not an official result" in driver.text
        assert "practice run 1 of subject 1" in driver.text


async def test_on_a_simulated_testbed_nothing_can_be_put_to_official(engine: FakeEngine) -> None:
    engine.simulated = "nominal"

    async with driving(engine) as driver:
        await driver.set_up()
        assert setup_of(engine).practice
        await driver.press("f2", "tab", "tab", "tab", "right", "enter")
        assert re.search(r" Run is +< PRACTICE >", driver.text)
        assert setup_of(engine).practice


async def test_a_testbed_that_says_late_that_it_is_simulated_makes_the_next_set_up_practice(
    engine: FakeEngine,
) -> None:
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"

    async with driving(engine) as driver:
        await driver.set_up()
        await driver.press("f6")
        engine.simulated, engine.label = "nominal", "SIMULATED over ROS domain 0"
        await driver.settle()
        assert driver.rows()[0].startswith(" ~~ SIMULATED over ROS")
        assert not setup_of(engine).practice
        await driver.press("f5")  # what the form shows counts; its pose is not confirmed
        assert setup_of(engine).practice
        assert phase(engine) is Phase.READY
        await driver.press("f6", "f5")
        assert phase(engine) is Phase.COUNTDOWN


async def test_nothing_is_editable_once_the_countdown_runs(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.set_up()
    await driver.press("f5", "f2")
    assert "Nothing is set up now: the countdown is running." in driver.text
    before = engine.run.setup
    await driver.press("9", "tab", "right", "enter", "escape")
    assert engine.run.setup == before


async def test_the_last_runs_settings_are_the_next_runs_proposal(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("tab")
    await fill(driver, "Knockers")
    await driver.run()
    await driver.finish()
    await driver.press("enter", "f", "a", "enter", "f2")
    assert "Draft for subject 1: Enter sets it up." in driver.text
    assert phase(engine) is Phase.FINAL
    await driver.press("enter")
    assert setup_of(engine).run_number == 2
    assert setup_of(engine).team == "Knockers"
    assert phase(engine) is Phase.READY


async def test_the_checks_of_a_draft_are_not_those_of_the_run_before(engine: FakeEngine) -> None:
    engine.angle = 0.2

    async with driving(engine) as driver:
        await driver.set_up()
        await driver.press("shift+tab", "enter", "2", "f5")
        await driver.let_pass(6.0)
        await driver.finish()
        await driver.press("f2")
        assert "Checks  2 of 9 in the way of a start" in driver.text
        assert "x close the door: angle +0.200 rad, closed below 0.03" in driver.text
        assert "x F6 confirms the start pose" in driver.text


@pytest.mark.parametrize("key", ["f5", "f6"])
async def test_start_and_pose_set_up_what_is_seen(
    driver: Driver, engine: FakeEngine, key: str
) -> None:
    await driver.press("f3", key)
    assert engine.run.setup is None  # it is not seen
    await driver.press("f2", key)
    assert setup_of(engine).subject == 1
    assert engine.run.pose_confirmed is (key == "f6")
    assert engine.run.phase is Phase.READY


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


async def test_a_check_is_waived_from_the_list(engine: FakeEngine) -> None:
    engine.angle = 0.2

    async with driving(engine) as driver:
        await driver.set_up()
        await driver.press("shift+tab", "enter")
        assert "Waive 'door closed' for this run" in driver.text
        await driver.press("2")
        assert "~ door closed: waived, known testbed fault (close the door: angle" in driver.text
        await driver.press("f5")
        assert engine.run.phase is Phase.COUNTDOWN


async def test_a_check_that_passes_is_not_waived(driver: Driver) -> None:
    await driver.set_up()
    await driver.press("shift+tab", "enter")
    assert not driver.console.dialogs
    assert "✓ 9 ok" in driver.text
    await driver.press("up")
    assert driver.app.focused is not None
    assert driver.app.focused.id == "set-up"


async def test_sides_that_must_be_set_by_hand_are_shown(engine: FakeEngine) -> None:
    engine.sides_problem = "no node /madrob/door: set the opening side to CCW at the testbed"

    async with driving(engine) as driver:
        assert "! sides: no node /madrob/door" in driver.text
        assert "at the testbed" in driver.text


@pytest.mark.parametrize("name", ["[red]Bots[/b]", "門 ドア 🚪", "a\\[b] 100 %"])
async def test_a_team_shows_as_it_is(engine: FakeEngine, name: str) -> None:
    defaults = ConsoleDefaults(team=name, competition=f"Cup {name}", referee=name)

    async with driving(engine, defaults=defaults) as driver:
        assert f"Cup {name}" in driver.rows()[1]
        await driver.run()
        cleaned = setup_of(engine).team
        assert f"run 1 of subject 1 {cleaned}" in driver.text
        engine.say(f"note: {name}")
        await driver.press("i", "n", *name, "enter")
        await driver.finish()
        assert f"run 1 of subject 1 {cleaned}" in driver.text


async def test_a_name_changed_by_cleaning_is_shown_changed(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("tab")
    await driver.type("../Bots/  One")
    await driver.press("enter")
    assert setup_of(engine).team == "Bots One"
    assert driver.console.query_one("#team", Field).value == "Bots One"


async def test_a_number_that_cannot_be_proposed_is_no_crash(engine: FakeEngine) -> None:
    engine.no_number = "the results folder /results cannot be read: mount it"

    async with driving(engine) as driver:
        await driver.press("enter")
        assert "x the results folder /results cannot be read: mount it" in shown(driver)
        assert engine.acts == []


async def test_the_defaults_are_what_is_proposed(driver: Driver) -> None:
    assert DEFAULTS.team in driver.text
    assert DEFAULTS.referee in driver.text
    assert DEFAULTS.competition in driver.rows()[1]
    assert "1: pull, CCW to CW" in driver.text


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


async def test_the_place_in_a_list_stands_only_beside_a_choice_of_more_than_two(
    driver: Driver,
) -> None:
    await driver.press("f2")
    driver.console.query_one("#practice").focus()
    await driver.settle()
    assert "< official >" in driver.text
    assert "1/2" not in driver.text
    driver.console.query_one("#benchmark").focus()
    await driver.settle()
    assert f"1/{len(BenchmarkType)}" in driver.text


async def test_a_letter_in_a_number_is_told_below_the_fields_until_it_is_mended(
    engine: FakeEngine,
) -> None:
    words = "x subject: 'x' is no number. Escape, then letters are keys."

    async with driving(engine) as driver:
        await driver.press("f2", "x")
        assert words in shown(driver)
        assert "no number" not in driver.console.status
        await driver.press("4")
        assert "no number" not in driver.text
        await driver.press("x")
        assert words in shown(driver)
        await driver.press("tab")
        assert "no number" not in driver.text
        await driver.press("shift+tab", "x", "f3", "f2")
        assert "no number" not in driver.text
