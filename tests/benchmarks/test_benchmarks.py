from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.benchmarks import archive, bare_filter, report
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
    monkeypatch.setattr(archive, "RUNS", 3)
    figures = [*archive.run_scored(1), *archive.lists(1)]
    assert [(len(figure.values), len(figure.others)) for figure in figures] == [(1, 1)] * 2


def test_the_program_beside_it_filters_each_row(tmp_path: Path) -> None:
    run = Path(shutil.copytree(completed(), tmp_path / "run"))
    bare_filter.main(run)
    rows = len(next(run.glob("*_jointState.csv")).read_text().splitlines())
    assert len((run / "bare.csv").read_text().splitlines()) == rows - 1
