"""What holds on every screen: footer, bell, panes, palette, small terminals, the engine's start."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
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
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    Driver,
    Stories,
    acting,
    driving,
    has,
    in_sizes,
    no,
    no_question,
    on_engine,
    opened,
    pane,
    passes,
    play,
    says_only,
    sets,
    types_every,
)
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


@pytest.mark.slow
async def test_a_storm_of_sizes_and_keys_breaks_nothing(
    running: Driver, engine: FakeEngine
) -> None:
    engine.faults = ("a fault with some words in it",)
    for size in ((1, 1), (300, 90), (10, 3), (40, 12), (80, 24), (60, 18), (59, 40), (90, 5)):
        await running.pilot.resize_terminal(*size)
        await running.pilot.press(
            *"hsgn", "question_mark", "f8", "escape", "f1", "f2", "f4", "escape", "f3"
        )
    await running.pilot.resize_terminal(80, 24)
    await running.press("escape", "f3")
    assert engine.run.phase is Phase.RUNNING
    assert "RUNNING" in running.text
    await running.finish()
    await running.press("f4")
    assert "COMPLETED" in running.text


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


CUT_OFF_SO = (
    "A RUN WAS CUT OFF: run 2 of subject 3 Delft was cut off while running, last line +7.5 s from"
    " the start, last event door opens, 2.5 MB recorded"
)
CUT_OFF_ANSWERS = (
    "interrupted, uses up no attempt of the team",
    "invalid, as if aborted: uses up an attempt of the team",
)
BROKEN = TeamList({1: "Delft"}, ("teams.csv line 3: subject 'x' is no number",))
ACT_CAPS = [f"{key.cap} {key.label}" for key in KEYS.values() if key.act]
WATCHES = "`madrob console` can act, this screen only watches"


def footer(begin: str, end: str = "") -> Callable[[Driver], object]:
    return lambda driver: (row := driver.rows()[-1]).startswith(begin) and row.endswith(end)


def has_right(right: RightToAct) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.right == right


def was_opened(*folders: str) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.opened == [*folders]


STORIES: Stories = {
    "escape goes back and the key of a side pane too": [
        ("f3",),
        *(
            row
            for key, side in (("f1", "help"), ("h", "history"), ("s", "standings"), ("p", "plan"))
            for row in ((key, pane(side)), ("escape", pane("live")), (f"{key} {key}", pane("live")))
        ),
        ("escape", pane("live")),
    ],
    "escape never ends a run on any pane": [
        (Driver.run,),
        *((f"{key} escape*3", Phase.RUNNING) for key in ("f1", "f2", "f3", "f4", "h", "s", "g")),
        ("", lambda d: d.app.is_running),
    ],
    **{
        f"the footer shows at most seven keys that are possible with their words: {phase}": [
            (acting(bring, phase),),
            (key, footer(words, "F1 more"), lambda d: len(d.rows()[-1].split("  ")) <= 8),
        ]
        for phase, key, words in [
            (Phase.IDLE, "f3", "F7 Zero  Enter Menu  x Next run  h History  p Plan  s Standings"),
            (Phase.COUNTDOWN, "", "F8 ABORT  Enter Menu  i Incident  h History  p Plan"),
            (Phase.RUNNING, "", "F8 ABORT  F9 Timeout  Enter Menu  1-6 Step  i Incident"),
            (Phase.STOPPED, "", "Enter Menu  x Next run  1-6 Step  i Incident  h History"),
            (Phase.FINAL, "", "Enter Menu  x Next run  h History  p Plan  s Standings"),
        ]
    },
    **{
        f"a terminal too small for the panes is a clock with abort and timeout: {key}": [
            (in_sizes((60, 17), (59, 24), (24, 8)),),
            (Driver.run, "RUNNING  0:01.0", "F8 ABORT"),
            (f"{key} escape", Phase.RUNNING),
            (f"{key} y", act),
        ]
        for key, act in (("f8", Abort("none given")), ("f9", DeclareTimeout("none given")))
    },
    "the keys that start and end a run are named in every size": [
        (in_sizes((60, 18), (72, 20), (80, 24), (120, 36), (200, 60)),),
        (Driver.set_up, lambda d: "F5 START" in d.rows()[-1]),
        ("f5", footer("F8 ABORT")),
        (passes(6.0), footer("F8 ABORT  F9 Timeout", "F1 more")),
        ("", lambda d: "…" not in d.rows()[-1]),
    ],
    **{
        f"a console without the right to act aborts with two keys: {words}, {sizes[-1][0]} cells": [
            (in_sizes(*sizes),),
            (types_every(0.0),),
            (Driver.run,),
            (has(right=right),),
            ("f8", *asked, has_right(right)),  # a question takes nothing over
            ("y", Abort("aborted from another console"), lambda d: not d.engine.right.holder),
        ]
        for right, words in (
            (RightToAct(holder="bo@tent"), "bo@tent has the right to act. Take it over"),
            (RightToAct(free=True), "No console has the right to act. Take it over"),
        )
        for sizes, asked in (
            (((120, 36), (80, 24), (40, 12)), (words, "y yes")),
            (((20, 5), (10, 3)), ()),
        )
    },
    "a spectator reads on the smallest screen what can act": [
        (in_sizes((40, 12)),),
        (on_engine(right=RightToAct(Role.WATCH, "ada@hall")),),
        ("f8 y", "`madrob console` can act", lambda d: d.engine.acts == []),
    ],
    "a spectator is told so by every key and by no fault": [
        (on_engine(right=RightToAct(Role.WATCH, "ada@hall")),),
        ("f3", lambda d: "no faults" in d.rows()[1]),
        *(
            (key.keys, says_only(f"Refused: {key.act}: {WATCHES}"))
            for key in (KEYS["start"], KEYS["next"], KEYS["incident"])
        ),
        ("", lambda d: d.engine.acts == []),
    ],
    "a spectator sees only what there is to see": [
        (in_sizes((80, 24), (160, 50)),),
        (on_engine(right=RightToAct(Role.WATCH), teams=BROKEN),),
        ("f2 tab", "s Standings", "F10 Leave", no("letters type"), no("waives")),
        (
            "",
            no("teams.csv"),
            *(no(f"{key.cap} {key.label}  ") for key in KEYS.values() if key.act),
        ),
        ("h", pane("history")),
    ],
    **{
        f"a run that was cut off is asked about and nothing resumes by itself: {key}": [
            (on_engine(unfinished=(CUT_OFF,)), CUT_OFF_SO, *CUT_OFF_ANSWERS),
            (key, no_question, was_opened(*opened)),
        ]
        for key, opened in (
            ("s", ["folder"]),
            ("i", ["folder invalid"]),
            ("enter", []),
            ("escape", []),
        )
    },
    "the footer says that letters type while they do": [
        ("f2", lambda d: d.rows()[-1].startswith("letters type  F7 Zero  Enter Set up")),
        ("f3", lambda d: "letters type" not in d.rows()[-1]),
    ],
    "a teams file with broken lines says so at the set up": [
        (
            on_engine(teams=BROKEN),
            "teams.csv line 3",
            lambda d: "teams.csv" not in d.console.status,
        ),
        (
            "f2 9 enter f6",
            "x F2 corrects the team: 9 is not in the list (Enter waives)",
            no("Subject 9 is not in the list"),
        ),
    ],
    "a console without the right to act says who has it and can take it": [
        (Driver.run,),
        (
            has(right=RightToAct(holder="bo@tent")),
            lambda d: (
                "bo@tent has the right to act: an act here takes it over, after y" in d.rows()[1]
            ),
        ),
        (types_every(0.35),),
        ("f9", "bo@tent has it, and can do nothing then. A run goes on."),
        ("enter", lambda d: d.engine.right.holder),
        (
            "f9 y",
            says_only("This console has the right to act now."),
            lambda d: "no faults" in d.rows()[1],
        ),
        ("enter", no("Take over")),
        ("escape f8 1 y", Abort("robot unsafe")),
    ],
    "an abort that cannot take the right over is told": [
        (Driver.run,),
        (has(right=RightToAct(holder="bo@tent")),),
        ("f8",),
        (sets(takes_over=False),),
        (
            "y",
            says_only("Refused: take over: this screen only watches"),
            lambda d: not any(isinstance(act, Abort) for act in d.engine.acts),
        ),
    ],
    **{
        f"an act takes the right over after y on every pane: {key}": [
            (opened(gap=0.35),),
            (key,),
            (has(right=RightToAct(holder="bo@tent")), "an act here takes it over, after y"),
            ("f6 y", says_only("This console has the right to act now.")),
        ]
        for key in ["f2", "f3", "f4", "h", "p", "s", "f1"]
    },
    "a spectator leaves without a question": [
        (Driver.run,),
        (lambda d: d.engine.finish(),),
        (has(right=RightToAct(Role.WATCH)), lambda d: d.engine.run.unsigned),
        ("f10", lambda d: not d.app.is_running),
    ],
    "a run that was cut off is asked about once when a slow disk tells of it late": [
        ("", no_question),
        (has(unfinished=(CUT_OFF,)), "A RUN WAS CUT OFF: run 2 of subject 3 Delft"),
        ("escape",),
        (Driver.settle, no_question),
    ],
    "a run that was cut off is asked about again when the engine starts again": [
        (on_engine(unfinished=(CUT_OFF,)), "A RUN WAS CUT OFF: run 2 of subject 3 Delft"),
        (has(pulse=Pulse(gone="the engine has ended")),),
        ("enter",),
        (Driver.settle, no_question),
        (has(pulse=Pulse()), "A RUN WAS CUT OFF: run 2 of subject 3 Delft"),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])
