from __future__ import annotations

import asyncio

import pytest

from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import (
    Abort,
    AddNote,
    Correct,
    Finalise,
    MarkIncident,
    Rule,
    Start,
)
from madrob_console.referee.on_record import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.teams import TeamList
from scoring.protocol import Outcome, Side, Step
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup

SLIPS = [
    ["f8", "f8"],
    ["f8", "f8", "f8", "enter"],
    ["f8", "enter"],
    ["f8", "enter", "enter"],
    ["f8", "y"],
    ["f8", "n"],
    ["f8", "escape"],
    ["f8", "1", "enter"],
    ["f8", "1", "f8", "enter", "enter"],
    ["f8", "1", "escape"],
    ["f8", "1", "n"],
    ["f8", "down", "enter", "enter"],
    ["f8", "o", "x", "enter", "enter"],
    ["f8", "o", "enter", "enter", "escape"],
    ["f8", "space", "tab", "enter"],
    ["escape", "escape"],
    ["f9", "f9", "enter", "f9", "1", "enter"],
    ["f9", "f8", "escape", "escape"],
    ["f10", "enter"],
    ["f10", "n"],
    ["ctrl+c", "escape"],
    ["ctrl+q", "enter"],
    ["f5", "f5"],
]


@pytest.mark.slow
def test_no_slip_ends_a_run(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            acts = list(engine.acts)
            for keys in SLIPS:
                await driver.press(*keys)
                assert engine.run.phase is Phase.RUNNING, keys
                assert engine.acts == acts, keys
                assert driver.app.is_running, keys
                for _ in driver.console.dialogs.copy():
                    await driver.press("escape")

    asyncio.run(drive())


def test_abort_is_confirmed_by_y_after_a_reason(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            assert "ABORT the run" in driver.text
            assert "> n no, the run goes on" in driver.text
            await driver.press("1")
            assert "chosen: robot unsafe" in driver.text
            await driver.press("y")
            assert engine.run.outcome is Outcome.ABORTED
            assert engine.run.outcome_reason == "robot unsafe"

    asyncio.run(drive())


def test_the_reason_can_be_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "o", "enter")
            assert "a reason is needed" in driver.text
            await driver.type("smoke, [b]much[")
            await driver.press("enter", "y")
            assert engine.acts[-1] == Abort("smoke, [b]much[")

    asyncio.run(drive())


def test_the_clock_stays_in_view_and_runs_on_under_a_dialog(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            before = driver.rows()[2:5]
            await driver.let_pass(2.0)
            assert driver.rows()[2:5] != before
            assert "4:57 left" in driver.text

    asyncio.run(drive())


def test_abort_comes_before_a_note_that_is_being_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("n", "a", "f8", "1", "y")
            assert engine.run.outcome is Outcome.ABORTED
            await driver.press("b", "enter")
            assert engine.acts[-1] == AddNote("ab")

    asyncio.run(drive())


def test_other_keys_wait_for_the_open_question(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("i", "f9", "f2")
            assert "A question is open" in driver.console.status
            assert driver.console.pane == "live"
            assert len(driver.console.dialogs) == 1

    asyncio.run(drive())


def test_an_act_that_came_too_late_is_refused_in_words(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "1")
            engine.finish()
            await driver.press("y")
            assert engine.run.outcome is Outcome.COMPLETED
            assert "Refused: abort: the run has stopped" in driver.console.status

    asyncio.run(drive())


@pytest.mark.parametrize(("answer", "void"), [("y", True), ("enter", False)])
def test_an_abort_that_came_too_late_offers_to_void_the_run(
    engine: FakeEngine, answer: str, void: bool
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "1")
            engine.finish()
            await driver.press("y")
            (dialog,) = driver.console.dialogs
            assert "The run was over before the abort (robot unsafe)" in dialog.ask.title
            asked = [row for row in driver.rows() if row.startswith("│")]
            assert any("run 1 of subject 1 Door Bots" in row for row in asked)  # whole
            await driver.press(answer)
            assert (engine.run.voided is not None) is void
            assert driver.console.dialogs == []

    asyncio.run(drive())


def test_a_void_and_a_correction_are_made_and_taken_back_by_keys(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("v", "2", "y")
            assert engine.run.voided is not None
            assert engine.run.voided.reason == "testbed fault"
            await driver.press("v")
            assert "Refused: void: the run is void already" in driver.console.status
            await driver.press("c", "t", "1", "y")
            setup = engine.run.setup
            assert setup is not None
            assert setup.condition.starting_side is Side.CW
            await driver.press("c", "s")
            await driver.type("12x")
            await driver.press("enter")
            assert "subject '12x': use a number" in driver.text
            await driver.press("escape", "z", "1", "y", "z", "1", "y")
            assert engine.run.valid
            assert engine.run.setup == engine.run.set_up_as
            assert len(engine.run.taken_back) == 2
            await driver.press("z")
            assert "Refused: take back: there is nothing to take back" in driver.console.status

    asyncio.run(drive())


def test_among_many_runs_the_letter_of_void_is_theirs(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("h", "v")
            assert driver.console.dialogs == []
            assert "Refused" not in driver.console.status

    asyncio.run(drive())


def test_a_ruling_shows_what_the_sensors_and_the_referee_say(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.do_step(Step.TOUCH)
            await driver.press("1")
            assert "Sensors: 1.000 s. Referee: nothing yet." in driver.text
            await driver.press("down", "down", "enter", "o")
            await driver.type("only brushed")
            await driver.press("enter", "y")
            assert engine.acts[-1] == Rule(Step.TOUCH, confirmed=False, reason="only brushed")

    asyncio.run(drive())


def test_leaving_asks_while_a_run_goes_on_and_while_its_result_is_not_final(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f10")
            assert "LEAVE the console while a run goes on" in driver.text
            await driver.press("y")
            assert not driver.app.is_running
        engine.finish()
        async with driving(engine) as driver:
            await driver.press("f10")
            assert "the history (h) opens it later" in driver.text
            await driver.press("n", "f", "a", "enter", "ctrl+c")
            assert not driver.app.is_running
        assert not engine.closed  # who opened the client closes it

    asyncio.run(drive())


def test_next_run_asks_while_the_result_is_not_final(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("x")
            assert "The last result is not final" in driver.text
            await driver.press("enter")
            assert engine.acts[-1] == Start()
            await driver.press("x", "y")
            assert engine.run.phase is Phase.READY
            assert driver.console.pane == "setup"

    asyncio.run(drive())


def test_after_an_abort_the_next_run_is_one_key_away(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8", "1", "y")
            engine.score()
            await driver.settle()
            await driver.press("x")
            assert engine.run.phase is Phase.READY
            assert engine.run.setup is not None
            assert engine.run.setup.run_number == 2

    asyncio.run(drive())


def test_finalising_asks_for_the_name_where_none_was_set(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab", "tab", "backspace")
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("f", "a", "enter", "enter")
            assert "finalising needs the referee's name" in driver.text
            await driver.type("Bo")
            await driver.press("enter")
            assert engine.run.closure is not None
            assert engine.run.closure.referee == "Bo"
            assert "final: acknowledged by the team, signed Bo" in driver.text

    asyncio.run(drive())


SIGNED_SO = "1 false start UNDECIDED (handle touched)"


async def with_a_false_start(driver: Driver) -> None:
    """A run is over; nobody has decided about its false start."""
    await driver.set_up()
    await driver.press("f5")
    driver.engine.false_start()
    await driver.let_pass(6.0)
    await driver.press("i", "f")
    driver.engine.finish()
    await driver.settle()


def test_what_is_undecided_is_seen_before_a_result_is_final(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await with_a_false_start(driver)
            await driver.press("f")
            for words in (
                "Before it is final: completed, steps that count: none",
                f"! {SIGNED_SO}: a accepts it with a reason",
                "1 incident (fall)",
                "> n no: decide first",
            ):
                assert words in driver.text
            await driver.press("escape", "x")
            assert f"The last result is not final, {SIGNED_SO}: it stays" in (
                " ".join(driver.text.replace("│", " ").split())
            )
            await driver.press("n", "f")
            before = list(engine.acts)
            await driver.press("a", "p", "b", "enter")  # neither a team's word nor a yes
            assert engine.acts == before
            assert not driver.console.dialogs
            await driver.press("f", "y", "a", "enter")
            assert engine.acts[-1] == Finalise(TeamWord.ACKNOWLEDGED, "Ada", "", (SIGNED_SO,))

    asyncio.run(drive())


@pytest.mark.parametrize("size", [(80, 24), (120, 36), (60, 18)])
def test_with_nothing_undecided_the_list_stands_above_the_teams_word(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size=size) as driver:
            await with_a_false_start(driver)
            await driver.press("a", "1", "5", "d", "1", "y", "f")
            for words in (
                "Before it is final: completed, steps that count:",
                "step 5 denied; 1 incident (fall); 1 false start accepted",
                "What does the team say?",
                "> n nothing yet: do not finalise",
                "b absent",
            ):
                assert words in " ".join(driver.text.replace("│", " ").split()), driver.text
            await driver.press("a", "enter")  # the same keys as without a list
            assert engine.acts[-1] == Finalise(TeamWord.ACKNOWLEDGED, "Ada")

    asyncio.run(drive())


def test_with_nothing_to_be_seen_signing_asks_no_more_than_the_team(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            engine.kind = SourceKind.ROS
            await driver.run()
            engine.finish()
            await driver.settle()
            await driver.press("f")
            assert "Before it is final" not in driver.text
            assert "What does the team say?" in driver.text

    asyncio.run(drive())


def test_another_incident_is_said_in_words_and_stands_where_its_kind_was_chosen(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.let_pass(2.0)
            await driver.press("i", "o")
            assert "What happened?" in driver.text
            chosen = engine.snapshot().elapsed
            await driver.let_pass(3.0)
            await driver.press("enter")
            assert "say what happened" in driver.text
            await driver.type("dog on the field")
            await driver.press("enter")
            other = IncidentKind.OTHER
            assert engine.acts[-1] == MarkIncident(other, "dog on the field", chosen)
            assert "Done: other marked at +" in driver.console.status
            assert driver.console.status.count("dog on the field") == 1
            engine.finish()
            await driver.settle()
            await driver.press("i", "o", "l", "a", "m", "p", "enter", *"1:05", "enter")
            assert engine.acts[-1] == MarkIncident(other, "lamp", 65.0)

    asyncio.run(drive())


def test_another_subject_is_shown_with_its_team_before_it_is_corrected(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            engine.teams = TeamList({1: "Delft", 4: "Graz"})
            await driver.settle()
            await driver.press("c", "s", "4", "enter")
            assert "Correct the subject from 1 to 4, Graz" in driver.text
            await driver.press("1")
            assert "Correct the subject from 1 to 4, Graz" in driver.text
            await driver.press("y")
            assert engine.acts[-1] == Correct(4, a_setup().condition, "typed wrongly")

    asyncio.run(drive())
