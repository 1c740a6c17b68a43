from __future__ import annotations

import base64
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from textual.events import MouseDown, MouseUp
from textual.widgets import Input

from madrob_console.archive.folders import pictures_in
from madrob_console.engine.snapshot import ExportView, Pulse
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.records import CheckName, IncidentKind, TeamWord
from madrob_console.referee.run import Phase, stop
from madrob_console.ui.keys.dialogs import Copy, ask_copy
from madrob_console.ui.keys.key_table import (
    FUNCTION_KEYS,
    KEYS,
    LETTER_KEYS,
    MENU,
    START_ENGINE,
)
from madrob_console.ui.look.words import cut_inside, wrapped
from madrob_console.ui.panes.result_pane import ResultDetails
from madrob_console.ui.panes.runs_pane import HistoryPane
from scoring.protocol import Outcome, Side, Step
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    SMALL,
    Driver,
    Stories,
    acting,
    driving,
    has,
    in_sizes,
    pane,
    passes,
    play,
    says,
    sets,
    setup_of,
    types_every,
)
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine, a_setup


async def before_set_up(driver: Driver) -> None:
    await driver.press("f3")


async def after_set_up(driver: Driver) -> None:
    driver.engine.run = SetUp(a_setup()).apply(driver.engine._situation(), driver.engine.now)
    await driver.press("f3")


async def pose_confirmed(driver: Driver) -> None:
    await driver.set_up()
    await driver.press("f3")


async def door_open(driver: Driver) -> None:
    driver.engine.angle = 0.4
    await after_set_up(driver)


async def countdown(driver: Driver) -> None:
    await driver.set_up()
    await driver.press("f5")


async def false_start(driver: Driver) -> None:
    await countdown(driver)
    driver.engine.false_start()


async def running(driver: Driver) -> None:
    await driver.run()


async def stopped(driver: Driver) -> None:
    await driver.run()
    await driver.finish()


async def final(driver: Driver) -> None:
    await stopped(driver)
    await driver.press("enter", "f", "a", "enter")


Situation = Callable[[Driver], Awaitable[None]]


@pytest.mark.parametrize(
    ("situation", "cases"),
    [
        (pose_confirmed, [(["f5"], Start())]),
        (
            after_set_up,
            [
                (["f6"], ConfirmPose()),
                (["f7"], ZeroHandle()),
                (["enter", "w", "1"], Waive(CheckName.POSE, "checked by hand")),
            ],
        ),
        (door_open, [(["enter", "w", "2", "2"], Waive(CheckName.POSE, "known testbed fault"))]),
        (
            false_start,
            [
                (["enter", "r"], RestartCountdown()),
                (["enter", "a", "2"], AcceptFalseStart("sensor false alarm")),
                (["f8", "2", "y"], Abort("testbed fault")),
            ],
        ),
        (
            running,
            [
                (["f8", "1", "y"], Abort("robot unsafe")),
                (["f9", "1", "y"], DeclareTimeout("the team gives up")),
                (["3", "c"], Rule(Step.OPEN, confirmed=True, reason="seen by the referee")),
                (["i", "h"], MarkIncident(IncidentKind.HUMAN_INTERVENTION)),
                (["i", "c"], MarkIncident(IncidentKind.COLLISION)),
                (["i", "f"], MarkIncident(IncidentKind.FALL)),
                (
                    ["i", "o", "v", "x", "f", "enter"],
                    MarkIncident(IncidentKind.OTHER, "vxf", 1.0),
                ),
                (["3", "s"], Rule(Step.OPEN, None, "seen by the referee")),
                (["i", "n", "o", "k", "enter"], AddNote("ok")),
            ],
        ),
        (
            stopped,
            [
                (
                    ["6", "r", "3", "d"],
                    Rule(Step.LOCK, confirmed=False, reason="sensor false alarm"),
                ),
                (["enter", "f", "b", "n", "o", "enter"], Finalise(TeamWord.ABSENT, "Ada", "no")),
                (["x"], SetUp(a_setup(run_number=2))),
            ],
        ),
        (
            final,
            [
                (["enter", "u", "1", "y"], Reissue("a step was ruled wrongly")),
                (["x"], SetUp(a_setup(2))),
            ],
        ),
    ],
)
async def test_a_key_hands_in_its_act(
    driver: Driver,
    engine: FakeEngine,
    situation: Situation,
    cases: Sequence[tuple[Sequence[str], Act]],
) -> None:
    await situation(driver)
    run, result = engine.run, engine.result
    for keys, act in cases:
        engine.run, engine.result = run, result
        await driver.press(*keys)
        assert engine.acts[-1] == act
        assert driver.console.status.startswith("Done: ")


