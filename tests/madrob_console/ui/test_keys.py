from __future__ import annotations

import getpass
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest
from rich.cells import cell_len
from textual.events import Paste
from textual.geometry import Offset
from textual.widgets import Input

from madrob_console.engine.requests import OpenRun
from madrob_console.engine.snapshot import ExportView, Pulse
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    ConfirmPose,
    DecideProtest,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Waive,
    WithdrawProtest,
    ZeroHandle,
)
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.records import CheckName, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.controls import Choice
from madrob_console.ui.cells.lines import Lines, Target
from madrob_console.ui.cells.table import Table
from madrob_console.ui.keys.key_table import KEYS, MENU
from madrob_console.ui.keys.questions import NO_REASON
from madrob_console.ui.look.words import cut_inside, wrapped
from madrob_console.ui.panes.check_list import CheckList
from madrob_console.ui.panes.help_pane import HelpText
from madrob_console.ui.panes.history_pane import HistoryPane
from scoring.protocol import Side, Signal, Step
from tests.madrob_console.run_folders import summary
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    Driver,
    Stories,
    Story,
    acting,
    answered,
    driving,
    engine_does,
    follow,
    has,
    in_sizes,
    no,
    opened,
    pane,
    passes,
    play,
    says,
    sets,
    setup_of,
    types_every,
)
from tests.madrob_console.ui.inline_engine import FOLDER, HandEngine, start
from tests.madrob_console.ui.prepared import a_setup

SET_UP = (lambda d: d.engine.act(SetUp(a_setup())),)
STOPPED = ((Driver.run,), (Driver.finish,))
COUNTDOWN = ((Driver.set_up,), ("f5",), (passes(1.0),))
SITUATIONS: Stories = {
    "nothing is set up": [("f3",)],
    "a run is set up": [SET_UP, ("f3",)],
    "the pose is confirmed": [(Driver.set_up,), ("f3",)],
    "the door is open": [(sets(angle=0.4),), SET_UP, ("f3",)],
    "the countdown runs": COUNTDOWN,
    "somebody started too early": [*COUNTDOWN, (engine_does(HandEngine.touch),)],
    "the run goes on": [(Driver.run,)],
    "the run has stopped": STOPPED,
    "the result is final": [*STOPPED, ("enter f a enter",)],
}


@pytest.mark.parametrize(
    ("situation", "cases"),
    [
        ("the pose is confirmed", [("f5", Start())]),
        (
            "a run is set up",
            [
                ("f6", ConfirmPose()),
                ("f7", ZeroHandle()),
                ("enter w 1", Waive(CheckName.POSE, "checked by hand")),
                ("enter w space", Waive(CheckName.POSE, NO_REASON)),
            ],
        ),
        ("the door is open", [("enter w 2 2", Waive(CheckName.POSE, "known testbed fault"))]),
        (
            "somebody started too early",
            [
                ("enter r", RestartCountdown()),
                ("enter a 2", AcceptFalseStart("sensor false alarm")),
                ("f8 2 y", Abort("testbed fault")),
            ],
        ),
        (
            "the run goes on",
            [
                ("f8 1 y", Abort("robot unsafe")),
                ("f9 1 y", DeclareTimeout("the team gives up")),
                ("3 c", Rule(Step.OPEN, confirmed=True, reason=NO_REASON)),
                ("i h", MarkIncident(IncidentKind.HUMAN_INTERVENTION)),
                ("i c", MarkIncident(IncidentKind.COLLISION)),
                ("i f", MarkIncident(IncidentKind.FALL)),
                (
                    "i o v x f enter",
                    MarkIncident(IncidentKind.OTHER, "vxf", 1.0),
                ),
                ("3 s", Rule(Step.OPEN, None, NO_REASON)),
                ("i w o k enter", AddNote("ok")),
            ],
        ),
        (
            "the run has stopped",
            [
                (
                    "6 r 3 d",
                    Rule(Step.LOCK, confirmed=False, reason="sensor false alarm"),
                ),
                ("enter f b n o enter", Finalise(TeamWord.ABSENT, "Ada", "no")),
                ("x", SetUp(a_setup(run_number=2))),
            ],
        ),
        (
            "the result is final",
            [
                ("enter u 1 y", Reissue("a step was ruled wrongly")),
                ("x", SetUp(a_setup(2))),
            ],
        ),
    ],
)
async def test_a_key_hands_in_its_act(
    driver: Driver,
    engine: HandEngine,
    situation: str,
    cases: Sequence[tuple[str, Act]],
) -> None:
    await follow(driver, SITUATIONS[situation])
    engine.instead = engine.would_refuse
    for keys, act in cases:
        await follow(driver, [(keys, act, lambda d: d.console.status.startswith("Done: "))])


