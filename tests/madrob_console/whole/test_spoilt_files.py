"""Whatever lies in the place of a run's file: it is named in a line, and what was signed stays."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, NUMBERS_FILE, REPORT_FILE, RESULT_FILE
from madrob_console.archive.result_reader import UnusableResultError, read_whole_result
from madrob_console.cli.repairing import repair_all
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import final
from tests.slowly import slow_but_for

FILES = {
    "journal": JOURNAL_FILE,
    "result": RESULT_FILE,
    "report": REPORT_FILE,
    "recording": "*_0.mcap",
    "listing": "metadata.yaml",
    "table": "*_wrench.csv",
    "numbers": f"../{NUMBERS_FILE}",
}


def flip_a_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 4
    path.write_bytes(content)


def in_its_place(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def replaced(path: Path) -> None:
        path.unlink()
        make(path)

    return replaced


KINDS: dict[str, Callable[[Path], object]] = {
    "a flipped bit": flip_a_bit,
    "half of it": lambda path: os.truncate(path, path.stat().st_size // 2),
    "a long line more": lambda path: path.write_bytes(path.read_bytes() + b"x" * 10_000_000),
    "a link": in_its_place(lambda path: path.symlink_to(path.parents[3] / "precious")),
    "a pipe": in_its_place(os.mkfifo),
    "a folder": in_its_place(Path.mkdir),
}
COMMANDS = (
    "score --check",
    "standings --practice --results",
    "table runs",
    "plan --results",
    "report",
    "recover",
    "export --practice --subject 3 --results",
)
PATIENCE = 60
"""s; of all commands together."""


@pytest.fixture
def madrob(capsys: pytest.CaptureFixture[str]) -> Madrob:
    return Madrob(capsys)


def hung(_number: int, _frame: FrameType | None) -> None:
    raise AssertionError("a command waits for what lies there")


@pytest.mark.parametrize("kind", slow_but_for(KINDS, "a flipped bit", "a pipe"))
@pytest.mark.parametrize("file", slow_but_for(FILES, "result"))
def test_it_is_named_and_nothing_signed_is_lost(
    file: str, kind: str, madrob: Madrob, tmp_path: Path
) -> None:
    results, precious = tmp_path / "results", tmp_path / "precious"
    precious.write_text("mine")
    folder = shutil.copytree(final(), results / "practice" / final().name)
    (results / "practice" / NUMBERS_FILE).write_text('{"subject":3,"condition":1,"run":1}\n')
    madrob("report", folder)
    signed = read_whole_result(str(folder))
    (path,) = folder.glob(FILES[file])
    KINDS[kind](path)
    before = signal.signal(signal.SIGALRM, hung)
    signal.alarm(PATIENCE)
    try:
        for command in COMMANDS:
            said = madrob.say(command, results)
            assert said.code in (0, 1, 2), (command, said.err)
            lines = said.err.splitlines()
            assert len(lines) <= 3, (command, lines)
            assert all(line.startswith("madrob: ") for line in lines), (command, lines)
        for problem in repair_all(results):
            assert str(folder) in problem
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert precious.read_text() == "mine"
    try:
        now = read_whole_result(str(folder))
    except (UnusableResultError, OSError):
        assert file == "result"  # named above; what lies there is not ours to remove
    else:
        for key in ("indicators", "issue", "closure", "outcome"):
            assert now[key] == signed[key]
