from __future__ import annotations

import asyncio

import pytest

from madrob_console.referee.acts import SetUp
from madrob_console.referee.run import Phase, RunSetup
from madrob_console.ui.cells.field import Field
from madrob_console.ui.defaults import ConsoleDefaults
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName
from tests.madrob_console.ui.driver import DEFAULTS, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup


def setup_of(engine: FakeEngine) -> RunSetup:
    assert engine.run.setup is not None
    return engine.run.setup


def phase(engine: FakeEngine) -> Phase:
    return engine.run.phase


async def fill(driver: Driver, text: str) -> None:
    """Replace what the field with the focus holds and go on."""
    await driver.type(text)
    await driver.press("tab")


def test_enter_sets_up_what_is_shown(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            assert "Not set up yet" in driver.text
            await driver.press("enter")
            assert engine.acts == [SetUp(a_setup())]
            assert "Run 1 of subject 1 is set up. F6 confirms its pose." in driver.text

    asyncio.run(drive())


def test_looking_at_another_pane_sets_nothing_up(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "f3", "f2", "f4")
            assert engine.acts == []

    asyncio.run(drive())


def test_every_field_is_reached_by_tab_in_the_natural_order(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            for text in ("7", "4", "Die Tür", "Bo Larsen"):
                await fill(driver, text)
            await driver.press("right", "tab", "right", "tab", "right", "right", "tab")
            await driver.press("tab")  # the presets: numbers instead
            for text in ("-2.5", "0.25", "12.5", "120", "3"):
                await fill(driver, text)
            await driver.press("right", "tab", "right", "right", "enter", "enter")
            assert setup_of(engine) == RunSetup(
                subject=7,
                team="Die Tür",
                run_number=1,  # proposed again: the condition came after the number
                condition=Condition(BenchmarkType.SUDDEN_FORCE, Side.CW, Side.CW),
                start_pose=StartPose(-2.5, 0.25, 12.5),
                referee="Bo Larsen",
                timeout=120.0,
                countdown=3.0,
                ruleset=RulesetName.EUROBENCH_2020,
                lock_detection=LockDetection.SENSOR,
            )

    asyncio.run(drive())


def test_the_next_run_number_is_proposed_for_subject_and_condition(engine: FakeEngine) -> None:
    engine.used_numbers = {(1, 1): 3, (2, 1): 8, (2, 2): 1}

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter")
            assert setup_of(engine).run_number == 4
            await driver.press("shift+tab")
            await fill(driver, "2")
            assert setup_of(engine).run_number == 9
            await driver.press(*["tab"] * 5, "right")
            assert setup_of(engine).condition.number == 2
            assert setup_of(engine).run_number == 2
            await driver.press(*["shift+tab"] * 5)
            await fill(driver, "30")
            assert setup_of(engine).run_number == 30

    asyncio.run(drive())


def test_a_team_belongs_to_its_subject(engine: FakeEngine) -> None:
    defaults = ConsoleDefaults(teams={1: "Ones", 2: "Twos"})

    async def drive() -> None:
        async with driving(engine, defaults=defaults) as driver:
            await driver.press("enter", "shift+tab")
            assert setup_of(engine).team == "Ones"
            await fill(driver, "2")
            assert setup_of(engine).team == "Twos"
            await driver.press("shift+tab")
            await fill(driver, "3")
            assert setup_of(engine).team == ""

    asyncio.run(drive())


BAD_VALUES = [
    ("subject", "abc", "subject 'abc': use a whole number"),
    ("subject", "1000", "subject 1000: use a number from 1 to 999"),
    ("run-number", "0", "run number 0: use a number from 1 to 999"),
    ("team", "x" * 61, "team has 61 characters: use at most 60"),
    ("pose-x", "left", "start pose x 'left': use a number of metres"),
    ("pose-x", "-1.5", "start pose lies on the CW side: it must lie on the CCW side"),
    ("pose-x", "0", "start pose lies on the threshold"),
    ("pose-yaw", "nan", "start pose yaw 'nan': use a number of degrees"),
    ("timeout", "", "timeout '': use a number of seconds"),
    ("timeout", "0", "timeout 0 s: use 1 to 86400 s"),
    ("countdown", "1e999", "countdown '1e999': use a number of seconds"),
]
"""A field, what is typed there, what is said."""


def test_a_bad_value_is_named_while_typing_and_blocks_the_start(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "f6")
            for name, text, message in BAD_VALUES:
                field = driver.console.query_one(f"#{name}", Field)
                driver.console.set_focus(field)
                await driver.settle()
                good, field.value = field.value, text
                await driver.settle()
                shown = " ".join(" ".join(driver.rows()[9:12]).split())
                assert message in shown
                await driver.press("f5")
                assert engine.run.phase is Phase.READY
                assert message in driver.console.status
                field.value = good

    asyncio.run(drive())


def test_what_is_typed_last_counts_for_the_start(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "f6", "shift+tab")
            await driver.type("5")
            await driver.press("f5")
            assert setup_of(engine).subject == 5
            assert "start pose: not confirmed" in driver.console.status
            await driver.press("f6", "f5")
            assert engine.run.phase is Phase.COUNTDOWN

    asyncio.run(drive())


def test_a_preset_pose_changes_sides_with_the_robot_and_typed_numbers_stay(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press(*["tab"] * 5, "right")
            assert setup_of(engine).start_pose == StartPose(-1.5, 0.0, 0.0)
            await driver.press("tab", "tab", "tab")
            await fill(driver, "-1.2")
            await driver.press(*["shift+tab"] * 4, "right")
            assert "start pose lies on the CW side" in driver.text
            assert setup_of(engine).start_pose == StartPose(-1.2, 0.0, 0.0)

    asyncio.run(drive())


def test_nothing_is_editable_once_the_countdown_runs(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.set_up()
            await driver.press("f5", "f2")
            assert "Not editable now: countdown" in driver.text
            before = engine.run.setup
            await driver.press("9", "tab", "right", "enter", "escape")
            assert engine.run.setup == before

    asyncio.run(drive())


def test_the_last_runs_settings_are_the_next_runs_proposal(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab")
            await fill(driver, "Knockers")
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("f", "a", "enter", "f2")
            assert "Draft of run 2" in driver.text
            assert phase(engine) is Phase.FINAL
            await driver.press(*["tab"] * 15, "enter")
            assert setup_of(engine).run_number == 2
            assert setup_of(engine).team == "Knockers"
            assert phase(engine) is Phase.READY

    asyncio.run(drive())


def test_a_check_is_waived_from_the_list(engine: FakeEngine) -> None:
    engine.angle = 0.2

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.set_up()
            await driver.press("shift+tab", "shift+tab", "enter")
            assert "Waive 'door closed' for this run" in driver.text
            await driver.press("3")
            assert "~ door closed     waived" in driver.text
            await driver.press("f5")
            assert engine.run.phase is Phase.COUNTDOWN

    asyncio.run(drive())


def test_a_check_that_passes_is_not_waived(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.set_up()
            await driver.press("shift+tab", "shift+tab", "enter")
            assert "no check fails" in driver.console.status
            await driver.press("up")
            assert driver.app.focused is not None
            assert driver.app.focused.id == "set-up"

    asyncio.run(drive())


def test_sides_that_must_be_set_by_hand_are_shown(engine: FakeEngine) -> None:
    engine.sides_problem = "no node /madrob/door: set the opening side to CCW at the testbed"

    async def drive() -> None:
        async with driving(engine) as driver:
            assert "! sides" in driver.text
            assert "at the testbed" in driver.text

    asyncio.run(drive())


@pytest.mark.parametrize("name", ["[red]Bots[/b]", "門 ドア 🚪", "a\\[b] 100 %"])
def test_a_team_shows_as_it_is(engine: FakeEngine, name: str) -> None:
    defaults = ConsoleDefaults(team=name, competition=f"Cup {name}", referee=name)

    async def drive() -> None:
        async with driving(engine, defaults=defaults) as driver:
            assert f"Cup {name}" in driver.rows()[1]
            await driver.run()
            cleaned = setup_of(engine).team
            assert f"run 1 of subject 1 {cleaned}" in driver.text
            engine.say(f"note: {name}")
            await driver.press("n", *name, "enter")
            engine.finish()
            await driver.settle()
            assert f"run 1 of subject 1 {cleaned}" in driver.text

    asyncio.run(drive())


def test_a_name_changed_by_cleaning_is_shown_changed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab")
            await fill(driver, "../Bots/  One")
            assert setup_of(engine).team == "Bots One"
            assert "Bots One" in driver.rows()[3]
            assert "/" not in driver.rows()[3]

    asyncio.run(drive())


def test_a_number_that_cannot_be_proposed_is_no_crash(engine: FakeEngine) -> None:
    engine.no_number = "the results folder /results cannot be read: mount it"

    async def drive() -> None:
        async with driving(engine) as driver:
            assert "the results folder /results cannot be read" in driver.text

    asyncio.run(drive())


def test_the_defaults_are_what_is_proposed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            assert DEFAULTS.team in driver.text
            assert DEFAULTS.referee in driver.text
            assert DEFAULTS.competition in driver.rows()[1]
            assert "1: pull, CCW to CW" in driver.text

    asyncio.run(drive())
