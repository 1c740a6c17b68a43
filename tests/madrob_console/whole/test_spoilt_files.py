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


def flip_a_bit(path: Path, _precious: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 4
    path.write_bytes(content)


def cut(path: Path, _precious: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def put_a_link(path: Path, precious: Path) -> None:
    path.unlink()
    path.symlink_to(precious)


def put_a_pipe(path: Path, _precious: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def put_a_folder(path: Path, _precious: Path) -> None:
    path.unlink()
    path.mkdir()


def add_a_long_line(path: Path, _precious: Path) -> None:
    with path.open("ab") as file:
        file.write(b"x" * 10_000_000 + b"\n")


KINDS: tuple[Callable[[Path, Path], None], ...] = (
    flip_a_bit,
    cut,
    put_a_link,
    put_a_pipe,
    put_a_folder,
    add_a_long_line,
)
COMMANDS = (
    "score --check",
    "standings --practice --results",
    "table runs",
    "plan --results",
    "report",
    "recover",
    "doctor --archive",
    "export --practice --subject 3 --results",
)
PATIENCE = 60
"""s; of all commands together."""


@pytest.fixture
def madrob(capsys: pytest.CaptureFixture[str]) -> Madrob:
    return Madrob(capsys)


def hung(_number: int, _frame: FrameType | None) -> None:
    raise AssertionError("a command waits for what lies there")


@pytest.mark.parametrize("kind", slow_but_for(KINDS, flip_a_bit, put_a_pipe))
@pytest.mark.parametrize("file", slow_but_for(FILES, "result"))
def test_it_is_named_and_nothing_signed_is_lost(
    file: str, kind: Callable[[Path, Path], None], madrob: Madrob, tmp_path: Path
) -> None:
    results, precious = tmp_path / "results", tmp_path / "precious"
    precious.write_text("mine")
    folder = shutil.copytree(final(), results / "practice" / final().name)
    (results / "practice" / NUMBERS_FILE).write_text('{"subject":3,"condition":1,"run":1}\n')
    madrob("report", folder)
    signed = read_whole_result(str(folder))
    (path,) = folder.glob(FILES[file])
    kind(path, precious)
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
