"""The key that packs a team's runs."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.engine.shown.snapshot import ExportView
from madrob_console.ui.look.words import export_text
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import DEFAULTS, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

ZIP = "/results/exports/team_003_Delft_20261121_182139.zip"


@pytest.mark.parametrize(
    ("export", "text"),
    [
        (ExportView(3), "Packing the runs of subject 3 in the background ..."),
        (
            ExportView(3, ZIP),
            "Packed: /results/exports/team_003_Delft_20261121_182139.zip (y copies it)",
        ),
        (ExportView(3, "/home/a.zip"), "Packed: /home/a.zip (y copies it)"),
        (
            ExportView(3, "/home/a.zip", "b.csv: cannot be read"),
            "Packed, but not all (b.csv: cannot be read): /home/a.zip (y copies it)",
        ),
        (ExportView(3, "", "the disk is full"), "No zip of subject 3: the disk is full"),
    ],
)
def test_a_line_says_what_has_become_of_an_export(export: ExportView, text: str) -> None:
    assert export_text(export) == text


@pytest.mark.parametrize("practice", [True, False])
def test_e_packs_official_or_practice_runs_as_the_marked_one_is(
    engine: FakeEngine, tmp_path: Path, *, practice: bool
) -> None:
    write(tmp_path, summary(7, practice=practice))

    async def drive() -> None:
        async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
            for pane in ("h", "s"):
                await driver.press("escape", pane)
                await driver.app.workers.wait_for_complete()
                await driver.settle()
                await driver.press("e")
            assert engine.exported == 2 * [-7 if practice else 7]

    asyncio.run(drive())


def test_e_packs_the_team_of_the_marked_runs_competition(
    engine: FakeEngine, tmp_path: Path
) -> None:
    write(tmp_path, summary(7, competition="Spring Cup", hour=1))
    write(tmp_path, summary(7))

    async def drive() -> None:
        async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
            for pane in ("h", "s"):
                await driver.press("escape", pane)
                await driver.app.workers.wait_for_complete()
                await driver.settle()
                await driver.press("e")
            assert engine.exported_of == ["Spring Cup", "Autumn Cup"]

    asyncio.run(drive())


def test_e_packs_the_team_of_the_run_or_the_marked_one_and_says_where_the_zip_is(
    engine: FakeEngine, tmp_path: Path
) -> None:
    write(tmp_path, summary(7))
    defaults = replace(DEFAULTS, results=tmp_path)

    async def drive() -> None:
        async with driving(engine, defaults=defaults) as driver:
            await driver.press("escape", "h")
            await driver.app.workers.wait_for_complete()
            await driver.settle()
            assert " e Export" in driver.text
            await driver.press("e")
            assert engine.exported == [7]
            assert driver.console.status == export_text(ExportView(7))
            engine.export = ExportView(7, f"{tmp_path}/exports/a.zip")
            await driver.settle()
            assert driver.console.status == f"Packed: {tmp_path}/exports/a.zip (y copies it)"
            await driver.press("f4", "e")
            assert engine.exported == [7]
            assert "no team is marked or set up" in driver.console.status
            await driver.set_up()
            await driver.press("f4", "e")
            assert engine.exported == [7, 1]

    asyncio.run(drive())
