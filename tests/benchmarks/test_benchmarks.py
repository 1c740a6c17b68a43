from __future__ import annotations

import json
from collections.abc import Sequence
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
        Figure("first paint", "s", [0.30, 0.40, 0.45][:repeats], Goal(0.5, times=2), bare),
        Figure("recorded", "1/s", [12_000.0], Goal(10_000, at_least=True)),
        Figure("only told", "MB", [41.5]),
    ]


def bad(_repeats: int) -> Sequence[Figure]:
    """A good median hides no bad value, a good value no bad ratio."""
    return [
        Figure("a key answers", "ms", [4.0, 5.0, 51.0], Goal(50)),
        Figure("launch", "s", [0.45], Goal(0.5, times=2), Baseline("bare app", [0.2])),
        Figure("slow", "1/s", [9_999.0], Goal(10_000, at_least=True)),
        Figure("compared with nothing", "s", [0.1], Goal(times=2)),
        Figure("without values", "s", [], Goal(50)),
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
    code = program.main(["terminal", "--repeats", "3", "--json", str(path)])
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
            "0.300", "0.400", "0.450", "s", "<= 0.5, <= 2x", "met", "bare app 0.200", "2.00x",
        ],
        "recorded": ["12000", "12000", "12000", "1/s", ">= 10000", "met", "", ""],
        "only told": ["41.5", "41.5", "41.5", "MB", "", "", "", ""],
    }  # fmt: skip
    assert figures[0] == {
        "name": "first paint",
        "unit": "s",
        "values": [0.30, 0.40, 0.45],
        "goal": {"limit": 0.5, "at_least": False, "times": 2},
        "baseline": {"name": "bare app", "values": [0.2, 0.2, 0.2]},
        "problem": "",
        "verdict": "met",
        "ratio": pytest.approx(2.0),
    }


def test_nothing_bad_is_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "values.json"
    code, rows, figures = measured(monkeypatch, capsys, path, broken, bad, good)
    assert code == 1
    verdicts = {name: cells[5] for name, cells in rows.items()}
    assert verdicts == {
        "broken": "FAILED",
        "a key answers": "NOT MET",
        "launch": "NOT MET",
        "slow": "NOT MET",
        "compared with nothing": "NOT MET",
        "without values": "FAILED",
        "first paint": "met",
        "recorded": "met",
        "only told": "",
    }
    assert [figure["verdict"] for figure in figures] == list(verdicts.values())
    assert figures[0]["problem"] == "AssertionError: the program has ended"