@pytest.mark.parametrize(
    ("situation", "reasons"),
    [
        (before_set_up, dict.fromkeys(("f5", "f6", "f8", "i"), "no run is set up yet")),
        (
            after_set_up,
            {
                "f5": "F6 confirms the start pose",
                "f8": "the run has not started",
                "f9": "the run has not started",
                "1": "the run has not started",
            },
        ),
        (
            countdown,
            {
                "f5": "the countdown is running",
                "f9": "the countdown is running",
                "x": "the countdown is running",
            },
        ),
        (running, dict.fromkeys(("f5", "f6", "f7", "x"), "a run is going on")),
        (stopped, {"f8": "the run has stopped"}),
        (final, dict.fromkeys(("1", "i", "f8"), "the result is final")),
    ],
)
async def test_a_key_that_is_not_possible_says_why_and_does_nothing(
    driver: Driver, engine: FakeEngine, situation: Situation, reasons: Mapping[str, str]
) -> None:
    await situation(driver)
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


def test_no_screen_has_more_than_eighteen_keys() -> None:
    keys = [key for key in (*FUNCTION_KEYS, *LETTER_KEYS) if key.act != START_ENGINE]
    assert len([key for key in keys if key.name != "palette"]) == 18


async def test_a_console_that_comes_back_to_a_run_shows_it(engine: FakeEngine) -> None:
    async with driving(engine) as driver:
        await driver.run()
    async with driving(engine) as driver:
        assert driver.console.pane == "live"
        assert "RUNNING" in driver.text
    engine.run = stop(engine.run, Outcome.COMPLETED, engine.now, "step 6 is done")
    async with driving(engine) as driver:
        assert driver.console.pane == "live"
        engine.score()
        await driver.settle()
        assert driver.console.pane == "results"


async def click(driver: Driver, text: str, within: str = "", times: int = 1) -> None:
    """Click on the first character of a text, in the first row that holds it and `within`."""
    rows: Sequence[str] = driver.rows()
    y = next(y for y, row in enumerate(rows) if text in row and within in row)
    await driver.pilot.click(offset=(rows[y].index(text), y), times=times)
    await driver.settle()


async def press_button(driver: Driver, text: str) -> None:
    """The same as the terminal tells of it."""
    y, row = next((y, row) for y, row in enumerate(driver.rows()) if text in row)
    x = row.index(text)
    for kind in (MouseDown, MouseUp):
        event = kind(None, x, y, 0, 0, 1, False, False, False, x, y)
        event.set_sender(driver.app)
        assert driver.app._driver is not None
        driver.app._driver.send_message(event)
        await driver.pilot.pause()
    await driver.pilot.pause()


async def test_rows_are_marked_and_opened_and_heads_sort(
    engine: FakeEngine, tmp_path: Path
) -> None:
    for number in (1, 2, 3):
        write(tmp_path, summary(number))
    defaults = replace(DEFAULTS, results=tmp_path)

    async with driving(engine, LARGE, defaults=defaults) as driver:
        await driver.answered("escape", "h")
        table = driver.console.query_one(HistoryPane).table
        assert [run.subject for run in table.rows] == [3, 2, 1]
        await click(driver, "sub")
        assert [run.subject for run in table.rows] == [1, 2, 3]
        await click(driver, "sub")
        assert [run.subject for run in table.rows] == [3, 2, 1]
        y = next(y for y, row in enumerate(driver.rows()) if row.lstrip().startswith("> "))
        await driver.pilot.click(offset=(10, y + 1), times=2)
        await driver.settle()
        await driver.answered("o")
        assert engine.opened == [table.rows[1].folder]


PLAIN = re.compile(r"\x1b\]52;c;([A-Za-z0-9+/=]*)\x07")


def copied(written: list[str]) -> str:
    """The text that the terminal was handed last."""
    (encoded,) = PLAIN.findall(written[-1])[:1]
    return base64.b64decode(encoded).decode()


async def test_y_copies_the_result_its_folder_and_a_line_that_fetches_it(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "ada")

    async with driving(engine, defaults=replace(DEFAULTS, host="hall")) as driver:
        written: list[str] = []
        await driver.run()
        await driver.finish()
        monkeypatch.setattr(driver.app._driver, "write", written.append)
        await driver.press("enter", "y", "p")
        assert copied(written) == FOLDER
        assert FOLDER in driver.console.status
        await driver.press("enter", "y", "s")
        assert copied(written) == f"scp -r ada@hall:{FOLDER} ."
        await driver.press("enter", "y", "r")
        assert copied(written).startswith("COMPLETED")
        assert "17.432" in copied(written)
        before = list(written)
        await driver.press("enter", "y", "enter", "escape")
        assert [text for text in written[len(before) :] if PLAIN.search(text)] == []
        engine.export = ExportView(1, "/home/ada/a team.zip")
        await driver.settle()
        await driver.press("enter", "y", "l")
        assert copied(written) == "scp 'ada@hall:/home/ada/a team.zip' ."


async def test_y_copies_the_marked_row_with_its_heads(
    engine: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, summary(7))

    async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
        written: list[str] = []
        await driver.answered("escape", "h")
        monkeypatch.setattr(driver.app._driver, "write", written.append)
        await driver.press("enter", "y", "m")
        heads, cells = copied(written).splitlines()
        row = dict(zip(heads.split("\t"), cells.split("\t"), strict=True))
        assert row["subj"] == "7"
        marked = driver.console.query_one(HistoryPane).table.selected
        assert marked is not None
        await driver.press("enter", "y", "p")
        assert copied(written) == str(tmp_path / marked.folder)


