"""What holds on every screen: footer, bell, panes, palette, small terminals, the engine's life."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from textual import events
from textual.command import CommandList
from textual.widgets import Input

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.ipc.engine_interface import EngineClient, UnsureError
from madrob_console.engine.requests import (
    UNSURE,
    OpenRun,
    Role,
)
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.acts import Abort, DeclareTimeout
from madrob_console.referee.run import Phase
from madrob_console.referee.team_list import TeamList
from madrob_console.ui import awaited
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.key_table import FINDS_BY_ITSELF, KEYS
from madrob_console.ui.keys.questions import NO_REASON
from madrob_console.ui.link import LOOKING_PERIOD
from scoring.protocol import Step
from scoring.stamps import REORDERED
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    Driver,
    Stories,
    Story,
    ages,
    answered,
    driving,
    engine_does,
    engine_has,
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
    resized,
    says,
    says_only,
    set_up_with,
    sets,
    slows,
    types_every,
    waits,
)
from tests.madrob_console.ui.inline_engine import HandEngine

GONE = "the engine has ended"


async def test_however_often_one_clicks_beside_the_palette_only_it_is_closed(
    driver: Driver,
) -> None:
    await driver.press("ctrl+p")
    palette = driver.app.screen
    click = events.Click(palette, 58, 0, 0, 0, 1, False, False, False, 58, 0)
    for _ in range(3):
        palette.post_message(copy(click))
    await driver.settle()
    assert driver.app.screen is driver.console
    await driver.press("f8")
    assert driver.console.dialogs or "Refused" in driver.console.status


async def test_click_beside_a_shrunken_palette_ends_nothing(driver: Driver) -> None:
    await driver.press("ctrl+p")
    palette = driver.app.screen
    await driver.resize(2, 2)
    palette.post_message(events.Click(palette, 58, 14, 0, 0, 1, False, False, False, 58, 14))
    await driver.settle()
    assert driver.app.is_running


async def test_search_without_a_list_ends_nothing(driver: Driver) -> None:
    await driver.press("ctrl+p")
    palette = driver.app.screen
    await palette.query_one(CommandList).remove()
    palette.query_one(Input).value = "abort"
    await driver.pilot.pause()
    assert driver.app.is_running


@pytest.mark.parametrize("bell", [True, False])
async def test_the_bell_rings_on_start_stop_and_fault_and_not_when_it_is_off(
    monkeypatch: pytest.MonkeyPatch, *, bell: bool
) -> None:
    rung: list[str] = []
    monkeypatch.setattr(MadrobApp, "bell", lambda _app: rung.append("bell"))

    def rings(times: int) -> Callable[[Driver], object]:
        return lambda _: len(rung) == times * bell

    story: Story = [
        (opened(look=ConsoleSettings(bell=bell)),),
        (Driver.set_up,),
        ("f5", rings(0)),
        (passes(6.0), rings(1)),
        (has(faults=("the door is on fire",)),),
        (Driver.settle, rings(2)),
        *((has(pulse=Pulse(disk=silent)),) for silent in (1, 2)),
        (Driver.finish, rings(4)),
    ]
    await play(HandEngine, story)


async def test_an_answer_that_comes_with_the_end_of_patience_is_what_is_said(
    driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def too_late(waiting: Coroutine[Any, Any, object], _patience: float) -> None:
        await waiting
        raise TimeoutError

    await driver.run()
    loop = SimpleNamespace(Event=asyncio.Event, wait_for=too_late)
    monkeypatch.setattr(awaited, "asyncio", loop)
    await follow(driver, [("i c", says("Done: "))])


async def test_the_screen_says_what_it_waits_for_until_the_engine_is_there(
    engine: HandEngine,
) -> None:
    ready = threading.Event()

    def find(_may_start: bool) -> EngineClient:
        ready.wait(20.0)
        return engine

    async with driving(engine, find=find) as driver:
        await driver.until("Looking for the engine; one is started where none runs")
        await driver.press("f5")
        assert driver.console.status == (
            "Refused: start: this screen is not attached to the engine yet"
        )
        ready.set()
        await driver.answered()
        assert "Looking for the engine" not in driver.text
        assert "SIMULATED nominal" in driver.rows()[0]
        assert "Opening side" in driver.text


EARLIER = summary(4, 3, 2, team="Oslo", source="simulated")
CUT_OFF = Unfinished(
    EARLIER.folder, 3, "Delft", 2, 1, Phase.RUNNING, 10.0, 17.5, "door opens", 2_500_000
)
WITHDRAWN = "Refused: abort: the engine does not answer: nothing was done"


def answers(number: int, answer: object) -> Callable[[Driver], object]:
    """One of those that wait has its answer."""

    def give(driver: Driver) -> None:
        _, waiting = driver.engine.waiting[number]
        if isinstance(answer, Exception):
            waiting.set_exception(answer)
        else:
            waiting.set_result(answer)

    return give


def asked_for(*names: str) -> Callable[[Driver], object]:
    return lambda d: [getattr(one, "name", "") for one, _ in d.engine.waiting] == [*names]


def last_act(name: str) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.acts[-1].name == name


def top(begin: str) -> Callable[[Driver], object]:
    return lambda driver: driver.rows()[0].startswith(begin)


def top_has(words: str) -> Callable[[Driver], object]:
    return lambda driver: words in driver.rows()[0]


CUT_OFF_SO = (
    "A RUN WAS CUT OFF: run 2 of subject 3 Delft was cut off while running, last line +7.5 s from"
    " the start, last event door opens, 2.5 MB recorded"
)
CUT_OFF_ANSWERS = (
    "interrupted, no attempt used; a declared timeout stays",
    "invalid, as if aborted: uses up an attempt of the team",
)
BROKEN = TeamList({1: "Delft"}, ("teams.csv line 3: subject 'x' is no number",))
WATCHES = "`madrob console` can act, this screen only watches"


def footer(begin: str, end: str = "") -> Callable[[Driver], object]:
    return lambda driver: (row := driver.rows()[-1]).startswith(begin) and row.endswith(end)


def keys_are(words: str) -> Callable[[Driver], object]:
    """These come first, and no more than seven beside that of the help."""
    seen = footer(words, "F1 more")
    return lambda driver: seen(driver) and len(driver.rows()[-1].split("  ")) <= 8


WIDTHS = (60, 18), (120, 36), (200, 60)
HELD = RightToAct(holder="bo@tent")
HELD_SO = "bo@tent has the right to act: y takes it over."


def has_right(right: RightToAct) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.right == right


def was_opened(*runs: OpenRun) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.sent(OpenRun) == [*runs]


STORIES: Stories = {
    "the palette finds every command and says why one is not possible": [
        (in_sizes(LARGE),),
        ("f2",),
        (
            waits("ctrl+p =abort", "not now: no run is set up yet"),
            lambda d: (
                ["not now: no run is set up yet" in row for row in d.rows() if "F8  ABORT" in row]
                == [True]
            ),  # one row a command
        ),
        (waits("escape ctrl+p =live", "F3  Live"),),
        (
            waits(
                "enter",
                lambda d: isinstance(d.app.screen, ConsoleScreen) and d.console.pane == "live",
            ),
        ),
        ("", lambda d: d.engine.acts == []),
    ],
    "caps lock keeps no answer from an abort": [
        (Driver.run,),
        ("f8 Y", Abort(NO_REASON)),
    ],
    "a theme is a command": [
        ("ctrl+p '=high-contrast' enter", lambda d: d.app.theme == "high-contrast"),
        (Driver.settle, "SIMULATED", says("Theme: high-contrast.")),
    ],
    "every screen of a rehearsal says so": [
        (opened(defaults=replace(DEFAULTS, results=Path("/results_rehearsal"))),),
        (on_engine(competition="REHEARSAL Cup", simulated="nominal"),),
        ("f2", "< REHEARSAL >", top_has("REHEARSAL")),
        (Driver.run,),
        ("f3", top_has("REHEARSAL")),
        (Driver.finish,),
        *((key, top_has("REHEARSAL")) for key in ("f4", "f1", "h", "p", "s")),
        (resized(50, 12), "REHEARSAL"),
    ],
    "an earlier run is opened from the history and shown": [
        (opened(runs=[EARLIER]),),
        (answered("f3 h"),),
        (
            answered("enter o"),
            was_opened(OpenRun(EARLIER.folder)),
            pane("results"),
        ),
        (answered("h"),),
        (has(failure="its bag is gone"),),
        (answered("enter o"), says_only("Refused: open the run: its bag is gone")),
    ],
    "again in the history is for the marked team and condition": [
        (opened(runs=[EARLIER]),),
        (answered("f3 h"),),
        (
            "enter X",
            set_up_with(subject=4, team="Oslo"),
            lambda d: d.engine.run.setup.condition.number == 3,
            lambda d: d.engine.run.setup.problem() is None,
            pane("setup"),
        ),
    ],
    "the history asks about a run that was cut off before it opens it": [
        (opened(runs=[EARLIER]),),
        (on_engine(unfinished=(CUT_OFF,)),),
        (answered("escape h"),),
        *(
            row
            for key, runs in (("l", []), ("i", [OpenRun(EARLIER.folder, invalid=True)]))
            for row in (
                (answered("enter o"), "A RUN WAS CUT OFF: run 2 of subject 3 Delft"),
                (answered(key), was_opened(*runs)),
            )
        ),
    ],
    "the keys go on while an act waits for its answer": [
        (Driver.run,),
        (slows,),
        (waits("i", "Which?"),),
        ("c",),
        (waits("", says("working ..., the keys go on")),),
        (engine_does(HandEngine.do_step, Step.OPEN),),
        (engine_does(HandEngine.tick, REORDERED),),
        (Driver.look_thrice, "sensor  door opens"),
        (waits("i", "Which?"),),
        (waits("c", says("the one before is not answered yet")),),
        (waits("f8", "ABORT the run"), last_act("start")),
        (lambda d: d.engine.answer(),),
        (waits("", says("Done: ")), last_act("mark an incident")),
    ],
    **{
        f"a start that waits for the disk is named and can be withdrawn: {key}": [
            (Driver.set_up,),
            (slows,),
            (waits("f5", says("start: waiting for the disk; F8 or Escape")),),
            (waits(key, says("start: withdrawing it")), asked_for("start", "abort")),
            (answers(0, "start withdrawn: it is withdrawn"),),
            (answers(1, None),),
            (waits("", says("Refused: start: start withdrawn")), Phase.READY),
        ]
        for key in ("f8", "escape")
    },
    "what nobody knows is not called refused": [
        (Driver.run,),
        (slows,),
        (waits("i", "Which?"),),
        ("c",),
        (answers(0, UnsureError(UNSURE)),),
        (waits("", says_only(f"mark an incident: {UNSURE}")),),
    ],
    "a withdrawn abort is told until a key is pressed": [
        (Driver.run,),
        (slows,),
        ("f8 1 y",),
        (sets(pulse=Pulse(server=6)),),
        (answers(-1, MadrobError("the engine does not answer: nothing was done")),),
        (waits("", says_only(WITHDRAWN)),),
        (sets(pulse=Pulse(), slow=False),),
        (Driver.finish,),
        (Driver.settle, pane("results"), says_only(WITHDRAWN)),
        ("down", says_only("")),
    ],
    "without an engine the screens end and the reason is kept": [
        (on_engine(follower=MadrobError("no testbed on ROS domain 7: start it")),),
        (
            waits("", lambda d: not d.app.is_running),
            lambda d: str(d.app.failure) == "no testbed on ROS domain 7: start it",
        ),
    ],
    "the engine is started again by a key and only when it has ended": [
        ("ctrl+r", says("the engine has not ended")),
        (has(failure=GONE, follower=MadrobError("no testbed on ROS domain 7")),),
        (answered("ctrl+r"), says("no testbed on ROS domain 7")),
        (sets(follower=HandEngine(label="SIMULATED slow")),),
        (
            answered("ctrl+r"),
            says_only("The engine is there again."),
            top(" ~~ SIMULATED slow"),
            engine_has(closed=True),
        ),
    ],
    **{
        f"a screen finds the next engine by itself and starts none: {role}": [
            (on_engine(right=RightToAct(role)),),
            (has(failure=GONE, follower=MadrobError("no engine runs here")),),
            (answered(), "screen frozen at", no("^R start") if watches else "^R start"),
            ("", FINDS_BY_ITSELF if watches else no(FINDS_BY_ITSELF)),
            *[(ages(LOOKING_PERIOD),), (answered(),)] * 2,
            ("", engine_has(looked_for=4, started=1)),
            ("ctrl+r", says(FINDS_BY_ITSELF if watches else "")),
            (answered(),),
            (sets(follower=HandEngine(label="SIMULATED slow", right=RightToAct(role))),),
            (ages(LOOKING_PERIOD),),
            (answered(), engine_has(closed=True)),
            ("", top(" ~~ SIMULATED slow")),
        ]
        for role, watches in ((Role.WATCH, True), (Role.REFEREE, False))
    },
    "nothing of an engine that has ended looks live": [
        (Driver.set_up, "all passed or waived"),
        (
            has(failure=GONE),
            top(" ENDED  SIMULATED nominal, screen frozen at 22:13:20"),
            no("age <0.5s"),
            no("all passed"),
            "Checks  old: of 22:13:20",
            no("F5 starts"),
            lambda d: "^R start the engine again" in d.rows()[-1],
        ),
        ("f5", says_only(f"Refused: start: {GONE}")),
    ],
    "that another console may act is no fault": [
        (
            has(right=RightToAct(holder="bo@tent")),
            lambda d: d.rows()[1].startswith(" NOTE  bo@tent has the right to act"),
            no("FAULT"),
        ),
        (
            has(faults=("the door is on fire",)),
            lambda d: d.rows()[1].startswith(" NOTE "),
            lambda d: "FAULT the door is on fire" in d.rows()[2],
        ),
        (has(failure=GONE), no("has the right to act")),
    ],
    "a number that could not be asked for is asked for again": [
        (Driver.set_up,),
        # a start was withdrawn, its number is used
        (sets(used_numbers={(1, 1): 1}, no_number="the disk is silent"),),
        (lambda d: setattr(d.console.panes.setup, "number_used", True),),
        ("enter", "x the disk is silent"),
        (sets(no_number=None),),
        ("f5", set_up_with(run_number=2)),
    ],
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
    "the footer shows at most seven keys that are possible with their words": [
        ("f3", keys_are("F7 Zero  Enter Menu  x Next run  h History  p Plan  s Standings")),
        ("f2 enter f6 f5", keys_are("F8 ABORT  Enter Menu  i Incident  h History  p Plan")),
        (
            passes(6.0),
            keys_are("F8 ABORT  F9 Timeout  Enter Menu  1-6 Step  i Incident"),
        ),
        (Driver.finish, keys_are("Enter Menu  x Next run  1-6 Step  i Incident  h History")),
        (
            "enter f a enter",
            Phase.FINAL,
            keys_are("Enter Menu  x Next run  h History  p Plan  s Standings"),
        ),
    ],
    **{
        f"a terminal too small for the panes is a clock with abort and timeout: {key}": [
            (in_sizes((60, 17), (59, 24), (24, 8)),),
            (Driver.run, "RUNNING  0:01.0", "F8 ABORT"),
            (f"{key} escape", Phase.RUNNING),
            (f"{key} y", act),
        ]
        for key, act in (("f8", Abort(NO_REASON)), ("f9", DeclareTimeout(NO_REASON)))
    },
    "the keys that start and end a run are named in every size": [
        (Driver.set_up,),
        *((resized(*size), lambda d: "F5 START" in d.rows()[-1]) for size in WIDTHS),
        ("f5",),
        *((resized(*size), footer("F8 ABORT")) for size in WIDTHS),
        (passes(6.0),),
        *(
            (
                resized(*size),
                footer("F8 ABORT  F9 Timeout", "F1 more"),
                lambda d: "…" not in d.rows()[-1],
            )
            for size in WIDTHS
        ),
    ],
    **{
        f"a second console aborts with two keys: {right.holder}, {sizes[-1][0]} cells": [
            (in_sizes(*sizes),),
            (types_every(0.0),),
            (Driver.run,),
            (has(right=right),),
            ("f8", *asked, has_right(right)),  # a question takes nothing over
            ("y", Abort("no reason given"), lambda d: not d.engine.right.holder),
        ]
        for right, sizes, asked in (
            (HELD, ((120, 36), (80, 24)), (HELD_SO, "y ABORT now")),
            (HELD, ((60, 17), (40, 12)), ("bo@tent", "Abort now?", "y yes")),
            (HELD, ((20, 5), (10, 3)), ()),
            (RightToAct(free=True), ((80, 24),), ("y ABORT now",)),
        )
    },
    "an abort over the palette counts though the run has just begun": [
        (Driver.set_up,),
        ("f5 ctrl+p",),
        (types_every(0.0),),
        (passes(6.0),),
        ("f8 y", Abort(NO_REASON)),
    ],
    "the commands on a terminal without room for them end nothing": [
        (opened((1, 1)),),
        (Driver.run,),
        ("ctrl+p pagedown pageup",),
        (resized(80, 24),),
        ("f8 y", Abort(NO_REASON)),
    ],
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
        ("f2 tab", "s Standings", "F10 Leave", no("typing; Esc"), no("waives")),
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
            (key, no_question, was_opened(*runs)),
        ]
        for key, runs in (
            ("s", [OpenRun(EARLIER.folder)]),
            ("i", [OpenRun(EARLIER.folder, invalid=True)]),
            ("enter", []),
            ("escape", []),
        )
    },
    **{
        f"a run that is {phase} and has no result is only scored, as it ended": [
            (
                on_engine(unfinished=(replace(CUT_OFF, phase=phase),)),
                f"A RESULT IS MISSING: run 2 of subject 3 Delft is {phase} and has none, last line",
                "score it as it ended",
                no("as if aborted"),
            ),
            ("s", no_question, was_opened(OpenRun(EARLIER.folder))),
        ]
        for phase in (Phase.STOPPED, Phase.FINAL)
    },
    "the footer says that letters type while they do": [
        ("f2", lambda d: d.rows()[-1].startswith("typing; Esc: keys  F7 Zero  Enter Set up")),
        ("f3", lambda d: "typing; Esc" not in d.rows()[-1]),
    ],
    "a teams file with broken lines says so at the set up": [
        (
            on_engine(teams=BROKEN),
            "teams.csv line 3",
            lambda d: "teams.csv" not in d.console.status,
        ),
        (
            "f2 9 enter f6",
            "x F2 corrects the team, Enter waives: 9 is not in the list",
            no("Subject 9 is not in the list"),
        ),
    ],
    "a console without the right to act says who has it and can take it": [
        (Driver.run,),
        (
            has(right=RightToAct(holder="bo@tent")),
            lambda d: (
                "bo@tent has the right to act; here an act asks before it takes it over"
                in d.rows()[1]
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
    "an act takes the right over after y on every pane": [
        (opened(gap=0.35),),
        *(
            row
            for key in ("f2", "f3", "f4", "h", "p", "s", "f1")
            for row in (
                (key,),
                (has(right=HELD), "here an act asks before it takes it over"),
                ("f6 y", says_only("This console has the right to act now.")),
            )
        ),
    ],
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
    await play(HandEngine, STORIES[story])
