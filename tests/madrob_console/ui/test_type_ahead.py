"""No key turns against the referee: at the speed of machines, of hands, and of who looks."""

from __future__ import annotations

import asyncio

import pytest
from textual.widgets import Input

from madrob_console.engine.shown.snapshot import Pulse, RightToAct
from madrob_console.referee.acts import Abort, AddNote, DeclareTimeout, MarkIncident, Rule, Void
from madrob_console.referee.on_record import IncidentKind
from madrob_console.referee.questions import Option, Pick
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.dialog import Prompt
from madrob_console.ui.keys.key_table import KEYS
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

MACHINE, QUICK, SLOW = 0.0, 0.15, 1.0
"""Between two keys: a script, a quick hand, a slow one, s."""


async def stop_the_run(driver: Driver) -> None:
    """The run completes by itself while nobody looks."""
    driver.engine.finish()
    await driver.settle()


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
def test_an_abort_is_answered_as_fast_as_it_can_be_typed(engine: FakeEngine, gap: float) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            driver.hand.gap = gap
            await driver.press("f8", "1", "y")
            assert engine.acts[-1] == Abort("robot unsafe")

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
@pytest.mark.parametrize("keys", [("1", "y"), ("2", "2", "y"), ("o", "x", "enter", "y")])
def test_what_answers_an_abort_is_nothing_else_once_the_run_is_over(
    engine: FakeEngine, gap: float, keys: tuple[str, ...]
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            acts = list(engine.acts)
            await driver.press("f8")
            await stop_the_run(driver)
            assert "NOT POSSIBLE ANY MORE: the run has stopped" in driver.text
            driver.hand.gap = gap
            await driver.press(*keys)
            assert engine.acts == acts
            assert engine.run.outcome is Outcome.COMPLETED

    asyncio.run(drive())


def test_who_confirms_an_abort_that_came_too_late_is_asked_about_voiding_the_run(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            acts = list(engine.acts)
            await driver.press("f8", "1")
            await stop_the_run(driver)
            driver.hand.gap = QUICK
            driver.hand.now += SLOW
            await driver.press("y", "y")
            assert "The run was over before the abort (robot unsafe)" in driver.text
            assert engine.acts == acts  # the second y was typed before that could be seen
            driver.hand.gap = SLOW
            await driver.press("y")
            assert engine.acts[-1] == Void("robot unsafe")

    asyncio.run(drive())


def test_the_dialog_over_a_run_that_has_completed_closes_with_enter(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            await stop_the_run(driver)
            await driver.press("enter")
            assert not driver.console.dialogs
            await driver.settle()
            assert driver.console.pane == "results"

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
def test_a_refused_key_never_lets_the_next_letters_mean_something_else(
    engine: FakeEngine, gap: float
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await stop_the_run(driver)
            acts = list(engine.acts)
            await driver.press("escape")
            driver.hand.gap = gap
            await driver.press("f9")
            assert "Refused: declare timeout: the run has stopped" in driver.console.status
            await driver.press("2")
            assert "F9 was refused: the run has stopped" in driver.console.status
            await driver.press("enter", "f9", "2", "y")
            assert engine.acts == acts
            assert not driver.console.dialogs

    asyncio.run(drive())


def test_after_a_refusal_and_a_pause_letters_are_keys_again(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await stop_the_run(driver)
            await driver.press("f9", "2")
            assert "Step 2" in driver.text
            await driver.press("escape")
            driver.hand.gap = QUICK
            await driver.press("f9", "escape", "2")
            assert "Step 2" in driver.text

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
def test_a_refused_start_leaves_the_field_so_that_no_key_is_typed_into_it(
    engine: FakeEngine, gap: float
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "shift+tab", "tab", "tab", "tab")
            team = driver.console.query_one("#team", Input)
            driver.console.set_focus(team)
            before = team.value
            await driver.settle()
            driver.hand.gap = gap
            await driver.press("f5")
            assert "Refused: start" in driver.console.status
            await driver.press("n", *"robot", "enter", "f9", "2", "y")
            assert team.value == before
            assert not any(isinstance(act, DeclareTimeout) for act in engine.acts)

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
@pytest.mark.parametrize("key", ["3", "y", "n", "r"])
def test_a_key_typed_as_the_result_comes_is_left_out_unless_there_was_time_to_see_it(
    engine: FakeEngine, gap: float, key: str
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            acts = list(engine.acts)
            await stop_the_run(driver)
            driver.hand.gap = gap
            await driver.press(key)
            if gap < 0.3:
                assert "is left out: the result has just come" in driver.console.status
                assert not driver.console.dialogs
            assert engine.acts == acts

    asyncio.run(drive())


def test_the_key_that_aborts_counts_whatever_has_just_changed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.set_up()
            await driver.press("f5")
            driver.hand.gap = MACHINE
            await driver.let_pass(6.0)
            await driver.press("f8", "1", "y")
            assert engine.acts[-1] == Abort("robot unsafe")

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK])
@pytest.mark.parametrize(
    ("opens", "text"), [("f", "Team satisfied"), ("4", "robot did not cross"), ("f", "absent bots")]
)
def test_a_text_typed_into_a_choice_is_no_answer_and_no_other_text(
    engine: FakeEngine, gap: float, opens: str, text: str
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await stop_the_run(driver)
            acts = list(engine.acts)
            await driver.press(opens)
            driver.hand.gap = gap
            await driver.type(text)
            (dialog,) = driver.console.dialogs
            assert engine.acts == acts
            assert dialog.query_one(Input).value == ""
            if not text.startswith("a"):  # "a" is an answer
                assert dialog.query_one(Prompt).answers == ()

    asyncio.run(drive())


@pytest.mark.parametrize("gap", [MACHINE, QUICK])
def test_the_rest_of_a_word_that_answered_is_no_key(engine: FakeEngine, gap: float) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f9", "1")
            driver.hand.gap = gap
            await driver.type("yes")
            assert engine.acts[-1] == DeclareTimeout("the team gives up")
            assert driver.console.pane == "live"
            assert not driver.console.dialogs

    asyncio.run(drive())


def test_a_ruling_says_that_the_sensors_have_found_the_step_meanwhile(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("1", "d")
            engine.do_step(Step.TOUCH)
            driver.hand.gap = MACHINE
            await driver.settle()
            assert "This has changed meanwhile: look again." in driver.text
            await driver.press("1")
            assert "is left out: the question has just changed" in driver.text
            driver.hand.gap = SLOW
            await driver.press("1", "y")
            assert engine.acts[-1] == Rule(
                Step.TOUCH, confirmed=False, reason="seen by the referee"
            )

    asyncio.run(drive())


def test_a_text_that_is_being_typed_survives_a_moment_in_which_it_is_not_possible(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("n", *"cable")
            engine.right = RightToAct(holder="bo@tent")
            await driver.settle()
            assert "NOT POSSIBLE ANY MORE: bo@tent has the right to act" in driver.text
            await driver.press("x", "y")
            engine.right = RightToAct()
            await driver.settle()
            await driver.press("s", "enter")
            assert engine.acts[-1] == AddNote("cables")

    asyncio.run(drive())


def test_a_note_goes_on_while_the_run_ends(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("n", "a")
            driver.hand.gap = QUICK
            await driver.press("b")
            await stop_the_run(driver)
            await driver.press("c", "enter")
            assert engine.acts[-1] == AddNote("abc")

    asyncio.run(drive())


@pytest.mark.parametrize(
    "opens", ["f8", "f9", "i", "1", "n", "a", "r", "w", "f", "u", "x", "v", "c", "z", "t"]
)
def test_enter_alone_does_nothing_in_any_dialog(engine: FakeEngine, opens: str) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            for phase in range(4):
                if phase == 0:
                    await driver.press("f2", "enter", "f3")
                elif phase == 1:
                    await driver.press("f6", "f5")
                    engine.false_start()
                elif phase == 2:
                    await driver.let_pass(6.0)
                    await driver.press("i", "c")
                else:
                    await stop_the_run(driver)
                before = engine.run
                await driver.press(opens)
                if driver.console.dialogs:
                    await driver.press("enter")
                    assert engine.run == before
                    assert driver.app.is_running
                    for _ in driver.console.dialogs.copy():
                        await driver.press("escape")
                elif engine.run != before:
                    assert KEYS["restart"].keys == opens  # a false start says why
                    engine.run = before

    asyncio.run(drive())


def test_every_choice_begins_with_what_does_nothing() -> None:
    pick = Pick(
        "Why?", (Option("1", "a reason", "a reason"), Option("o", "other", None, free=True))
    )
    assert pick.options[0].harmless
    with pytest.raises(ValueError, match="comes first"):
        Pick("Why?", (pick.options[1], Option("l", "later", None)))


def test_an_incident_is_one_of_now_while_the_run_goes_on_and_asks_for_its_time_after_it(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("i", "c")
            assert engine.run.incidents[-1].time == engine.now
            await driver.let_pass(20.0)
            await stop_the_run(driver)
            acts = list(engine.acts)
            await driver.press("i", "f")
            assert "When? Seconds from the start of the run" in driver.text
            await driver.press("enter")
            assert "its time is needed: the run has stopped" in driver.text
            await driver.type("later")
            await driver.press("enter")
            assert "'later' is no time" in driver.text
            assert engine.acts == acts
            await driver.press(*["backspace"] * 5)
            await driver.type("0:12.5")
            await driver.press("enter")
            assert engine.acts[-1] == MarkIncident(IncidentKind.FALL, after_start=12.5)
            start = engine.run.start
            assert start is not None
            assert engine.run.incidents[-1].time == start + 12.5
            await driver.press("i", "f")
            await driver.type("-60")
            await driver.press("enter")
            assert "the recording began at -5.0 s" in driver.console.status

    asyncio.run(drive())


def test_a_console_whose_engine_has_ended_refuses_with_that_and_leaves_without_a_question(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            engine.failure = "the engine has ended"
            await driver.settle()
            assert "NOT POSSIBLE ANY MORE: the engine has ended" in driver.text
            await driver.press("enter", "i")
            assert driver.console.status == "Refused: mark an incident: the engine has ended"
            assert engine.run.phase is Phase.RUNNING
            await driver.press("f10")
            assert not driver.app.is_running

    asyncio.run(drive())


def test_leaving_a_silent_engine_says_that_nobody_knows(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.pulse = Pulse(server=4)
            await driver.press("f10")
            assert "Nobody can say whether the run goes on" in driver.text
            await driver.press("enter")
            assert driver.app.is_running

    asyncio.run(drive())


def test_a_field_is_typed_into_only_where_that_was_chosen(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await stop_the_run(driver)
            await driver.press("x", "y")
            assert driver.console.pane == "setup"
            assert not isinstance(driver.app.focused, Input)
            await driver.press("f2")
            assert isinstance(driver.app.focused, Input)
            await driver.press("escape", "n")
            await driver.type("ok")
            await driver.press("enter")
            assert engine.acts[-1] == AddNote("ok")
            assert not isinstance(driver.app.focused, Input)
            await driver.press("enter")  # sets up, as the button says
            assert driver.console.query_one("#subject", Input).value == "1"

    asyncio.run(drive())
