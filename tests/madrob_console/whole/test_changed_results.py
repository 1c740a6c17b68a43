"""A result that is not the one that its journal says was written counts nowhere, and is named."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.scored import open_run
from madrob_console.cli.main import main
from madrob_console.cli.problems import BAD_INPUT
from madrob_console.cli.repairing import repair_all
from madrob_console.files.held import Hold
from madrob_console.referee.acts import Void
from madrob_console.referee.journal import HOLD_FILE
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.recorded_runs import final, without_digests

SAID = "result.json was changed after it was written: `madrob recover` makes it again"

Change = Callable[[str], str]


def number(key: str, value: str) -> Change:
    """The value of an indicator is another one."""
    return lambda text: re.sub(rf'("{key}": {{\s*"value": )[-\d.]+', rf"\g<1>{value}", text)


def word(before: str, after: str) -> Change:
    return lambda text: text.replace(before, after, 1)


CHANGES: dict[str, Change] = {
    "a better time": number("execution_time", "3.21"),
    "a lower force": number("roughness_of_door_actuation", "0.5"),
    "a lower level": number("capability_level", "4"),
    "one digit": number("passage_time", "4.0"),
    "another team": word('"team": "', '"team": "X'),
    "another word": word('"acknowledged"', '"acknowledges"'),
    "another outcome": word('"outcome": "completed"', '"outcome": "timeout"'),
    "no practice": word('"practice": true', '"practice": false'),
    "a remark": lambda text: re.sub(r'"remarks": \[\]', '"remarks": ["fine"]', text),
    "a version": word('"software": "', '"software": "9'),
    "a space": lambda text: f"{text} ",
    "a flag": word('"flags": [', '"flags_": ['),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    source = final()
    return shutil.copytree(source, tmp_path / "results" / source.name)


def change_result(folder: Path, change: Change) -> None:
    path = folder / RESULT_FILE
    before = path.read_text()
    assert change(before) != before
    path.write_text(change(before))


def summary(folder: Path) -> RunSummary:
    (run,) = History(folder.parent).refresh()
    return run


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    capsys.readouterr()
    code = main([*map(str, arguments)])
    told = capsys.readouterr()
    return code, told.out + told.err


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_result_is_named_by_all_who_list_and_is_made_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    right, lines = (folder / RESULT_FILE).read_bytes(), (folder / JOURNAL_FILE).read_bytes()
    root, site = folder.parent, tmp_path / "site"
    assert printed(capsys, "standings", root, "--practice")[0] == 0
    change_result(folder, CHANGES[change])
    for command in (
        ["standings", root],
        ["standings", root, "--practice"],
        ["table", "runs", root],
        ["publish", site, root],
        ["publish", site, root, "--practice"],
    ):
        code, told = printed(capsys, *command)
        assert code == BAD_INPUT, command
        assert f"{folder.name}: {SAID}" in told, command
    assert not list(site.rglob(RESULT_FILE))
    for kind in ([], ["--practice"]):
        packed = ["--subject", "3", "--output", tmp_path / "team.zip", *kind]
        code, told = printed(capsys, "export", root, *packed)
        assert code == BAD_INPUT
        assert SAID in told or "no official runs" in told or "no practice runs" in told
    code, told = printed(capsys, "recover", folder)
    assert code == 0
    assert "its result was made again from journal and recording" in told
    assert (folder / RESULT_FILE).read_bytes() == right
    assert (folder / JOURNAL_FILE).read_bytes() == lines  # which named it already
    assert summary(folder).problem is None
    assert "made again" not in printed(capsys, "recover", folder)[1]


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6, 0.8])
def test_one_flipped_bit_is_found(folder: Path, place: float) -> None:
    path = folder / RESULT_FILE
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 1
    path.write_bytes(data)
    run = summary(folder)
    assert "result.json" in (run.problem or "")
    assert run.repairable
    assert not run.valid
    assert open_run(folder).out_of_date


def test_a_run_that_an_engine_holds_is_no_exception(folder: Path) -> None:
    change_result(folder, CHANGES["a better time"])
    with Hold(folder / HOLD_FILE):
        assert summary(folder).problem == SAID


def test_opening_the_run_makes_its_result_again(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, CHANGES["a better time"])
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.engine.close()
    assert (folder / RESULT_FILE).read_bytes() == right
    assert summary(folder).problem is None


def test_a_result_whose_digest_is_another_in_the_journal_is_made_again(folder: Path) -> None:
    path = folder / JOURNAL_FILE
    path.write_text(re.sub(r'"sha256": "[0-9a-f]', '"sha256": "x', path.read_text()))
    assert summary(folder).problem == SAID
    before = path.read_text().splitlines()
    assert main(["recover", str(folder)]) == 0
    *lines, written = path.read_text().splitlines()
    assert lines == before
    assert json.loads(written)["what"] == "result written"
    assert summary(folder).problem is None


def test_a_kill_before_the_line_of_a_later_result_accuses_nobody(folder: Path) -> None:
    first = (folder / JOURNAL_FILE).read_bytes()
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    path = folder / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    assert json.loads(lines[-1])["what"] == "result written"
    path.write_bytes(b"".join(lines[:-1]))
    run = summary(folder)
    assert (run.problem, run.voided) == (None, True)
    path.write_bytes(first)  # the act is gone, too: that is another journal
    assert summary(folder).problem == SAID


def test_a_result_of_a_version_without_digests_is_believed_as_before(folder: Path) -> None:
    without_digests(folder)
    change_result(folder, CHANGES["a better time"])
    assert summary(folder).problem is None


def test_what_came_of_a_changed_remark_is_not_kept(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, CHANGES["a remark"])
    assert list(repair_all(folder.parent)) == []
    assert (folder / RESULT_FILE).read_bytes() == right
