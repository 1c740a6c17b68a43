"""The evidence beside what is scored: repaired where it was cut off, opened by no list."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.history import History
from madrob_console.cli.repairing import repair_all
from recorder.bag import evidence_file_name
from recorder.reader import Bag
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import (
    copy_run,
)
from tests.recorder.samples import (
    add_evidence,
    strings,
)

FRAMES = strings(["a picture", "another"])


def evidence_left(folder: Path) -> list[Path]:
    return sorted(folder.glob("*_evidence_*"))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# ---------------------------------------------------------------- what is repaired


@pytest.fixture
def torn(tmp_path: Path) -> Path:
    """A run whose evidence was cut off."""
    run = copy_run(tmp_path, 1)
    file = add_evidence(run, FRAMES)
    os.truncate(file, file.stat().st_size - 50)
    return run


def test_it_does_so_beside_a_run_that_was_cut_off_itself(torn: Path) -> None:
    (torn / RESULT_FILE).unlink()
    recording = next(torn.glob("*_0.mcap"))
    os.truncate(recording, recording.stat().st_size - 100)
    before = recording.read_bytes()
    assert list(repair_all(torn.parent)) == []
    assert list(Bag(torn, evidence=True).messages()) == FRAMES
    assert recording.read_bytes() == before


# ---------------------------------------------------------------- what is opened


_opened: list[str] = []
_watching: list[bool] = []
sys.addaudithook(
    lambda event, arguments: (
        _opened.append(str(arguments[0])) if _watching and event == "open" else None
    )
)

COMMANDS = (
    "score --jobs 1 {}",
    "score --check --jobs 1 {}",
    "table runs {}",
    "table steps {}",
    "table samples {} --output {new}",
    "standings --practice {}",
    "publish --practice {new} {}",
    "report {}",
    "history",
)


@pytest.mark.parametrize("line", COMMANDS)
def test_nothing_that_lists_or_scores_opens_evidence_or_differs_by_it(
    line: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, madrob: Madrob
) -> None:
    run = copy_run(tmp_path, 1)
    listed = History(tmp_path).refresh()
    (run / evidence_file_name(run.name, 0)).write_bytes(b"garbage" * 1000)
    os.mkfifo(run / evidence_file_name(run.name, 1))  # on which reads hang
    _opened.clear()
    _watching.append(True)
    try:
        if line == "history":
            assert History(tmp_path).refresh() == listed
        else:
            madrob(line.format(tmp_path, new=tmp_path_factory.mktemp("new") / "site"))
    finally:
        _watching.clear()
    assert _opened
    assert line == "report {}" or not [path for path in _opened if "_evidence_" in path]
    assert History(tmp_path).refresh() == listed
