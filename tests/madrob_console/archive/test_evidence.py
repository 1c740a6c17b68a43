"""The evidence beside what is scored: an engine that starts repairs what was cut off."""

from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.cli.repairing import repair_all
from madrob_console.files.held import Hold
from madrob_console.referee.journal import HOLD_FILE
from recorder.reader import read_bag
from tests.madrob_console.recorded_runs import copy_run
from tests.recorder.samples import add_evidence, strings

FRAMES = strings(["a picture", "another"])


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return copy_run(tmp_path, 1)


def cut_off(run: Path) -> Path:
    file = add_evidence(run, FRAMES)
    file.write_bytes(file.read_bytes()[:-50])
    return file


def contents(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}


def test_an_engine_that_starts_repairs_evidence_that_was_cut_off(run: Path) -> None:
    before = contents(run)
    file = cut_off(run)
    assert list(repair_all(run.parent)) == []
    bag = read_bag(run, evidence=True)
    assert list(bag.messages()) == FRAMES
    assert file.name in (run / "metadata.yaml").read_text()
    after = contents(run)
    assert {name: after[name] for name in before} | {
        "metadata.yaml": before["metadata.yaml"]
    } == before


def test_it_does_so_beside_a_run_that_was_cut_off_itself(run: Path) -> None:
    (run / RESULT_FILE).unlink()
    recording = next(run.glob("*_0.mcap"))
    recording.write_bytes(recording.read_bytes()[:-100])
    cut_off(run)
    before = recording.read_bytes()
    assert list(repair_all(run.parent)) == []
    assert list(read_bag(run, evidence=True).messages()) == FRAMES
    assert recording.read_bytes() == before


def test_evidence_that_is_listed_is_not_opened(run: Path) -> None:
    cut_off(run)
    assert list(repair_all(run.parent)) == []
    file = next(run.glob("*_evidence_0.mcap"))
    garbage = b"whatever it is" * 100
    file.write_bytes(garbage)
    assert list(repair_all(run.parent)) == []
    assert file.read_bytes() == garbage


def test_a_run_that_goes_on_is_left_alone(run: Path) -> None:
    before = cut_off(run).read_bytes()
    assert (run / JOURNAL_FILE).is_file()
    with Hold(run / HOLD_FILE):
        assert list(repair_all(run.parent)) == []
    assert next(run.glob("*_evidence_0.mcap")).read_bytes() == before
