"""A protest on the screens: filed, seen, looked at again, decided."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from textual.widgets import Input

from madrob_console.archive.history import RunSummary
from madrob_console.common.names import SourceKind
from madrob_console.config.tables import ConsoleSettings
from madrob_console.referee.acts import DecideProtest, FileProtest, WithdrawProtest
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.records import ProtestEnd
from madrob_console.ui.look.words import export_text
from scoring.protocol import Step
from tests.madrob_console.run_folders import EPOCH, summary, write
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    SMALL,
    Driver,
    Stories,
    driving,
    in_sizes,
    no,
    play,
    says,
)
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine
from tests.madrob_console.ui.test_screens import compare

SIZES = (SMALL, LARGE)
IDS = [f"{width}x{height}" for width, height in SIZES]
OPEN = Flag(
    FlagKind.PROTEST, "protest 1 (step 4) OPEN, UNDECIDED", FlagWeight.ALARM, undecided=True
)
TEXT = "we were through earlier"


async def run_is_over(driver: Driver) -> None:
    """A result is there, on a real testbed."""
    driver.engine.kind = SourceKind.ROS
    await driver.run()
    for step in Step:
        driver.engine.tick(1.0)
        driver.engine.do_step(step)
    await driver.finish()
    await driver.settle()


async def protested(driver: Driver) -> None:
    """The team protests about step 4."""
    await run_is_over(driver)
    await driver.press("enter", "P", "4", "1")
    await driver.type(TEXT)
    await driver.press("enter")


@pytest.mark.parametrize("size", SIZES, ids=IDS)
async def test_the_dialogs_and_the_result_are_as_they_were_looked_at(
    driver: Driver, size: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    await run_is_over(driver)
    await driver.press("enter", "P")
    compare("protest_about", size, driver.text, request)
    await driver.press("4")
    compare("protest_who", size, driver.text, request)
    await driver.press("1")
    await driver.type(TEXT)
    await driver.press("enter")
    compare("protest_open", size, driver.text, request)
    await driver.press("enter", "P")
    compare("protest_waits", size, driver.text, request)
    await driver.press("d")
    compare("protest_decision", size, driver.text, request)
    await driver.press("escape", "enter", "f")
    compare("protest_unsigned", size, driver.text, request)
    await driver.press("escape", "enter", "P", "d", "p")
    await driver.type("seen on video")
    await driver.press("enter")
    compare("protest_decided", size, driver.text, request)


@pytest.mark.parametrize("size", SIZES, ids=IDS)
async def test_lists_with_a_protest_are_as_they_were_looked_at(
    engine: FakeEngine, size: tuple[int, int], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    runs = some_runs()
    for run in runs:
        write(tmp_path, run)
    engine.history = list(runs)
    engine.plan = Plan((PlanLine(Task(1, 7), 2), PlanLine(Task(2, 7), 2)))

    async with driving(engine, size, replace(DEFAULTS, results=tmp_path)) as driver:
        for key, name in (("h", "history"), ("s", "standings"), ("p", "plan")):
            await driver.answered("escape", key)
            await driver.press("down")  # the one with a protest
            compare(f"protest_{name}", size, driver.text, request)


def some_runs() -> Sequence[RunSummary]:
    """Three runs; a protest against one of them is open."""
    return (
        summary(1, hour=0, final=True, team_word="acknowledged"),
        summary(2, hour=2, protest_filed=EPOCH, protest_at=6.5, flags=(OPEN,)),
        summary(2, run_number=2, hour=3, final=True, team_word="acknowledged"),
    )


async def test_e_packs_the_dossier_of_the_marked_run_or_the_shown_one(
    engine: FakeEngine, tmp_path: Path
) -> None:
    run = summary(7)
    write(tmp_path, run)

    async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
        await driver.answered("escape", "h")
        await driver.press("enter", "E")
        assert engine.export is not None
        assert driver.console.status == export_text(engine.export)
        assert "Packing the dossier of" in driver.console.status
        await driver.press("f4", "enter")
        assert "Dossier" not in driver.text
        await driver.press("escape")
        await run_is_over(driver)
        await driver.press("f4", "enter", "E")
        assert engine.dossiers == [run.folder, Path(FOLDER).name]


# ---------------------------------------------------------------- R


async def test_r_says_what_to_type_where_the_terminal_cannot_be_lent(
    engine: FakeEngine, tmp_path: Path
) -> None:
    run = summary(7, protest_filed=EPOCH, protest_at=6.5)
    write(tmp_path, run)

    look = ConsoleSettings()
    defaults = replace(DEFAULTS, results=tmp_path)
    async with driving(engine, LARGE, defaults, look=look) as driver:
        await driver.answered("escape", "h")
        await driver.press("enter", "R")
        words = driver.console.status
        assert "Type in another terminal: madrob console --testbed replay" in words
        assert f"{tmp_path}/{run.folder} --at=6.500" in words


def filed(text: str, team: str, about: str = "") -> Callable[[Driver], object]:
    return lambda driver: (
        isinstance(act := driver.engine.acts[-1], FileProtest)
        and (act.text, act.team) == (text, team)
        and about in act.about
    )


def refuses(why: str | None) -> Callable[[Driver], object]:
    """The engine refuses each act, or none any more."""

    def change(driver: Driver) -> None:
        vars(driver.engine).pop("act", None)
        if why is not None:
            vars(driver.engine)["act"] = lambda _act: why

    return change


STORIES: Stories = {
    "words that the disk refuses are there again": [
        (run_is_over,),
        (refuses("No space left on device"),),
        (f"enter P 4 1 '={TEXT}' enter", says("No space left on device")),
        ("", lambda d: not d.engine.run.protests),
        (refuses(None),),
        ("enter P 3 1", no(TEXT)),  # that is about another step
        ("escape enter P 4 1", TEXT),
        ("enter", lambda d: [one.text for one in d.engine.run.protests] == [TEXT]),
        (
            "enter P a 4 1",
            lambda d: [one.query_one(Input).value for one in d.console.dialogs] == [""],
        ),
    ],
    "the keys file, decide and withdraw": [
        (in_sizes(LARGE),),
        (protested, filed(TEXT, "Door Bots", f"step 4: {Step.CROSS.text}")),
        ("enter P w 1", WithdrawProtest(1, "satisfied by the explanation")),
        (f"enter P t =2.5 enter 1 '={TEXT}' enter", filed(TEXT, "Door Bots")),
        (
            "enter P d r '=the video shows the foot' enter",
            DecideProtest(2, ProtestEnd.REJECTED, "the video shows the foot", "Ada"),
        ),
    ],
    "nothing is replayed while a run goes on and where there is none": [
        ("f4 enter", no("Replay")),
        ("escape",),
        (Driver.run,),
        ("f4 enter", "Note", no("Replay")),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])
