"""What holds on every screen: footer, bell, panes, palette, small terminals, the engine's start."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from types import SimpleNamespace
from typing import Any

import pytest

from madrob_console.archive.history import RunSummary
from madrob_console.archive.run_journal import Unfinished
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import ThemeName
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.requests import UNSURE, PlaybackCommand, Role, TakeOver
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.engine.wire import EngineClient, UnsureError
from madrob_console.referee.acts import Abort, DeclareTimeout
from madrob_console.referee.lists import TeamList
from madrob_console.referee.run import Phase
from madrob_console.ui import awaited
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.key_table import KEYS
from madrob_console.ui.panes.runs_pane import HistoryPane
from scoring.protocol import Outcome
from tests.madrob_console.ui.driver import DEFAULTS, LARGE, Driver, Hand, driving
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine
from tests.slowly import slow_but_for

PHASES = {
    Phase.IDLE: (),
    Phase.READY: ("enter",),
    Phase.COUNTDOWN: ("enter", "f6", "f5"),
    Phase.RUNNING: ("enter", "f6", "f5"),
    Phase.STOPPED: ("enter", "f6", "f5"),
    Phase.FINAL: ("enter", "f6", "f5"),
}
OTHERS = ("", PlaybackCommand.name, TakeOver.name)
ACTS = [key for key in KEYS.values() if key.act not in OTHERS]


async def bring(driver: Driver, phase: Phase) -> None:
    """The run into a phase, by the referee's own keys where there are any."""
    await driver.press("f2", *PHASES[phase])
    if phase in (Phase.RUNNING, Phase.STOPPED, Phase.FINAL):
        await driver.let_pass(6.0)
    if phase in (Phase.STOPPED, Phase.FINAL):
        await driver.finish()
    if phase is Phase.FINAL:
        await driver.press("enter", "f", "a", "enter")
    assert driver.engine.run.phase is phase


@pytest.mark.parametrize("phase", slow_but_for(Phase, Phase.RUNNING))
@pytest.mark.parametrize("size", [LARGE])
async def test_from_every_state_every_key_acts_asks_or_says_why_not(
    driver: Driver, engine: FakeEngine, phase: Phase
) -> None:
    await bring(driver, phase)
    await driver.press("f3")
    run, result, acts = engine.run, engine.result, list(engine.acts)
    for key in ACTS:
        engine.run, engine.result, engine.acts = run, result, list(acts)
        engine.exported.clear()
        engine.dossiers.clear()
        driver.console.say("")
        refused = engine.snapshot().refusal(key.act)
        await driver.app.action_press(key.name, key.keys.partition(",")[0] or key.cap)
        await driver.settle()
        asked = list(driver.console.dialogs)
        if refused is not None:
            assert driver.console.status == f"Refused: {key.act}: {refused}", key
            assert (engine.acts, asked) == (acts, []), key
        elif asked:
            assert engine.acts == acts, key
            await driver.press("escape")
            assert (engine.acts, driver.console.dialogs) == (acts, []), key
        else:
            packed = engine.exported or engine.dossiers
            done = len(engine.acts) == len(acts) + 1 or packed
            assert done or "Refused" in driver.console.status
        await driver.press("f3")


async def test_escape_goes_back_and_the_key_of_a_side_pane_too(driver: Driver) -> None:
    await driver.press("f3")
    for key in ("f1", "h", "s", "p"):
        await driver.press(key)
        assert driver.console.pane != "live"
        await driver.press("escape")
        assert driver.console.pane == "live"
        await driver.press(key, key)
        assert driver.console.pane == "live"
    await driver.press("escape")
    assert driver.console.pane == "live"


async def test_escape_never_ends_a_run_on_any_pane(running: Driver, engine: FakeEngine) -> None:
    for key in ("f1", "f2", "f3", "f4", "h", "s", "g"):
        await running.press(key, "escape", "escape", "escape")
    assert engine.run.phase is Phase.RUNNING
    assert running.app.is_running


