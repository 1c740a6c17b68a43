"""A protest on the screens: filed, seen, looked at again, decided."""

from __future__ import annotations

from collections.abc import Sequence
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
from tests.madrob_console.ui.driver import DEFAULTS, LARGE, SMALL, Driver, driving
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


async def test_words_that_the_disk_refuses_are_there_again(
    driver: Driver, engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    await run_is_over(driver)
    with monkeypatch.context() as full:
        full.setattr(engine, "act", lambda _act: "No space left on device")
        await driver.press("enter", "P", "4", "1")
        await driver.type(TEXT)
        await driver.press("enter")
        assert "No space left on device" in driver.console.status
        assert not engine.run.protests
    await driver.press("enter", "P", "3", "1")
    assert TEXT not in driver.text  # that is about another step
    await driver.press("escape", "enter", "P", "4", "1")
    assert TEXT in driver.text
    await driver.press("enter")
    assert [one.text for one in engine.run.protests] == [TEXT]
    await driver.press("enter", "P", "a", "4", "1")
    (dialog,) = driver.console.dialogs
    assert dialog.query_one(Input).value == ""


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


@pytest.mark.parametrize("size", [LARGE])
async def test_the_keys_file_decide_and_withdraw(driver: Driver, engine: FakeEngine) -> None:
    await protested(driver)
    filed = engine.acts[-1]
    assert isinstance(filed, FileProtest)
    assert (filed.text, filed.team) == (TEXT, "Door Bots")
    assert filed.about == f"step 4: {Step.CROSS.text}"
    await driver.press("enter", "P", "w", "1")
    assert engine.acts[-1] == WithdrawProtest(1, "satisfied by the explanation")
    await driver.press("enter", "P", "t")
    await driver.type("2.5")
    await driver.press("enter", "1")
    await driver.type(TEXT)
    await driver.press("enter", "enter", "P", "d", "r")
    await driver.type("the video shows the foot")
    await driver.press("enter")
    assert engine.acts[-1:] == [
        DecideProtest(2, ProtestEnd.REJECTED, "the video shows the foot", "Ada")
    ]


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


async def test_nothing_is_replayed_while_a_run_goes_on_and_where_there_is_none(
    driver: Driver,
) -> None:
    await driver.press("f4", "enter")
    assert "Replay" not in driver.text
    await driver.press("escape")
    await driver.run()
    await driver.press("f4", "enter")
    assert "Note" in driver.text
    assert "Replay" not in driver.text