@pytest.mark.parametrize(
    ("situation", "reasons"),
    [
        ("nothing is set up", dict.fromkeys(("f5", "f6", "f8", "i"), "no run is set up yet")),
        (
            "a run is set up",
            {
                "f5": "F6 confirms the start pose",
                "f8": "the run has not started",
                "f9": "the run has not started",
                "1": "the run has not started",
            },
        ),
        (
            "the countdown runs",
            {
                "f5": "the countdown is running",
                "f9": "the countdown is running",
                "x": "the countdown is running",
            },
        ),
        ("the run goes on", dict.fromkeys(("f5", "f6", "f7", "x"), "a run is going on")),
        ("the run has stopped", {"f8": "the run has stopped"}),
        ("the result is final", dict.fromkeys(("1", "i", "f8"), "the result is final")),
    ],
)
async def test_a_key_that_is_not_possible_says_why_and_does_nothing(
    driver: Driver, engine: HandEngine, situation: str, reasons: Mapping[str, str]
) -> None:
    await follow(driver, SITUATIONS[situation])
    before, done = engine.run, list(engine.acts)
    for key, reason in reasons.items():
        await driver.press(key)
        assert reason in driver.console.status
        assert not driver.console.dialogs
        assert (engine.run, engine.acts) == (before, done)


def test_start_and_abort_are_separate_keys_and_no_two_keys_are_the_same() -> None:
    pressed = [key for entry in KEYS.values() for key in entry.keys.split(",") if key]
    assert len(pressed) == len(set(pressed))
    for name in ("live", "results", "history"):
        letters = [entry.cap for entry in MENU if name in entry.where]
        assert len(letters) == len(set(letters))
    assert KEYS["start"].keys == "f5"
    assert KEYS["abort"].keys == "f8"


def test_no_key_is_one_that_tmux_or_screen_keep_for_themselves() -> None:
    pressed = {key for entry in KEYS.values() for key in entry.keys.split(",")}
    assert not pressed & {"ctrl+b", "ctrl+a", "escape"}


@pytest.mark.parametrize("over", [False, True])
async def test_a_console_that_comes_back_to_a_run_shows_it(*, over: bool) -> None:
    engine = start(HandEngine(), 6.0)
    rows: Story = [("", pane("live"), "RUNNING")]
    if over:
        engine.stop()
        rows = [
            ("", pane("live")),
            (engine_does(HandEngine.score),),
            (Driver.settle, pane("results")),
        ]
    await play(lambda: engine, rows)


def test_a_path_is_whole_or_cut_in_its_middle_and_never_broken_in_a_number() -> None:
    path = "/home/ada/madrob_runs/subject_001_cond_001_run_001_20231114_221320"
    assert cut_inside(path, len(path)) == path
    short = cut_inside(path, 40)
    assert len(short) == 40
    assert short.startswith("/home/ada")
    assert short.endswith("20231114_221320")
    for width in range(16, len(path)):
        rows = wrapped(f"Packed: {path}", width)
        assert "".join(rows).replace(" ", "") == f"Packed:{path}"
        assert all(row[-1] in "/_:" for row in rows[:-1])


def copied(text: str) -> Callable[[Driver], object]:
    """What the terminal was handed last."""
    return lambda driver: driver.copies[-1:] == [text]


def subjects(*numbers: int) -> Callable[[Driver], object]:
    return lambda driver: (
        [run.subject for run in driver.console.query_one(HistoryPane).table.rows] == [*numbers]
    )


async def double_click_below(driver: Driver) -> None:
    """The row below the marked one."""
    y = driver.rows().index(driver.marked)
    await driver.click_at(10, y + 1, 2)
    await driver.answered()


IN_ORDER = [
    MarkIncident(IncidentKind.COLLISION),
    AddNote("late"),
    Abort("the team asks for it"),
]

