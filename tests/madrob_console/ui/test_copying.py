"""What is shown can be taken to another machine's clipboard."""

from __future__ import annotations

import asyncio
import base64
import re
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.folders import pictures_in
from madrob_console.engine.shown.snapshot import ExportView
from madrob_console.ui.keys.asks import Copy, ask_copy
from madrob_console.ui.keys.clipboard import clipboard_sequences
from madrob_console.ui.look.words import cut_inside, wrapped
from madrob_console.ui.panes.history_pane import HistoryPane
from madrob_console.ui.panes.run_marks import RunMarks
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.ui.driver import DEFAULTS, driving
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine

PLAIN = re.compile(r"\x1b\]52;c;([A-Za-z0-9+/=]*)\x07")


def copied(written: list[str]) -> str:
    """The text that the terminal was handed last."""
    (encoded,) = PLAIN.findall(written[-1])[:1]
    return base64.b64decode(encoded).decode()


@pytest.mark.parametrize("environ", [{"TERM": "xterm-256color"}, {"TERM": "screen"}, {}])
def test_a_terminal_is_handed_the_plain_sequence(environ: dict[str, str]) -> None:
    sequence = clipboard_sequences("Zoë\n", environ)
    assert PLAIN.fullmatch(sequence)
    assert copied([sequence]) == "Zoë\n"


@pytest.mark.parametrize("environ", [{"TERM": "tmux-256color"}, {"TMUX": "/tmp/t,1,0"}])
def test_a_tmux_is_handed_it_wrapped_as_well(environ: dict[str, str]) -> None:
    plain = clipboard_sequences("a", {})
    passed = "\x1bPtmux;" + plain.replace("\x1b", "\x1b\x1b") + "\x1b\\"
    assert clipboard_sequences("a", environ) == plain + passed


def test_y_copies_the_result_its_folder_and_a_line_that_fetches_it(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "ada")

    async def drive() -> None:
        async with driving(engine, defaults=replace(DEFAULTS, host="hall")) as driver:
            written: list[str] = []
            await driver.run()
            engine.finish()
            await driver.settle()
            monkeypatch.setattr(driver.app._driver, "write", written.append)
            await driver.press("y", "p")
            assert copied(written) == FOLDER
            assert FOLDER in driver.console.status
            await driver.press("y", "s")
            assert copied(written) == f"scp -r ada@hall:{FOLDER} ."
            await driver.press("y", "r")
            assert copied(written).startswith("COMPLETED")
            assert "17.432" in copied(written)
            before = list(written)
            await driver.press("y", "enter")
            assert [text for text in written[len(before) :] if PLAIN.search(text)] == []
            engine.export = ExportView(1, "/home/ada/a team.zip")
            await driver.settle()
            await driver.press("y", "l")
            assert copied(written) == "scp 'ada@hall:/home/ada/a team.zip' ."

    asyncio.run(drive())


def test_y_copies_the_marked_row_with_its_heads(
    engine: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, summary(7))

    async def drive() -> None:
        async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
            written: list[str] = []
            await driver.press("escape", "h")
            await driver.app.workers.wait_for_complete()
            await driver.settle()
            monkeypatch.setattr(driver.app._driver, "write", written.append)
            await driver.press("y", "m")
            heads, cells = copied(written).splitlines()
            row = dict(zip(heads.split("\t"), cells.split("\t"), strict=True))
            assert row["subj"] == "7"
            marked = driver.console.query_one(HistoryPane).selected
            assert marked is not None
            await driver.press("y", "p")
            assert copied(written) == str(tmp_path / marked.folder)

    asyncio.run(drive())


def test_there_may_be_nothing_to_copy(engine: FakeEngine) -> None:
    assert ask_copy("", "", "", "", "ada@hall") == "there is no row, no result and no run to copy"

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f3", "y")
            assert "Refused: copy: there is no row" in driver.console.status

    asyncio.run(drive())


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


def test_a_result_tells_how_many_pictures_there_are_and_y_copies_where(
    engine: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.madrob_console.ui.fake_engine.FOLDER", str(tmp_path))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("01_door_opens_camera.jpg", "02_door_closes_camera.jpg", "index.json"):
        (pictures / name).touch()

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            await driver.settle()
            marks = driver.app.query_one(RunMarks)
            while not marks.pictures:  # they are looked for in a thread
                await driver.settle()
            await driver.settle()
            shown = "".join(span.text for line in marks.lines(200) for span in line)
            assert f"2 pictures        {pictures}" in shown
            asked = driver.console.ask_copy("ada")
            assert not isinstance(asked, str)
            copy = asked.make("f")
            assert isinstance(copy, Copy)
            assert copy.text == str(pictures)

    asyncio.run(drive())


def test_what_is_no_folder_of_pictures_counts_as_none(tmp_path: Path) -> None:
    assert pictures_in(str(tmp_path)) == 0
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "mine.jpg").touch()
    assert pictures_in(str(tmp_path)) == 0
    (tmp_path / "pictures" / "index.json").touch()
    assert pictures_in(str(tmp_path)) == 1