async def test_the_footer_says_that_letters_type_while_they_do(driver: Driver) -> None:
    await driver.press("f2")
    assert driver.rows()[-1].startswith("letters type  F7 Zero  Enter Set up")
    await driver.press("f3")
    assert "letters type" not in driver.rows()[-1]


@pytest.mark.parametrize(
    ("phase", "footer"),
    [
        (Phase.IDLE, "F7 Zero  Enter Menu  x Next run  h History  p Plan  s Standings  F1 more"),
        (Phase.COUNTDOWN, "F8 ABORT  Enter Menu  i Incident  h History  p Plan"),
        (Phase.RUNNING, "F8 ABORT  F9 Timeout  Enter Menu  1-6 Step  i Incident"),
        (Phase.STOPPED, "Enter Menu  x Next run  1-6 Step  i Incident  h History"),
        (Phase.FINAL, "Enter Menu  x Next run  h History  p Plan  s Standings"),
    ],
)
async def test_the_footer_shows_at_most_seven_keys_that_are_possible_with_their_words(
    driver: Driver, phase: Phase, footer: str
) -> None:
    await bring(driver, phase)
    if phase is Phase.IDLE:
        await driver.press("f3")
    shown = driver.rows()[-1]
    assert shown.startswith(footer)
    assert shown.endswith("F1 more")
    assert len(shown.split("  ")) <= 8


