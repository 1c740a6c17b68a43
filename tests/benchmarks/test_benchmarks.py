from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from tests.benchmarks import archive, bare_files, bare_filter, recording, report, scoring
from tests.benchmarks.__main__ import main
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed


def good(repeats: int) -> list[Figure]:
    return [
        Figure("first paint", "s", [0.30, 0.40, 0.45][:repeats], "bare app", [0.2] * repeats, 2),
        Figure("arrived", "1/s", [12_000.0], "sent", [1e3], 10, at_least=True),
    ]


def bad(_repeats: int) -> list[Figure]:
    return [
        Figure("launch", "s", [0.45], "bare app", [0.2], 2),
        Figure("slow", "1/s", [9_999.0], "plain", [1e3], 10, at_least=True),
        Figure("without values", "s", [], "bare app", [0.2], 2),
        Figure("beside nothing", "s", [0.1], "bare app", [0.0], 2),
    ]


def broken(_repeats: int) -> list[Figure]:
    raise AssertionError("the program has ended")


def test_the_table_says_what_was_measured_beside_it_and_nothing_bad_is_hidden(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "ADDITIONS", 1)
    benchmarks = {"broken": broken, "bad": bad, "good": good}
    assert main(["good", "--repeats", "3"], benchmarks) == 0
    assert main(["--repeats", "3"], benchmarks) == 1
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows]
    assert cells[1:3] == [
        ["first paint", "s", "0.4", "bare app 0.2", "2.00x", "<= 2x", "met"],
        ["arrived", "1/s", "1.2e+04", "sent 1000", "12.00x", ">= 10x", "met"],
    ]
    assert {row[0]: row[-1] for row in cells[4:]} == {
        "broken": "FAILED",
        "launch": "NOT MET",
        "slow": "NOT MET",
        "without values": "FAILED",
        "beside nothing": "FAILED",
        "first paint": "met",
        "arrived": "met",
    }
    assert "AssertionError: the program has ended" in cells[4]


def test_what_needs_no_other_process_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "SIZES", (3,))
    monkeypatch.setattr(recording, "MESSAGES", 100)
    parts = (archive.bag, archive.lists, recording.mcap_writer, scoring.layouts)
    figures = [figure for part in parts for figure in part(1)]
    counts = [(len(figure.values), len(figure.others)) for figure in figures]
    assert counts == [(1, 1)] * len(parts)


def test_the_programs_beside_it_put_the_same_bytes_there(tmp_path: Path) -> None:
    run, packed = tmp_path / "run", tmp_path / "run.zip"
    bare_files.main(completed(), run)
    bare_files.main(run, packed)
    names = sorted(path.name for path in completed().iterdir())
    assert sorted(path.name for path in run.iterdir()) == names
    with zipfile.ZipFile(packed) as file:
        assert sorted(file.namelist()) == names
    bare_filter.main(run)
    rows = len(next(run.glob("*_jointState.csv")).read_text().splitlines())
    assert len((run / "bare.csv").read_text().splitlines()) == rows - 1
