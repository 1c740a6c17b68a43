"""The evidence beside what is scored: repaired where it was cut off, and opened by no list."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History
from madrob_console.cli.main import main
from madrob_console.cli.repairing import repair_all
from madrob_console.files.held import Hold
from madrob_console.referee.journal import HOLD_FILE
from recorder.bag import METADATA_FILE, evidence_file_name
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
    told = (METADATA_FILE, JOURNAL_FILE, RESULT_FILE, "report.html")
    assert {name for name in before if after[name] != before[name]} <= set(told)
    stored, now = (json.loads(files[RESULT_FILE]) for files in (before, after))
    assert {key for key in stored if now[key] != stored[key]} <= {"evidence", "files", "journal"}
    account = now["evidence"]
    assert [topic["messages"] for topic in account["topics"]] == [len(FRAMES)]
    assert "what was lost is not known" in account["problems"][0]
    assert account["file_bytes"] == file.stat().st_size
    assert list(repair_all(run.parent)) == []
    assert contents(run) == after


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


_opened: list[str] = []
_watching = [False]


def _hear(event: str, arguments: tuple[object, ...]) -> None:
    if _watching[0] and event == "open":
        _opened.append(str(arguments[0]))


sys.addaudithook(_hear)


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """Every path that is opened meanwhile."""
    _opened.clear()
    _watching[0] = True
    try:
        yield _opened
    finally:
        _watching[0] = False


@pytest.fixture
def results(run: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A results folder whose run has evidence that is garbage, and a pipe, on which reads hang."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(run.parent / "config"))
    recording = next(run.glob("*_0.mcap")).name.removesuffix("_0.mcap")
    (run / evidence_file_name(recording, 0)).write_bytes(b"garbage" * 1000)
    os.mkfifo(run / evidence_file_name(recording, 1))
    return run.parent


COMMANDS = {
    "score": ["score", "--jobs", "1", "RESULTS"],
    "check": ["score", "--check", "--jobs", "1", "RESULTS"],
    "runs": ["table", "runs", "RESULTS"],
    "steps": ["table", "steps", "RESULTS"],
    "samples": ["table", "samples", "RESULTS", "--output", "NEW"],
    "standings": ["standings", "--practice", "RESULTS"],
    "publish": ["publish", "--practice", "NEW", "RESULTS"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_that_lists_or_scores_opens_evidence(
    results: Path, tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    new = tmp_path_factory.mktemp("new") / "site"
    places = {"RESULTS": str(results), "NEW": str(new)}
    with opened_files() as opened:
        assert main([places.get(word, word) for word in COMMANDS[name]]) == 0
    assert opened
    assert not [path for path in opened if "_evidence_" in path]


def test_a_report_is_made_beside_evidence_that_is_no_recording(results: Path) -> None:
    assert main(["report", str(results)]) == 0
    (page,) = results.glob("*/report.html")
    assert "capability level" in page.read_text()


def test_the_history_neither_opens_evidence_nor_differs_by_it(results: Path) -> None:
    (run,) = History(results).refresh()
    evidence = list(results.glob("*/*_evidence_*"))
    with opened_files() as opened:
        assert History(results).refresh() == (run,)
    assert opened
    assert not [path for path in opened if "_evidence_" in path]
    for path in evidence:
        path.unlink()
    assert History(results).refresh() == (run,)