def test_the_bell_rings_on_start_stop_and_fault_and_not_when_it_is_off(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rung: list[str] = []
    monkeypatch.setattr(MadrobApp, "bell", lambda _app: rung.append("bell"))

    async def drive(look: ConsoleSettings) -> list[int]:
        rung.clear()
        counts = []
        async with driving(FakeEngine(), look=look) as driver:
            await driver.set_up()
            await driver.press("f5")
            counts.append(len(rung))
            await driver.let_pass(6.0)
            counts.append(len(rung))
            driver.engine.faults = ("the door is on fire",)
            await driver.settle()
            await driver.settle()
            counts.append(len(rung))
            for silent in (1, 2):  # the disk
                driver.engine.pulse = Pulse(disk=silent)
                await driver.settle()
            counts.append(len(rung))
            await driver.finish()
            counts.append(len(rung))
        return counts

    assert asyncio.run(drive(ConsoleSettings())) == [0, 1, 2, 3, 4]
    assert asyncio.run(drive(ConsoleSettings(bell=False))) == [0, 0, 0, 0, 0]


@pytest.mark.parametrize("size", [LARGE])
async def test_the_palette_finds_every_command_and_says_why_one_is_not_possible(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.press("f2", "ctrl+p")
    await driver.pilot.pause(0.3)
    await driver.type("abort")
    await driver.pilot.pause(0.5)
    (row,) = (row for row in driver.rows() if "F8  ABORT" in row)  # one row a command
    assert "not now: no run is set up yet" in row
    await driver.press("escape", "ctrl+p")
    await driver.type("live")
    await driver.pilot.pause(0.5)
    await driver.press("enter")
    await driver.pilot.pause(0.3)
    assert driver.console.pane == "live"
    assert engine.acts == []


async def test_abort_is_never_behind_the_palette(running: Driver, engine: FakeEngine) -> None:
    await running.press("ctrl+p")
    await running.pilot.pause(0.3)
    await running.press("f8", "1", "y")
    assert engine.acts[-1] == Abort("robot unsafe")


async def test_the_theme_changes_at_once(driver: Driver) -> None:
    before = driver.app.theme
    driver.app.set_theme(ThemeName.HIGH_CONTRAST)
    await driver.settle()
    assert driver.app.theme != before
    assert "SIMULATED" in driver.text


@pytest.mark.parametrize("size", [(60, 17), (59, 24), (24, 8)])
async def test_a_terminal_too_small_for_the_panes_is_a_clock_with_abort_and_timeout(
    running: Driver, engine: FakeEngine
) -> None:
    assert "RUNNING  0:01.0" in running.text
    assert "F8 ABORT" in running.text
    run = engine.run
    await running.press("f8", "escape")
    assert engine.run.phase is Phase.RUNNING
    for key, act in (("f8", Abort("none given")), ("f9", DeclareTimeout("none given"))):
        engine.run = run
        await running.press(key, "y")
        assert engine.acts[-1] == act


@pytest.mark.parametrize("size", [(60, 18), (72, 20), (80, 24), (120, 36), (200, 60)])
async def test_the_keys_that_start_and_end_a_run_are_named_in_every_size(driver: Driver) -> None:
    await driver.set_up()
    assert "F5 START" in driver.rows()[-1]
    await driver.press("f5")
    assert driver.rows()[-1].startswith("F8 ABORT")
    await driver.let_pass(6.0)
    footer = driver.rows()[-1]
    assert footer.startswith("F8 ABORT  F9 Timeout")
    assert footer.endswith("F1 more")
    assert "…" not in footer


@pytest.mark.slow
async def test_a_storm_of_sizes_and_keys_breaks_nothing(
    running: Driver, engine: FakeEngine
) -> None:
    for width, height in ((1, 1), (300, 90), (10, 3), (80, 24), (59, 40), (90, 5)):
        await running.pilot.resize_terminal(width, height)
        await running.pilot.press("h", "f8", "escape", "s", "f3", "g", "question_mark")
    await running.pilot.resize_terminal(80, 24)
    await running.press("escape", "f3")
    assert engine.run.phase is Phase.RUNNING
    assert "RUNNING" in running.text


async def test_an_earlier_run_is_opened_from_the_history_and_shown(
    driver: Driver, engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HistoryPane, "prepare", lambda _pane, _runs: (a_summary(),))
    await driver.answered("f3", "h")
    await driver.press("enter", "o")
    await driver.settle()
    assert engine.opened == ["subject_004_cond_003_run_002_20231114_221320"]
    assert driver.console.pane == "results"
    engine.failure = "its bag is gone"
    await driver.answered("h")
    await driver.press("enter", "o")
    await driver.settle()
    assert driver.console.status == "Refused: open the run: its bag is gone"


async def test_again_in_the_history_is_for_the_marked_team_and_condition(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HistoryPane, "prepare", lambda _pane, _runs: (a_summary(),))

    async with driving(engine) as driver:
        await driver.answered("f3", "h")
        await driver.press("enter", "X")
        setup = engine.run.setup
        assert setup is not None
        assert (setup.subject, setup.team, setup.condition.number) == (4, "Oslo", 3)
        assert setup.problem() is None
        assert driver.console.pane == "setup"


async def test_a_teams_file_with_broken_lines_says_so_at_the_set_up(engine: FakeEngine) -> None:
    engine.teams = TeamList({1: "Delft"}, ("teams.csv line 3: subject 'x' is no number",))

    async with driving(engine) as driver:
        assert "teams.csv line 3" in driver.text
        assert "teams.csv" not in driver.console.status
        await driver.press("f2", "9", "enter")
        await driver.press("f6")
        text = " ".join(driver.text.split())
        assert "x F2 corrects the team: 9 is not in the list (Enter waives)" in text
        assert "Subject 9 is not in the list" not in text  # said once


async def test_a_console_without_the_right_to_act_says_who_has_it_and_can_take_it(
    running: Driver, engine: FakeEngine
) -> None:
    engine.right = RightToAct(holder="bo@tent")
    await running.settle()
    who = "bo@tent has the right to act: an act here takes it over, after y"
    assert who in running.rows()[1]
    running.hand.gap = 0.35
    await running.press("f9")
    assert "bo@tent has it, and can do nothing then. A run goes on." in running.text
    await running.press("enter")
    assert engine.right.holder
    await running.press("f9", "y")
    assert running.console.status == "This console has the right to act now."
    assert "no faults" in running.rows()[1]
    await running.press("enter")
    assert "Take over" not in running.text
    await running.press("escape", "f8", "1", "y")
    assert engine.acts[-1] == Abort("robot unsafe")


@pytest.mark.parametrize("size", [(120, 36), (80, 24), (40, 12), (20, 5), (10, 3)])
@pytest.mark.parametrize("right", [RightToAct(holder="bo@tent"), RightToAct(free=True)])
async def test_a_console_without_the_right_to_act_aborts_with_two_keys(
    engine: FakeEngine, size: tuple[int, int], right: RightToAct
) -> None:
    async with driving(engine, size, gap=0.0) as driver:
        await driver.run()
        engine.right = right
        await driver.settle()
        await driver.press("f8")
        if size[0] >= 40:
            asked = " ".join(driver.text.replace("│", "").split())
            assert f"{right.holder or 'No console'} has the right to act. Take it over" in asked
            assert "y yes" in asked
        assert engine.right.holder == right.holder, "a question takes nothing over"
        await driver.press("y")
        assert engine.acts[-1] == Abort("aborted from another console")
        assert not engine.right.holder


async def test_an_abort_that_cannot_take_the_right_over_is_told(
    running: Driver, engine: FakeEngine
) -> None:
    engine.right = RightToAct(holder="bo@tent")
    await running.settle()
    await running.press("f8")
    engine.takes_over = False
    await running.press("y")
    assert running.console.status == "Refused: take over: this screen only watches"
    assert not any(isinstance(act, Abort) for act in engine.acts)


@pytest.mark.parametrize("pane", ["f2", "f3", "f4", "h", "p", "s", "f1"])
async def test_an_act_takes_the_right_over_after_y_on_every_pane(
    engine: FakeEngine, pane: str
) -> None:
    async with driving(engine, gap=0.35) as driver:
        await driver.press(pane)
        engine.right = RightToAct(holder="bo@tent")
        await driver.settle()
        assert "an act here takes it over, after y" in driver.text
        await driver.press("f6", "y")
        assert driver.console.status == "This console has the right to act now."


async def test_a_spectator_reads_on_the_smallest_screen_what_can_act(engine: FakeEngine) -> None:
    engine.right = RightToAct(Role.WATCH, "ada@hall")

    async with driving(engine, (40, 12)) as driver:
        await driver.press("f8", "y")
        assert "`madrob console` can act" in driver.text
    assert engine.acts == []


async def test_a_spectator_is_told_so_by_every_key_and_by_no_fault(engine: FakeEngine) -> None:
    engine.right = RightToAct(Role.WATCH, "ada@hall")

    async with driving(engine) as driver:
        await driver.press("f3")
        assert "no faults" in driver.rows()[1]
        for key in (KEYS["start"], KEYS["next"], KEYS["incident"]):
            await driver.press(key.keys)
            why = "`madrob console` can act, this screen only watches"
            assert driver.console.status == f"Refused: {key.act}: {why}"
    assert engine.acts == []


@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
async def test_a_spectator_sees_only_what_there_is_to_see(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    engine.right = RightToAct(Role.WATCH)
    engine.teams = TeamList({1: "Delft"}, ("teams.csv line 3: subject 'x' is no number",))

    async with driving(engine, size) as driver:
        await driver.press("f2", "tab")
        footer = driver.rows()[-1]
        assert "s Standings" in footer
        assert "F10 Leave" in footer
        for key in KEYS.values():
            assert not key.act or f"{key.cap} {key.label}" not in footer
        for words in ("letters type", "waives", "teams.csv"):
            assert words not in driver.text
        await driver.press("h")
        assert driver.console.pane == "history"


async def test_a_spectator_leaves_without_a_question(running: Driver, engine: FakeEngine) -> None:
    engine.finish()
    engine.right = RightToAct(Role.WATCH)
    await running.settle()
    assert engine.run.unsigned
    await running.press("f10")
    assert not running.app.is_running


async def test_the_screens_are_there_before_the_engine_and_keys_say_so() -> None:
    ready = threading.Event()
    engine = FakeEngine()

    def open_client() -> EngineClient:
        ready.wait(20.0)
        return engine

    app = MadrobApp(open_client, DEFAULTS)
    async with app.run_test(size=(80, 24)) as pilot:
        driver = Driver(app, engine, pilot, Hand())
        await driver.press("f5")
        assert driver.console.status == (
            "Refused: start: this screen is not attached to the engine yet"
        )
        ready.set()
        await app.workers.wait_for_complete()
        await driver.settle()
        assert "SIMULATED nominal" in driver.rows()[0]


def test_without_an_engine_the_screens_end_and_the_reason_is_kept() -> None:
    def open_client() -> EngineClient:
        raise MadrobError("no testbed on ROS domain 7: start it")

    async def drive() -> MadrobApp:
        app = MadrobApp(open_client, DEFAULTS)
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.pause(0.5)
            assert not app.is_running
        return app

    app = asyncio.run(drive())
    assert str(app.failure) == "no testbed on ROS domain 7: start it"


def test_a_question_that_takes_long_to_paint_is_not_put_down_to_the_engine(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    mounted = asyncio.Event()
    opens = ConsoleScreen.open

    async def slowly(*what: Any) -> None:  # noqa: ANN401  as it is called
        await mounted.wait()
        await opens(*what)

    monkeypatch.setattr(ConsoleScreen, "open", slowly)

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("f8")
            assert "no answer" not in driver.console.status
            mounted.set()
            await driver.answered()
            assert "ABORT the run" in driver.text

    asyncio.run(drive())


async def test_the_keys_go_on_while_an_act_waits_for_its_answer(slow_engine: SlowEngine) -> None:

    async with driving(slow_engine) as driver:
        await driver.run()
        slow_engine.slow = True
        await driver.press("i", "c")
        slow_engine.say("the door opens")
        for _ in range(3):  # the log waits for every third look
            await driver.settle()
        assert "the door opens" in driver.text
        assert "no answer of the engine yet; the keys work" in driver.console.status
        await driver.press("i", "c")
        assert "the one before is not answered yet" in driver.console.status
        await driver.press("f8")
        assert "ABORT the run" in driver.text
        assert slow_engine.acts[-1].name == "start"
        slow_engine.answer()
        await driver.settle()
        assert slow_engine.acts[-1].name == "mark an incident"
        assert driver.console.status.startswith("Done: ")


@pytest.mark.parametrize("key", ["f8", "escape"])
async def test_a_start_that_waits_for_the_disk_is_named_and_can_be_withdrawn(
    slow_engine: SlowEngine, key: str
) -> None:

    async with driving(slow_engine) as driver:
        await driver.set_up()
        slow_engine.slow = True
        await driver.press("f5")
        assert "start: waiting for the disk; F8 or Escape" in driver.console.status
        await driver.press(key)
        assert "start: withdrawing it" in driver.console.status
        names = [getattr(request, "name", "") for request, _ in slow_engine.waiting]
        assert names == ["start", "abort"]
        start, abort = (answer for _, answer in slow_engine.waiting)
        start.set_result("start withdrawn: it is withdrawn")
        abort.set_result(None)
        await driver.settle()
        assert "Refused: start: start withdrawn" in driver.console.status
        assert slow_engine.run.phase is Phase.READY


def test_an_answer_that_comes_with_the_end_of_patience_is_what_is_said(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def too_late(waiting: Coroutine[Any, Any, object], _patience: float) -> None:
        await waiting
        raise TimeoutError

    loop = SimpleNamespace(Event=asyncio.Event, wait_for=too_late)

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            monkeypatch.setattr(awaited, "asyncio", loop)
            await driver.press("i", "c")
            assert driver.console.status.startswith("Done: ")

    asyncio.run(drive())


async def test_what_nobody_knows_is_not_called_refused(slow_engine: SlowEngine) -> None:
    slow = slow_engine

    async with driving(slow) as driver:
        await driver.run()
        slow.slow = True
        await driver.press("i", "c")
        _, answer = slow.waiting[0]
        assert answer.set_running_or_notify_cancel()
        answer.set_exception(UnsureError(UNSURE))
        await driver.settle()
        assert driver.console.status == f"mark an incident: {UNSURE}"


def a_summary(folder: str = "subject_004_cond_003_run_002_20231114_221320") -> RunSummary:
    """An earlier run of another team in another condition."""
    return RunSummary(
        folder=folder,
        subject=4,
        team="Oslo",
        run_number=2,
        condition=3,
        started=1_700_000_000.0,
        outcome=Outcome.COMPLETED,
        source="simulated",
    )


CUT_OFF = Unfinished("folder", 3, "Delft", 2, 1, Phase.RUNNING, 10.0, 17.5, "door opens", 2_500_000)


async def test_a_run_that_was_cut_off_is_asked_about_once_when_a_slow_disk_tells_of_it_late(
    driver: Driver, engine: FakeEngine
) -> None:
    assert not driver.console.dialogs
    engine.unfinished = (CUT_OFF,)
    await driver.settle()
    assert "A RUN WAS CUT OFF: run 2 of subject 3 Delft" in driver.text
    await driver.press("escape")
    await driver.settle()
    assert not driver.console.dialogs


async def test_a_run_that_was_cut_off_is_asked_about_again_when_the_engine_starts_again(
    engine: FakeEngine,
) -> None:
    engine.unfinished = (CUT_OFF,)

    async with driving(engine) as driver:
        assert "A RUN WAS CUT OFF: run 2 of subject 3 Delft" in driver.text
        engine.pulse = Pulse(gone="the engine has ended")
        await driver.settle()
        await driver.press("enter")
        await driver.settle()
        assert not driver.console.dialogs
        engine.pulse = Pulse()
        await driver.settle()
        assert "A RUN WAS CUT OFF: run 2 of subject 3 Delft" in driver.text


@pytest.mark.parametrize(
    ("key", "opened"), [("s", ["folder"]), ("i", ["folder invalid"]), ("l", []), ("escape", [])]
)
async def test_a_run_that_was_cut_off_is_asked_about_and_nothing_resumes_by_itself(
    engine: FakeEngine, key: str, opened: list[str]
) -> None:
    engine.unfinished = (CUT_OFF,)

    async with driving(engine) as driver:
        text = " ".join(driver.text.replace("│", " ").split())
        assert (
            "A RUN WAS CUT OFF: run 2 of subject 3 Delft was cut off while running, last line"
            " +7.5 s from the start, last event door opens, 2.5 MB recorded"
        ) in text
        assert "interrupted, uses up no attempt of the team" in text
        assert "invalid, as if aborted: uses up an attempt of the team" in text
        await driver.press("enter" if key == "l" else key)
        await driver.settle()
        assert engine.opened == opened
        assert not driver.console.dialogs


async def test_the_history_asks_about_a_run_that_was_cut_off_before_it_opens_it(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HistoryPane, "prepare", lambda _pane, _runs: (a_summary("folder"),))
    engine.unfinished = (CUT_OFF,)

    async with driving(engine) as driver:
        await driver.answered("escape", "h")
        for key, opened in (("l", []), ("i", ["folder invalid"])):
            await driver.press("enter", "o")
            await driver.settle()
            assert "A RUN WAS CUT OFF: run 2 of subject 3 Delft" in driver.text
            await driver.press(key)
            await driver.settle()
            assert engine.opened == opened


async def test_no_two_widgets_share_a_name_and_with_it_a_look(driver: Driver) -> None:
    names = [widget.id for widget in driver.console.query("*") if widget.id]
    assert sorted(names) == sorted(set(names))
    assert "Starting side < CCW >" in driver.text
