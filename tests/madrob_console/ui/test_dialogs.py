from __future__ import annotations

from collections.abc import Sequence

import pytest
from textual.widgets import Input

from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.acts import (
    Abort,
    AddNote,
    Correct,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Rule,
    TakeBack,
    Void,
)
from madrob_console.referee.acts.act import Option, Pick
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome, Side, Step
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine, a_setup

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
async def test_no_slip_ends_a_run(running: Driver, engine: FakeEngine) -> None:
    acts = list(engine.acts)
    for keys in SLIPS:
        await running.press(*keys)
        assert engine.run.phase is Phase.RUNNING, keys
        assert engine.acts == acts, keys
        assert running.app.is_running, keys
        for _ in running.console.dialogs.copy():
            await running.press("escape")


async def test_abort_is_confirmed_by_y_after_a_reason(running: Driver, engine: FakeEngine) -> None:
    await running.press("f8")
    assert "ABORT the run" in running.text
    assert "> n no, the run goes on" in running.text
    await running.press("1")
    assert "chosen: robot unsafe" in running.text
    await running.press("y")
    assert engine.run.outcome is Outcome.ABORTED
    assert engine.run.outcome_reason == "robot unsafe"


async def test_the_reason_can_be_typed(running: Driver, engine: FakeEngine) -> None:
    await running.press("f8", "o", "enter")
    assert "a reason is needed" in running.text
    await running.type("smoke, [b]much[")
    await running.press("enter", "y")
    assert engine.acts[-1] == Abort("smoke, [b]much[")


async def test_the_clock_stays_in_view_and_runs_on_under_a_dialog(running: Driver) -> None:
    await running.press("f8")
    before = running.rows()[2:5]
    await running.let_pass(2.0)
    assert running.rows()[2:5] != before
    assert "4:57 left" in running.text


