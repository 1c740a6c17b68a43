"""A recording gives its stored result again; a result that somebody changed is named."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    PRACTICE_FOLDER,
    RESULT_FILE,
    results_folder_of,
)
from madrob_console.archive.history import History
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.repairing import repair_all
from madrob_console.referee.acts import Void
from madrob_console.referee.run_summary import RunSummary
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.recorded_runs import (
    final,
)

SAID = "result.json was changed after it was written: `madrob recover` makes it again"
CHANGES: dict[str, tuple[str, str]] = {
    "a better time": (r'("execution_time": {\s*"value": )[-\d.]+', r"\g<1>3.21"),
    "one digit": (r'("passage_time": {\s*"value": )[-\d.]+', r"\g<1>4.0"),
    "another team": ('"team": "', '"team": "X'),
    "another outcome": ('"outcome": "completed"', '"outcome": "timeout"'),
    "no practice": ('"practice": true', '"practice": false'),
    "a remark": (r'"remarks": \[\]', '"remarks": ["fine"]'),
    "a space": ("^", " "),
    "a flag": (r'"flags": \[', '"flags_": ['),
}
"""What is found in a result, as a pattern, and what stands there afterwards."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    source = final()
    return shutil.copytree(source, tmp_path / "results" / PRACTICE_FOLDER / source.name)


def change_result(folder: Path, change: str) -> None:
    path = folder / RESULT_FILE
    text, count = re.subn(*CHANGES[change], path.read_text(), count=1)
    assert count == 1
    path.write_text(text)


def summary(folder: Path) -> RunSummary:
    (run,) = History(results_folder_of(folder)).refresh()
    return run


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_result_is_named_by_all_who_list_and_is_made_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    def printed(*arguments: object) -> tuple[int, str]:
        code = main([*map(str, arguments)])
        told = capsys.readouterr()
        return code, told.out + told.err

    right, lines = (folder / RESULT_FILE).read_bytes(), (folder / JOURNAL_FILE).read_bytes()
    root, site = results_folder_of(folder), tmp_path / "site"
    assert printed("standings", root, "--practice")[0] == 0
    change_result(folder, change)
    for command in (
        ["standings", root, "--practice"],
        ["table", "runs", root],
        ["publish", site, root, "--practice"],
    ):
        code, told = printed(*command)
        assert code == BAD_INPUT, command
        assert f"{folder.name}: {SAID}" in told, command
    assert not list(site.rglob(RESULT_FILE))
    for kind in ([], ["--practice"]):
        code, told = printed("export", root, "--subject=3", "--output", tmp_path / "a.zip", *kind)
        assert code == BAD_INPUT
        assert SAID in told or "no official runs" in told or "no practice runs" in told
    assert list(repair_all(root)) == []
    assert (folder / RESULT_FILE).read_bytes() == right
    assert (folder / JOURNAL_FILE).read_bytes() == lines  # which named it already
    assert summary(folder).problem is None
    assert "made again" not in printed("recover", folder)[1]


def test_opening_the_run_makes_its_result_again(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, "a better time")
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.engine.close()
    assert (folder / RESULT_FILE).read_bytes() == right
    assert summary(folder).problem is None


def test_a_kill_before_the_line_of_a_later_result_accuses_nobody(folder: Path) -> None:
    first = (folder / JOURNAL_FILE).read_bytes()
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    path = folder / JOURNAL_FILE
    *lines, last = path.read_bytes().splitlines(keepends=True)
    assert json.loads(last)["what"] == "result written"
    path.write_bytes(b"".join(lines))
    assert (summary(folder).problem, summary(folder).voided) == (None, True)
    path.write_bytes(first)  # the act is gone, too: that is another journal
    assert summary(folder).problem == SAID
