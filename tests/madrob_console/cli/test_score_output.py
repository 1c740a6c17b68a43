"""`madrob score --output`: tables of fresh results, also in shards."""

from __future__ import annotations

import json
import os
import shutil
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest

from madrob_console.cli.main import main
from madrob_console.testbeds.simulated import Scenario
from madrob_console.tidy.run_tables import RUN_TABLES
from scoring.rulesets import RulesetName
from tests.madrob_console.recorded_runs import copy_run, publish, recorded

TABLES = [table.name for table in RUN_TABLES]


def score(*arguments: object) -> int:
    try:
        return main(["score", *map(str, arguments)])
    except SystemExit as end:  # argparse
        return int(end.code or 0)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight runs, copies of two, and one that cannot be read."""
    root = tmp_path_factory.mktemp("results")
    for number in range(1, 9):
        # somebody renamed them: copies of one run are one run, so only two count
        copy_run(root, number, Scenario.NOMINAL if number % 2 else Scenario.TOUCH_ONLY)
    (root / "subject_009_cond_001_run_001_20231114_221323").mkdir()
    return root


def frame(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, keep_default_na=False)


def test_the_tables_of_fresh_results_are_those_of_the_stored_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(Scenario.NOMINAL)
    assert score(run, "--output", tmp_path / "out") == 0
    told = capsys.readouterr()
    assert told.out == f"{tmp_path / 'out'}: 1 runs, 0 of them cannot be read\n"
    for name in TABLES:
        assert main(["table", name, str(run)]) == 0
        stored = pd.read_csv(StringIO(capsys.readouterr().out), keep_default_na=False)
        pd.testing.assert_frame_equal(frame(tmp_path / f"out/{name}.csv"), stored)


def test_a_run_that_cannot_be_read_is_one_row_with_its_reason(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert score(results, "--output", tmp_path / "out", "--jobs", 1) == 2
    (row,) = frame(tmp_path / "out/unreadable.csv").to_dict("records")
    assert row["place"] == str(results / "subject_009_cond_001_run_001_20231114_221323")
    assert "no bag" in row["reason"]
    assert row["place"] in capsys.readouterr().err
    assert len(frame(tmp_path / "out/runs.csv")) == 2  # each run once


def test_shards_are_the_whole_together(tmp_path: Path) -> None:
    root = tmp_path / "results"
    root.mkdir()
    for number in range(1, 7):
        publish(recorded(Scenario.NOMINAL), root / f"hall_{number}")
        for path in (root / f"hall_{number}").iterdir():
            path.rename(path.with_name(path.name.replace("run_001", f"run_{number:03d}")))
    (root / "subject_009_cond_001_run_001_20231114_221323").mkdir()
    score(root, "--output", tmp_path / "whole", "--jobs", 1)
    for number in (1, 2, 3):
        score(root, "--output", tmp_path / "parts", "--shard", f"{number}/3", "--jobs", 1)
    assert len(list((tmp_path / "parts").iterdir())) == 3
    for name in (*TABLES, "unreadable"):
        whole = frame(tmp_path / f"whole/{name}.csv")
        parts = pd.concat(map(frame, sorted((tmp_path / "parts").glob(f"*/{name}.csv"))))
        keys = [str(name) for name in whole]
        pd.testing.assert_frame_equal(
            parts.sort_values(keys).reset_index(drop=True),
            whole.sort_values(keys).reset_index(drop=True),
            check_dtype=False,  # that of a table without rows
        )
        assert len(whole) > 0


def test_a_path_that_is_no_text_is_one_in_tables_and_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / os.fsdecode(b"hall \xff")
    root.mkdir()
    shutil.copytree(recorded(Scenario.NOMINAL), root / recorded(Scenario.NOMINAL).name)
    assert score(root, "--output", tmp_path / "out") == 0
    (place,) = frame(tmp_path / "out" / "runs.csv")["place"]
    assert "hall \ufffd" in place
    capsys.readouterr()
    assert score(root, "--json") == 0
    assert "hall \ufffd" in json.loads(capsys.readouterr().out)["runs"][0]["path"]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_every_share_says_that_a_path_is_missing(
    number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "out"
    assert score(tmp_path / "nope", "--output", target, "--shard", f"{number}/3") == 2
    assert "nope: no such file or directory" in capsys.readouterr().err
    assert not target.exists()


def test_a_division_into_other_shards_does_not_get_beside_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(Scenario.TOUCH_ONLY)
    assert score(run, "--output", tmp_path, "--shard", "1/2") == 0
    capsys.readouterr()
    assert score(run, "--output", tmp_path, "--shard", "1/3") == 2
    assert "is a share of another division" in capsys.readouterr().err
    assert score(run, "--output", tmp_path, "--shard", "1/2") == 2
    assert "is there already" in capsys.readouterr().err


def test_tables_are_there_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("madrob_console.cli.score_output.name_twins", interrupted)
    assert score(recorded(Scenario.TOUCH_ONLY), "--output", tmp_path / "out") == 130
    assert list(tmp_path.iterdir()) == []


def test_all_rulesets_stand_below_each_other_and_every_table_tells_them_apart(
    tmp_path: Path,
) -> None:
    run = recorded(Scenario.NOMINAL)
    assert score(run, "--output", tmp_path / "out", "--ruleset", "all") == 0
    for name in TABLES:
        assert set(frame(tmp_path / f"out/{name}.csv").ruleset) == set(RulesetName)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--output", "x", "--check"], "--check"),
        (["--output", "x", "--json"], "--json: not allowed with --output"),
        (["--format", "csv"], "--format: only with --output"),
        (["--dry-run"], "--dry-run: only with --reissue"),
        (["--check", "--ruleset", "protocol"], "--ruleset: not allowed with --check"),
        (["--shard", "3/2"], "--shard: '3/2': give i/n"),
        (["--scheduler", "tcp://a:1", "--jobs", "2"], "--jobs: not allowed with --scheduler"),
        (["--scheduler", "tcp://a:1", "--backend", "loky"], "--backend: not allowed with"),
        (["--reissue", " "], "--reissue: give a reason"),
        (["--reissue", "x", "--ruleset", "all"], "--reissue: with one ruleset, not all"),
        (["--reissue", "x", "--json"], "--json: not allowed with --reissue"),
    ],
)
def test_options_that_make_no_sense_together_are_refused_on_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert score(tmp_path, *arguments) == 2
    told = capsys.readouterr()
    assert words in told.err
    assert told.err.count("\n") == 1
    assert told.out == ""