async def test_abort_comes_before_a_note_that_is_being_typed(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("i", "n", "a", "f8", "1", "y")
    assert engine.run.outcome is Outcome.ABORTED
    await running.press("b", "enter")
    assert engine.acts[-1] == AddNote("ab")


async def test_other_keys_wait_for_the_open_question(running: Driver) -> None:
    await running.press("i", "f9", "f2")
    assert "A question is open" in running.console.status
    assert running.console.pane == "live"
    assert len(running.console.dialogs) == 1


async def test_an_act_that_came_too_late_is_refused_in_words(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("f8", "1")
    engine.finish()
    await running.press("y")
    assert engine.run.outcome is Outcome.COMPLETED
    assert "Refused: abort: the run has stopped" in running.console.status


@pytest.mark.parametrize(("answer", "void"), [("y", True), ("enter", False)])
async def test_an_abort_that_came_too_late_offers_to_void_the_run(
    running: Driver, engine: FakeEngine, answer: str, void: bool
) -> None:
    await running.press("f8", "1")
    engine.finish()
    await running.press("y")
    (dialog,) = running.console.dialogs
    assert "The run was over before the abort (robot unsafe)" in dialog.ask.title
    asked = [row for row in running.rows() if row.startswith("│")]
    assert any("run 1 of subject 1 Door Bots" in row for row in asked)  # whole
    await running.press(answer)
    assert (engine.run.voided is not None) is void
    assert running.console.dialogs == []


async def test_a_void_and_a_correction_are_made_and_taken_back_by_keys(
    running: Driver, engine: FakeEngine
) -> None:
    await running.finish()
    await running.press("enter", "v", "2")
    assert engine.run.voided is not None
    assert engine.run.voided.reason == "testbed fault"
    assert "z takes it back" in running.console.status
    await running.press("enter")
    assert "Not now: v void: the run is void already" in running.text
    await running.press("c", "t", "1")
    setup = engine.run.setup
    assert setup is not None
    assert setup.condition.starting_side is Side.CW
    await running.press("enter", "c", "s")
    await running.type("12x")
    await running.press("enter")
    assert "subject '12x': use a number" in running.text
    await running.press("escape", "z", "1", "z", "1")
    assert engine.run.valid
    assert engine.run.setup == engine.run.set_up_as
    assert len(engine.run.taken_back) == 2
    await running.press("z")
    assert "Refused: take back: there is nothing to take back" in running.console.status


async def test_among_many_runs_the_letter_of_void_is_theirs(
    running: Driver, engine: FakeEngine
) -> None:
    await running.finish()
    await running.press("h", "v")
    assert running.console.dialogs == []
    assert "Refused" not in running.console.status


async def test_a_ruling_shows_what_the_sensors_and_the_referee_say(
    running: Driver, engine: FakeEngine
) -> None:
    engine.do_step(Step.TOUCH)
    await running.press("1")
    assert "Sensors: 1.000 s. Referee: nothing yet." in running.text
    await running.press("r", "o")
    await running.type("only brushed")
    await running.press("enter", "down", "down", "enter")
    assert engine.acts[-1] == Rule(Step.TOUCH, confirmed=False, reason="only brushed")


async def test_leaving_asks_while_a_run_goes_on_and_only_then(
    engine: FakeEngine,
) -> None:
    async with driving(engine) as driver:
        await driver.run()
        await driver.press("f10")
        assert "LEAVE the console while a run goes on" in driver.text
        await driver.press("y")
        assert not driver.app.is_running
    engine.finish()
    async with driving(engine) as driver:
        await driver.press("f10")
        assert not driver.app.is_running
    assert not engine.closed  # who opened the client closes it


async def test_the_next_run_says_that_the_result_before_is_not_final(
    running: Driver, engine: FakeEngine
) -> None:
    await running.finish()
    await running.press("x")
    assert "the result before is not final: h opens it" in running.console.status
    assert engine.run.phase is Phase.READY
    assert running.console.pane == "setup"


async def test_after_an_abort_the_next_run_is_one_key_away(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("f8", "1", "y")
    engine.score()
    await running.settle()
    await running.press("x")
    assert engine.run.phase is Phase.READY
    assert engine.run.setup is not None
    assert engine.run.setup.run_number == 2


async def test_finalising_asks_for_the_name_where_none_was_set(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press(*["tab"] * 7, "enter", "shift+tab", "backspace")
    await driver.run()
    await driver.finish()
    await driver.press("enter", "f", "a", "enter", "enter")
    assert "finalising needs the referee's name" in driver.text
    await driver.type("Bo")
    await driver.press("enter")
    assert engine.run.closure is not None
    assert engine.run.closure.referee == "Bo"
    assert "final: acknowledged by the team, signed Bo" in driver.text


SIGNED_SO = "1 false start UNDECIDED (handle touched)"


async def with_a_false_start(driver: Driver) -> None:
    """A run is over; nobody has decided about its false start."""
    await driver.set_up()
    await driver.press("f5")
    driver.engine.false_start()
    await driver.let_pass(6.0)
    await driver.press("i", "f")
    await driver.finish()


async def test_what_is_undecided_is_seen_before_a_result_is_final(
    driver: Driver, engine: FakeEngine
) -> None:
    await with_a_false_start(driver)
    await driver.press("enter", "f")
    for words in (
        "Before it is final: completed, steps that count: 1, 2, 3, 4, 5, 6",
        f"! {SIGNED_SO}",
        "1 incident (fall)",
        "> n no: decide first",
    ):
        assert words in driver.text
    before = list(engine.acts)
    await driver.press("a", "p", "b", "enter")  # neither a team's word nor a yes
    assert engine.acts == before
    assert not driver.console.dialogs
    await driver.press("enter", "f", "y", "a", "enter")
    assert engine.acts[-1] == Finalise(TeamWord.ACKNOWLEDGED, "Ada", "", (SIGNED_SO,))


@pytest.mark.parametrize("size", [(80, 24), (120, 36), (60, 18)])
async def test_with_nothing_undecided_the_list_stands_above_the_teams_word(
    driver: Driver, engine: FakeEngine
) -> None:
    await with_a_false_start(driver)
    await driver.press("enter", "a", "1", "5", "d", "enter", "f")
    for words in (
        "Before it is final: completed, steps that count:",
        "- step 5 denied; 1 false start accepted; SIMULATED: not an official result;",
        "1 incident (fall)",
        "What does the team say?",
        "> n nothing yet: do not finalise",
        "b absent",
    ):
        assert words in " ".join(driver.text.replace("│", " ").split()), driver.text
    await driver.press("a", "enter")  # the same keys as without a list
    assert engine.acts[-1] == Finalise(TeamWord.ACKNOWLEDGED, "Ada")


async def test_with_nothing_to_be_seen_signing_asks_no_more_than_the_team(
    driver: Driver, engine: FakeEngine
) -> None:
    engine.kind = SourceKind.ROS
    await driver.run()
    await driver.finish()
    await driver.press("enter", "f")
    assert "Before it is final" not in driver.text
    assert "What does the team say?" in driver.text


async def test_another_incident_is_said_in_words_and_stands_where_its_kind_was_chosen(
    running: Driver, engine: FakeEngine
) -> None:
    await running.let_pass(2.0)
    await running.press("i", "o")
    assert "What happened?" in running.text
    chosen = engine.snapshot().elapsed
    await running.let_pass(3.0)
    await running.press("enter")
    assert "say what happened" in running.text
    await running.type("dog on the field")
    await running.press("enter")
    other = IncidentKind.OTHER
    assert engine.acts[-1] == MarkIncident(other, "dog on the field", chosen)
    assert "Done: other marked at +" in running.console.status
    assert running.console.status.count("dog on the field") == 1
    await running.finish()
    await running.press("i", "o", "l", "a", "m", "p", "enter", *"1:05", "enter")
    assert engine.acts[-1] == MarkIncident(other, "lamp", 65.0)


async def test_another_subject_is_shown_with_its_team_before_it_is_corrected(
    running: Driver, engine: FakeEngine
) -> None:
    await running.finish()
    engine.teams = TeamList({1: "Delft", 4: "Graz"})
    await running.settle()
    await running.press("enter", "c", "s", "4", "enter")
    assert "Correct the subject from 1 to 4, Graz" in running.text
    await running.press("1")
    assert engine.acts[-1] == Correct(4, a_setup().condition, "typed wrongly")


async def test_a_text_of_a_question_that_was_closed_does_not_come_back(
    running: Driver, engine: FakeEngine
) -> None:
    await running.finish()
    await running.press("enter", "c", "s", "9", "9", "enter", "escape", "enter", "c", "s")
    (dialog,) = running.console.dialogs
    assert dialog.query_one(Input).value == ""
    await running.press("3", "enter", "enter", "enter")  # no name, then the first reason
    assert isinstance(act := engine.acts[-1], Correct)
    assert act.subject == 3


async def test_the_menu_takes_the_keys_that_its_first_line_names(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("enter")
    assert "1-6 confirm or deny a step; i mark an incident" in running.text
    assert "z take back" not in running.text
    await running.press("4", "d", "enter", "i", "c", "enter", "z", "enter")
    assert [type(act) for act in engine.acts[-3:]] == [Rule, MarkIncident, TakeBack]
    assert engine.run.incidents == ()


async def test_a_question_leaves_the_footer_the_keys_that_work(running: Driver) -> None:
    await running.press("i")
    assert running.rows()[-1] == "a question is open  F8 ABORT  F10 Leave"
    await running.press("escape")
    assert running.rows()[-1].startswith("F8 ABORT  F9 Timeout")


MACHINE, QUICK, SLOW = 0.0, 0.15, 1.0
"""Between two keys: a script, a quick hand, a slow one, s."""


async def stop_the_run(driver: Driver) -> None:
    """The run completes by itself while nobody looks."""
    await driver.finish()


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
async def test_an_abort_is_answered_as_fast_as_it_can_be_typed(
    running: Driver, engine: FakeEngine, gap: float
) -> None:
    running.hand.gap = gap
    await running.press("f8", "1", "y")
    assert engine.acts[-1] == Abort("robot unsafe")


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
@pytest.mark.parametrize("keys", [("1", "y"), ("2", "2", "y"), ("o", "x", "enter", "y")])
async def test_what_answers_an_abort_is_nothing_else_once_the_run_is_over(
    running: Driver, engine: FakeEngine, gap: float, keys: tuple[str, ...]
) -> None:
    acts = list(engine.acts)
    await running.press("f8")
    await stop_the_run(running)
    assert "NOT POSSIBLE ANY MORE: the run has stopped" in running.text
    running.hand.gap = gap
    await running.press(*keys)
    assert engine.acts == acts
    assert engine.run.outcome is Outcome.COMPLETED


async def test_who_confirms_an_abort_that_came_too_late_is_asked_about_voiding_the_run(
    running: Driver, engine: FakeEngine
) -> None:
    acts = list(engine.acts)
    await running.press("f8", "1")
    await stop_the_run(running)
    running.hand.gap = QUICK
    running.hand.now += SLOW
    await running.press("y", "y")
    assert "The run was over before the abort (robot unsafe)" in running.text
    assert engine.acts == acts  # the second y was typed before that could be seen
    running.hand.gap = SLOW
    await running.press("y")
    assert engine.acts[-1] == Void("robot unsafe")


async def test_the_dialog_over_a_run_that_has_completed_closes_with_enter(running: Driver) -> None:
    await running.press("f8")
    await stop_the_run(running)
    await running.press("enter")
    assert not running.console.dialogs
    await running.settle()
    assert running.console.pane == "results"


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
async def test_a_refused_key_never_lets_the_next_letters_mean_something_else(
    running: Driver, engine: FakeEngine, gap: float
) -> None:
    await stop_the_run(running)
    acts = list(engine.acts)
    await running.press("escape")
    running.hand.gap = gap
    await running.press("f9")
    assert "Refused: declare timeout: the run has stopped" in running.console.status
    await running.press("2")
    assert "F9 was refused: the run has stopped" in running.console.status
    await running.press("enter", "f9", "2", "y")
    assert engine.acts == acts
    assert not running.console.dialogs


async def test_after_a_refusal_and_a_pause_letters_are_keys_again(running: Driver) -> None:
    await stop_the_run(running)
    await running.press("f9", "2")
    assert "Step 2" in running.text
    await running.press("escape")
    running.hand.gap = QUICK
    await running.press("f9", "escape", "2")
    assert "Step 2" in running.text


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
async def test_a_refused_start_leaves_the_field_so_that_no_key_is_typed_into_it(
    driver: Driver, engine: FakeEngine, gap: float
) -> None:
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


@pytest.mark.parametrize("gap", [MACHINE, QUICK, SLOW])
@pytest.mark.parametrize("key", ["3", "y", "i", "enter"])
async def test_a_key_typed_as_the_result_comes_is_left_out_unless_there_was_time_to_see_it(
    running: Driver, engine: FakeEngine, gap: float, key: str
) -> None:
    acts = list(engine.acts)
    await stop_the_run(running)
    running.hand.gap = gap
    await running.press(key)
    if gap < 0.3:
        assert "is left out: the result has just come" in running.console.status
        assert not running.console.dialogs
    assert engine.acts == acts


async def test_the_key_that_aborts_counts_whatever_has_just_changed(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.set_up()
    await driver.press("f5")
    driver.hand.gap = MACHINE
    await driver.let_pass(6.0)
    await driver.press("f8", "1", "y")
    assert engine.acts[-1] == Abort("robot unsafe")


@pytest.mark.parametrize("gap", [MACHINE, QUICK])
@pytest.mark.parametrize(
    ("opens", "text"),
    [
        (("enter", "f"), "Team satisfied"),
        (("4",), "the robot did not cross"),
        (("enter", "f"), "absent bots"),
        (("enter",), "bots satisfied"),
    ],
)
async def test_a_text_typed_into_a_choice_is_no_answer_and_no_other_text(
    running: Driver, engine: FakeEngine, gap: float, opens: Sequence[str], text: str
) -> None:
    await stop_the_run(running)
    acts = list(engine.acts)
    await running.press(*opens)
    running.hand.gap = gap
    await running.type(text)
    (dialog,) = running.console.dialogs
    assert engine.acts == acts
    assert dialog.query_one(Input).value == ""
    if not text.startswith("a"):  # "a" is an answer
        assert dialog.answers == []


@pytest.mark.parametrize("gap", [MACHINE, QUICK])
async def test_the_rest_of_a_word_that_answered_is_no_key(
    running: Driver, engine: FakeEngine, gap: float
) -> None:
    await running.press("f9", "1")
    running.hand.gap = gap
    await running.type("yes")
    assert engine.acts[-1] == DeclareTimeout("the team gives up")
    assert running.console.pane == "live"
    assert not running.console.dialogs


async def test_a_ruling_is_two_keys_also_when_the_sensors_find_the_step_meanwhile(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("1")
    assert "passage sensors" in running.text
    assert "Sensors: not done" in running.text
    engine.do_step(Step.TOUCH)
    running.hand.gap = MACHINE
    await running.settle()
    assert "Sensors: 1.000 s" in running.text
    await running.press("d")
    assert engine.acts[-1] == Rule(Step.TOUCH, confirmed=False, reason="seen by the referee")


async def test_a_text_that_is_being_typed_survives_a_moment_in_which_it_is_not_possible(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("i", "n", *"cable")
    engine.right = RightToAct(holder="bo@tent")
    await running.settle()
    assert "NOT POSSIBLE ANY MORE: bo@tent has the right to act" in running.text
    await running.press("x", "y")
    engine.right = RightToAct()
    await running.settle()
    await running.press("s", "enter")
    assert engine.acts[-1] == AddNote("cables")


async def test_a_note_goes_on_while_the_run_ends(running: Driver, engine: FakeEngine) -> None:
    await running.press("i", "n", "a")
    running.hand.gap = QUICK
    await running.press("b")
    await stop_the_run(running)
    await running.press("c", "enter")
    assert engine.acts[-1] == AddNote("abc")


@pytest.mark.parametrize(
    "opens",
    ["f8", "f9", "i", "1", "enter", "enter n", "enter f", "enter u", "enter c", "enter P"],
)
async def test_enter_alone_does_nothing_that_cannot_be_taken_back(
    driver: Driver, engine: FakeEngine, opens: str
) -> None:
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
        await driver.press(*opens.split())
        if driver.console.dialogs:
            await driver.press("enter")
            assert engine.run == before
            assert driver.app.is_running
            for _ in driver.console.dialogs.copy():
                await driver.press("escape")
        assert engine.run == before


def test_enter_takes_what_does_nothing_or_can_be_taken_back_else_nothing_is_marked() -> None:
    acts = (Option("1", "a reason", "a reason"), Option("o", "other", None, free=True))
    assert Pick("Why?", acts).marked == -1
    assert Pick("Why?", acts, quick=True).marked == 0
    assert Pick("Why?", (Option("l", "later", None), *acts)).marked == 0


async def test_an_incident_is_one_of_now_while_the_run_goes_on_and_asks_for_its_time_after_it(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("i", "c")
    assert engine.run.incidents[-1].time == engine.now
    await running.let_pass(20.0)
    await stop_the_run(running)
    acts = list(engine.acts)
    await running.press("i", "f")
    assert "When? Seconds from the start of the run" in running.text
    await running.press("enter")
    assert "its time is needed: the run has stopped" in running.text
    await running.type("later")
    await running.press("enter")
    assert "'later' is no time" in running.text
    assert engine.acts == acts
    await running.press(*["backspace"] * 5)
    await running.type("0:12.5")
    await running.press("enter")
    assert engine.acts[-1] == MarkIncident(IncidentKind.FALL, after_start=12.5)
    start = engine.run.start
    assert start is not None
    assert engine.run.incidents[-1].time == start + 12.5
    await running.press("i", "f")
    await running.type("-60")
    await running.press("enter")
    assert "the recording began at -5.0 s" in running.console.status


async def test_a_console_whose_engine_has_ended_refuses_with_that_and_leaves_without_a_question(
    running: Driver, engine: FakeEngine
) -> None:
    await running.press("f8")
    engine.failure = "the engine has ended"
    await running.settle()
    assert "NOT POSSIBLE ANY MORE: the engine has ended" in running.text
    await running.press("enter", "i")
    assert running.console.status == "Refused: mark an incident: the engine has ended"
    assert engine.run.phase is Phase.RUNNING
    await running.press("f10")
    assert not running.app.is_running


async def test_leaving_a_silent_engine_says_that_nobody_knows(
    running: Driver, engine: FakeEngine
) -> None:
    engine.pulse = Pulse(server=4)
    await running.press("f10")
    assert "Nobody can say whether the run goes on" in running.text
    await running.press("enter")
    assert running.app.is_running


async def test_a_field_is_typed_into_only_where_that_was_chosen(
    running: Driver, engine: FakeEngine
) -> None:
    await stop_the_run(running)
    await running.press("x")
    assert running.console.pane == "setup"
    assert not isinstance(running.app.focused, Input)
    await running.press("f2")
    assert isinstance(running.app.focused, Input)
    await running.press("f3", "enter", "n")
    await running.type("ok")
    await running.press("enter")
    assert engine.acts[-1] == AddNote("ok")
    assert not isinstance(running.app.focused, Input)
    await running.press("f2", "escape", "enter")  # sets up, as the button says
    assert running.console.query_one("#subject", Input).value == "1"