STORIES: Stories = {
    "the help begins with the main lines and has each key that there is here once": [
        ("escape f1", "F8 y aborts", "z takes it back", "Practice never counts"),
        ("slash '=F5 START' enter", "START not now: no run is set up yet"),
        ("slash '=F6 Pose' enter", lambda d: d.text.count("F6  Pose") == 1),
        *(
            row
            for key in MENU
            for row in (
                ("slash",),
                (acting(Driver.send, Paste(f"{key.label} {key.help[:20]}")),),
                ("enter", f"{key.label} {key.help[:20]}", no(key.help[:40])),
            )
        ),
        (Driver.complete,),
        ("f1 slash '=Sign sign' enter", "Enter f Sign sign the result with the team's word"),
        (acting(Driver.click, "Enter f", "Sign"), "What does the team say?"),
    ],
    "rows are marked and opened and heads sort": [
        (opened(LARGE, runs=[summary(number) for number in (1, 2, 3)]),),
        (answered("escape h"), subjects(3, 2, 1)),
        (acting(Driver.click, "sub"), subjects(1, 2, 3)),
        (acting(Driver.click, "sub"), subjects(3, 2, 1)),
        (double_click_below,),
        (answered("o"), lambda d: d.engine.sent(OpenRun) == [OpenRun(summary(2).folder)]),
    ],
    "y copies the result its folder and a line that fetches it": [
        (opened(defaults=replace(DEFAULTS, host="hall")),),
        *STOPPED,
        ("enter y p", copied(FOLDER), says(FOLDER)),
        ("enter y s", copied(f"scp -r {getpass.getuser()}@hall:{FOLDER} .")),
        (
            "enter y r",
            lambda d: d.copies[-1].startswith("COMPLETED"),
            lambda d: "17.432" in d.copies[-1],
        ),
        ("enter y enter escape", lambda d: len(d.copies) == 3),  # nothing more
        (has(export=ExportView(1, "/home/ada/a team.zip")),),
        ("enter y l", copied(f"scp '{getpass.getuser()}@hall:/home/ada/a team.zip' .")),
    ],
    "y copies the marked row with its heads": [
        (opened(runs=[summary(7)]),),
        (answered("escape h"),),
        (
            "enter y m",
            lambda d: (
                dict(zip(*(row.split("\t") for row in d.copies[-1].splitlines()), strict=True))[
                    "subj"
                ]
                == "7"
            ),
        ),
        ("enter y p", lambda d: Path(d.copies[-1]).name == summary(7).folder),
    ],
    "letters of the menu say how to press them": [
        *STOPPED,
        ("f4 f", says("Sign: press Enter, then f")),
        ("u", says("Re-issue: not now: only a final result is re-issued")),
        ("v", lambda driver: "Void" not in driver.console.status),  # a key of the result itself
    ],
    "a command is found by its name": [
        ("f3",),
        *(
            row
            for typed, command in (
                ("again", "Enter X Again"),
                ("lock", "6 step 6: lock the door"),
                ("take back", "z Take back"),
            )
            for row in ((f"ctrl+p '={typed}'",), (Driver.settle, command), ("escape",))
        ),
    ],
    "there may be nothing to copy": [
        ("f3 enter y", says("Refused: copy: there is no row")),
    ],
    "panes have keys that work while a text is typed": [
        ("f3", pane("live")),
        ("f4", pane("results")),
        ("f2", pane("setup")),
        ("f1", pane("help")),
        ("f1", pane("setup")),
    ],
    "keys faster than the screen are taken in their order": [
        (Driver.run,),
        ("i c i w =late enter f8 4 y", lambda d: d.engine.acts[-3:] == IN_ORDER),
    ],
    "a check is waived only where one fails": [
        (Driver.set_up,),
        ("f3",),
        ("enter", "Not now: w waive: no check fails"),
    ],
    "no handle data no zero": [
        *SITUATIONS["a run is set up"],
        (sets(silent=list(Signal)),),
        (passes(3.0),),
        ("f7", says("no handle force comes now")),
    ],
    "a run that starts shows live and a result shows itself": [
        (Driver.set_up, pane("setup")),
        ("f5", pane("live")),
        (passes(6.0), Phase.RUNNING),
        (Driver.finish, pane("results")),
    ],
    "a result waits until the referee has typed": [
        (Driver.run,),
        ("i w a",),
        (Driver.finish, pane("live")),
        ("b enter", AddNote("ab"), pane("results")),
    ],
    "the keys of the footer are clicked": [
        (in_sizes(LARGE),),
        ("f3",),
        (acting(Driver.click, "History"), pane("history")),
        (Driver.run,),
        ("f3",),
        (acting(Driver.click, "6 ", "Step"), "Step 6: lock the door"),
    ],
    "answers are clicked": [
        (Driver.run,),
        (acting(Driver.click, "F8"),),
        (acting(Driver.click, "testbed fault"),),
        (acting(Driver.click, "no (also Enter, Escape)"), Phase.RUNNING),
        (acting(Driver.click, "F8"),),
        (acting(Driver.click, "robot unsafe"),),
        (acting(Driver.click, "y yes"), Abort("robot unsafe")),
    ],
    "a click beside a question is for nothing behind it": [
        (Driver.run,),
        ("f8", "ABORT the run"),
        (acting(Driver.click, "1 touch", ">"), "ABORT the run", no("Step 1: touch")),
        ("escape",),
        (acting(Driver.click, "1 touch", ">"), "Step 1: touch"),
    ],
    "a click that comes as the question changes is left out": [
        (Driver.run,),
        ("f10",),
        (has(pulse=Pulse(server=4)), "Nobody can say whether the run goes on"),
        (types_every(0.0),),
        (acting(Driver.click, "y yes"), lambda d: d.app.is_running, "the click is left out"),
        (types_every(1.0),),
        (acting(Driver.click, "y yes"), lambda d: not d.app.is_running),
    ],
    "the form is filled by the mouse": [
        ("escape",),
        (acting(Driver.click, "Door Bots"), lambda d: isinstance(d.app.focused, Input)),
        ("escape",),
        (acting(Driver.click, "CCW >", "Opening side"),),
        (
            acting(Driver.click, "Set up this run"),
            lambda d: setup_of(d).condition.opening_side is Side.CW,
        ),
        (
            acting(Driver.click, "confirms the start pose", times=2),
            "Waive 'start pose' for this run",
        ),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(HandEngine, STORIES[story])


def named_keys(driver: Driver) -> dict[str, tuple[int, int]]:
    """Where each key stands that can be clicked now, by its name."""
    found: dict[str, tuple[int, int]] = {}
    for widget in driver.console.query(Lines):
        if isinstance(widget, Choice | HelpText):
            continue  # their targets are no keys
        left, top, _, height = widget.content_region
        heads = [one.title for one in widget.columns] if isinstance(widget, Table) else []
        heads += CheckName if isinstance(widget, CheckList) else ()
        for y, row in enumerate(widget.lines(widget.room.width)[:height], top):
            for span, x in zip(
                row, accumulate((cell_len(one.text) for one in row), initial=left), strict=False
            ):
                if not isinstance(span, Target) or span.click.endswith(tuple(heads)):
                    continue
                at = Offset(x, y)
                on_screen = driver.console.region.contains_point(at)
                if driver.console.dialogs and not driver.console.is_clickable(at):
                    continue  # beside a question
                if on_screen and driver.console.get_widget_at(x, y)[0] is widget:
                    found.setdefault(span.click, (x, y))
    return found


PLACES = [
    ("nothing is set up", "f2 f3"),
    ("the pose is confirmed", "f3"),
    ("somebody started too early", "f3 'f3 escape'"),
    ("the run goes on", "f3 'f3 f8 1' 'f3 f9'"),
    ("the run goes on", "'f3 4 r' 'f3 enter'"),
    ("the run has stopped", "f2 f4 'f4 enter g home up up' 'f4 p'"),
    ("the run has stopped", "'f4 s' 'f4 h' 'f4 h slash =a enter'"),
    ("the run has stopped", "'f4 enter' 'f4 enter c' 'f4 enter P' 'f4 enter f'"),
    ("the result is final", "'f4 enter u 1'"),
]
"""The keys that lead to places where keys are named."""


@pytest.mark.parametrize(("situation", "places"), PLACES)
async def test_each_key_that_a_screen_names_does_something_where_it_is_clicked(
    situation: str, places: str
) -> None:
    engine = HandEngine(plan=Plan((PlanLine(Task(1, 1), 2), PlanLine(Task(2, 7), 1))))
    async with driving(engine, runs=[summary(number) for number in (1, 2, 3)]) as driver:
        await follow(driver, SITUATIONS[situation])
        engine.instead = engine.would_refuse
        for keys in shlex.split(places):
            await follow(driver, [("escape escape escape",), (keys,)])
            named = named_keys(driver).keys() - {"f10"}  # it leaves
            assert named
            for key in sorted(named):
                await follow(driver, [("escape escape escape",), (keys,)])
                before, acts = driver.text, len(engine.acts)
                if (place := named_keys(driver).get(key)) is not None:  # a list stays as turned
                    await driver.click_at(*place)
                    assert driver.text != before or len(engine.acts) > acts, (keys, key)


def test_every_act_is_a_command_or_asked_behind_one() -> None:
    asked = {DecideProtest.name, WithdrawProtest.name}  # by Protest
    assert {act.name for act in ACTS} - {key.act for key in KEYS.values()} == asked
