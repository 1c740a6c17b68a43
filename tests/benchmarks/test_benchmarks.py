from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.benchmarks import __main__ as program
from tests.benchmarks.report import Baseline, Figure, Goal

PACKAGE = "textual"


def good(repeats: int) -> Sequence[Figure]:
    """Two that are good enough."""
    bare = Baseline("bare app", [0.2] * repeats)
    return [
        Figure("first paint", "s", [0.30, 0.40, 0.45][:repeats], Goal(times=2), bare),
        Figure("recorded", "1/s", [12_000.0], Goal(10, at_least=True), Baseline("plain", [1e3])),
        Figure("lost", "%", [0.0, 0.0], Goal(None)),
        Figure("only told", "MB", [41.5]),
    ]


def bad(_repeats: int) -> Sequence[Figure]:
    """Too slow, too few, one that is lost among many, and nothing to compare with."""
    return [
        Figure("launch", "s", [0.45], Goal(times=2), Baseline("bare app", [0.2])),
        Figure("slow", "1/s", [9_999.0], Goal(10, at_least=True), Baseline("plain", [1e3])),
        Figure("lost at last", "%", [0.0, 0.0, 0.1], Goal(None)),
        Figure("compared with nothing", "s", [0.1], Goal(times=2)),
        Figure("without values", "s", [], Goal(times=2), Baseline("bare app", [0.2])),
    ]


def broken(_repeats: int) -> Sequence[Figure]:
    """It cannot be measured."""
    raise AssertionError("the program has ended")


def measured(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    path: Path,
    *benchmarks: program.Benchmark,
) -> tuple[int, dict[str, list[str]], list[dict[str, Any]]]:
    """The exit code, the rows of the table by figure, and the figures of the JSON."""
    module = SimpleNamespace(PACKAGES=(PACKAGE,), BENCHMARKS=benchmarks)
    monkeypatch.setattr(program, "import_module", lambda _name: module)
    before = ["--before", str(path)] if path.exists() else []
    code = program.main(["terminal", "--repeats", "3", "--json", str(path), *before])
    output = capsys.readouterr().out
    assert f"all values: {path}" in output
    assert f"{PACKAGE} " in output.partition("| figure")[0]
    rows = [row for row in output.splitlines() if row.startswith("| ")][1:]
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows]
    document = json.loads(path.read_text())
    return code, {row[0]: row[1:] for row in cells}, document["figures"]


def test_the_table_and_the_json_say_what_was_measured_beside_goal_and_baseline(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, rows, figures = measured(monkeypatch, capsys, tmp_path / "values.json", good)
    assert code == 0
    assert rows == {
        "first paint": [
            "0.300", "0.400", "0.450", "s", "bare app 0.200", "2.00x", "<= 2x", "met", "",
        ],
        "recorded": [
            "12000", "12000", "12000", "1/s", "plain 1000", "12.00x", ">= 10x", "met", "",
        ],
        "lost": ["0.000", "0.000", "0.000", "%", "", "", "none", "met", ""],
        "only told": ["41.5", "41.5", "41.5", "MB", "", "", "", "", ""],
    }  # fmt: skip
    assert figures[0] == {
        "name": "first paint",
        "unit": "s",
        "values": [0.30, 0.40, 0.45],
        "goal": {"times": 2, "at_least": False},
        "baseline": {"name": "bare app", "values": [0.2, 0.2, 0.2]},
        "problem": "",
        "verdict": "met",
        "ratio": pytest.approx(2.0),
    }


def test_an_earlier_go_is_told_beside_this_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "values.json"
    measured(monkeypatch, capsys, path, good)
    _, rows, _ = measured(monkeypatch, capsys, path, good, bad)
    assert {name: cells[8] for name, cells in rows.items()} == {
        "first paint": "0.400 (2.00x)",
        "recorded": "12000 (12.00x)",
        "lost": "0.000",
        "lost at last": "",
        "only told": "41.5",
        "launch": "",
        "slow": "",
        "compared with nothing": "",
        "without values": "",
    }


def test_a_row_is_told_before_the_next_one_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    told = []

    def slowly(_repeats: int) -> Iterator[Figure]:
        """One after the other."""
        yield Figure("first", "s", [1.0])
        told.append(capsys.readouterr().out)
        yield Figure("second", "s", [1.0])

    module = SimpleNamespace(PACKAGES=(PACKAGE,), BENCHMARKS=[slowly])
    monkeypatch.setattr(program, "import_module", lambda _name: module)
    assert program.main(["terminal", "--json", str(tmp_path / "values.json")]) == 0
    assert "| first " in told[0]


def test_nothing_bad_is_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "values.json"
    code, rows, figures = measured(monkeypatch, capsys, path, broken, bad, good)
    assert code == 1
    verdicts = {name: cells[7] for name, cells in rows.items()}
    assert verdicts == {
        "broken": "FAILED",
        "launch": "NOT MET",
        "slow": "NOT MET",
        "lost at last": "NOT MET",
        "compared with nothing": "NOT MET",
        "without values": "FAILED",
        "first paint": "met",
        "recorded": "met",
        "lost": "met",
        "only told": "",
    }
    assert [figure["verdict"] for figure in figures] == list(verdicts.values())
    assert figures[0]["problem"] == "AssertionError: the program has ended"