async def test_there_may_be_nothing_to_copy(engine: FakeEngine) -> None:
    assert ask_copy("", "", "", "", "ada@hall") == "there is no row, no result and no run to copy"

    async with driving(engine) as driver:
        await driver.press("f3", "enter", "y")
        assert "Refused: copy: there is no row" in driver.console.status


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


async def test_a_result_tells_how_many_pictures_there_are_and_y_copies_where(
    engine: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.madrob_console.ui.fake_engine.FOLDER", str(tmp_path))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("01_door_opens_camera.jpg", "02_door_closes_camera.jpg", "index.json"):
        (pictures / name).touch()

    async with driving(engine) as driver:
        await driver.run()
        await driver.finish()
        details = driver.app.query_one(ResultDetails)
        while not details.pictures:  # they are looked for in a thread
            await driver.settle()
        await driver.settle()
        shown = "".join(span.text for line in details.lines(200) for span in line)
        assert f"2 pictures        {pictures}" in shown
        asked = driver.console.ask_copy("ada")
        assert not isinstance(asked, str)
        copy = asked.make("f")
        assert isinstance(copy, Copy)
        assert copy.text == str(pictures)


def test_what_is_no_folder_of_pictures_counts_as_none(tmp_path: Path) -> None:
    assert pictures_in(str(tmp_path)) == 0
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "mine.jpg").touch()
    assert pictures_in(str(tmp_path)) == 0
    (tmp_path / "pictures" / "index.json").touch()
    assert pictures_in(str(tmp_path)) == 1


async def test_the_first_page_of_the_help_has_every_key_and_the_main_lines(
    engine: FakeEngine,
) -> None:
    async with driving(engine, SMALL) as driver:
        await driver.press("escape", "f1")
        text = " ".join(driver.text.split())
        for key in (*FUNCTION_KEYS, *LETTER_KEYS):
            assert f"{key.cap} {key.label}" in text
        for words in ("F8 aborts", "z takes it back", "Practice never counts"):
            assert words in text


IN_ORDER = [
    MarkIncident(IncidentKind.COLLISION),
    AddNote("late"),
    Abort("the team asks for it"),
]

STORIES: Stories = {
    "panes have keys that work while a text is typed": [
        ("f3", pane("live")),
        ("f4", pane("results")),
        ("f2", pane("setup")),
        ("f1", pane("help")),
        ("f1", pane("setup")),
    ],
    "keys faster than the screen are taken in their order": [
        (Driver.run,),
        ("i c i n =late enter f8 4 y", lambda d: d.engine.acts[-3:] == IN_ORDER),
    ],
    "a check is waived only where one fails": [
        (pose_confirmed,),
        ("enter", "Not now: w waive: no check fails"),
    ],
    "no handle data no zero": [
        (after_set_up,),
        (sets(force=None),),
        ("f7", says("no fresh handle force")),
    ],
    "a run that starts shows live and a result shows itself": [
        (Driver.set_up, pane("setup")),
        ("f5", pane("live")),
        (passes(6.0), Phase.RUNNING),
        (Driver.finish, pane("results")),
    ],
    "a result waits until the referee has typed": [
        (Driver.run,),
        ("i n a",),
        (Driver.finish, pane("live")),
        ("b enter", AddNote("ab"), pane("results")),
    ],
    "the keys of the footer are clicked": [
        (in_sizes(LARGE),),
        ("f3",),
        (acting(click, "History"), pane("history")),
        (Driver.run,),
        ("f3",),
        (acting(click, "6 ", "Step"), "Step 6: lock the door"),
    ],
    "answers are clicked": [
        (Driver.run,),
        (acting(click, "F8"),),
        (acting(click, "testbed fault"),),
        (acting(click, "no (also Enter, Escape)"), Phase.RUNNING),
        (acting(click, "F8"),),
        (acting(click, "robot unsafe"),),
        (acting(click, "y yes"), Abort("robot unsafe")),
    ],
    "a click that comes as the question changes is left out": [
        (Driver.run,),
        ("f10",),
        (has(pulse=Pulse(server=4)), "Nobody can say whether the run goes on"),
        (types_every(0.0),),
        (acting(press_button, "y yes"), lambda d: d.app.is_running, "the click is left out"),
        (types_every(1.0),),
        (acting(press_button, "y yes"), lambda d: not d.app.is_running),
    ],
    "the form is filled by the mouse": [
        ("escape",),
        (acting(click, "Door Bots"), lambda d: isinstance(d.app.focused, Input)),
        ("escape",),
        (acting(click, "CCW >", "Opening side"),),
        (
            acting(click, "Set up this run"),
            lambda d: setup_of(d.engine).condition.opening_side is Side.CW,
        ),
        (acting(click, "F6 confirms the start pose", times=2), "Waive 'start pose' for this run"),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])
