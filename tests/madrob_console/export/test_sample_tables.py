"""`madrob table samples`: what the sensors said, as tables for programs."""

from __future__ import annotations

import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import runs_at
from madrob_console.cli.main import main
from madrob_console.cli.table_command import write_samples
from madrob_console.export.table_columns import DOOR, SAMPLE_TABLES, CellKind, TableFormat
from madrob_console.referee.acts import Abort
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import PASSAGE_SENSORS, Thresholds
from scoring.rulesets import EUROBENCH_2020, RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import copy_run, publish, recorded


def samples(*arguments: object) -> int:
    try:
        return main(["table", "samples", *map(str, arguments)])
    except SystemExit as end:  # argparse
        return int(end.code or 0)


_EXACTLY: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__ < "3" else {}
"""Older versions round the last digit of what they read."""


def read(folder: Path, run: Path, table: str) -> pd.DataFrame:
    read_exactly = partial(pd.read_csv, **_EXACTLY)
    return cast(pd.DataFrame, read_exactly(folder / f"{run.name}_{table}.csv"))


def filled(cells: pd.Series) -> list[object]:
    """What stands in a column; None = nothing."""
    plain = cells.astype(object)
    return list(plain.where(plain.notna(), None))


@pytest.fixture(scope="module")
def run() -> Path:
    return recorded(Scenario.NOMINAL)


@pytest.fixture(scope="module")
def tables(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tables of the run as csv."""
    folder = tmp_path_factory.mktemp("far") / "tables"
    assert samples(run, "--output", folder) == 0
    return folder


def test_each_run_gets_a_file_for_each_table_named_after_it(run: Path, tables: Path) -> None:
    assert sorted(path.name for path in tables.iterdir()) == sorted(
        f"{run.name}_{table.name}.csv" for table in SAMPLE_TABLES
    )
    for table in SAMPLE_TABLES:
        frame = read(tables, run, table.name)
        assert list(frame) == [column.name for column in table.columns]
        assert set(frame["run"]) <= {run.name}


def test_the_series_begin_before_the_run_and_end_after_it(run: Path, tables: Path) -> None:
    facts = read(tables, run, "run").iloc[0]
    for name in ("door", "handle", "passage"):
        since = read(tables, run, name).since_start
        assert since.min() < -1
        assert since.max() > facts.duration + 0.9
        assert (since.diff().dropna() >= -0.02).all()


def test_the_rows_of_the_run_are_those_behind_its_result_to_the_last_digit(
    run: Path, tables: Path
) -> None:
    (scored,) = score(run)
    facts, rows = read(tables, run, "run").iloc[0], scored.rows

    def cut(table: str) -> pd.DataFrame:
        frame = read(tables, run, table)
        return frame[frame.since_start.between(facts.rows_from, facts.rows_until)]

    door, handle = cut("door"), cut("handle")
    assert door.since_start.tolist() == (rows.joint_state.time - scored.result.start).tolist()
    for column, values in (
        ("position", rows.joint_state.position),
        ("velocity", rows.joint_state.velocity),
        ("acceleration", rows.joint_state.acceleration),
        ("low_passed_acceleration", rows.low_passed),
    ):
        np.testing.assert_array_equal(door[column], values)
    jerk = door[["since_start", "jerk"]].dropna()
    assert jerk.jerk.tolist() == rows.jerk.tolist()
    assert jerk.since_start.tolist() == (rows.jerk_time - scored.result.start).tolist()
    assert handle.force.tolist() == rows.force.tolist()
    text = (tables / f"{run.name}_door.csv").read_text().splitlines()[1:]
    times = [float(line.split(",")[1]) for line in text]
    assert set(rows.joint_state.time.tolist()) < set(times)


def test_each_used_passage_sensor_has_its_reading_its_state_and_its_mask(
    run: Path, tables: Path
) -> None:
    limits = Thresholds()
    passage, door = read(tables, run, "passage"), read(tables, run, "door")
    sensors = passage[["side", "index", "strip", "element"]].drop_duplicates()
    assert set(sensors.itertuples(index=False, name=None)) == {
        (s.side, s.index, s.strip, s.element) for s in PASSAGE_SENSORS
    }
    np.testing.assert_allclose(passage.height, limits.lintel_height - passage["range"])
    seen = passage[~passage.masked]
    assert (seen.present == (seen.height > limits.present_height)).all()
    assert passage.masked.any()
    opened = door[door.position.abs() > min(limits.mask_from)].since_start
    assert (
        passage[passage.masked].since_start.between(opened.min() - 0.02, opened.max() + 0.02).all()
    )


def test_other_rules_give_other_tables(run: Path, tmp_path: Path) -> None:
    assert samples(run, "--ruleset", "eurobench-2020", "--output", tmp_path) == 0
    (scored,) = score(run, RulesetName.EUROBENCH_2020)
    facts, door = read(tmp_path, run, "run").iloc[0], read(tmp_path, run, "door")
    assert (facts.ruleset, facts.present_height) == (
        "eurobench-2020",
        EUROBENCH_2020.present_height,
    )
    assert (facts.rows_from, facts.rows_until) == (-np.inf, np.inf)
    np.testing.assert_array_equal(door.low_passed_acceleration, scored.rows.low_passed)
    assert door.jerk.dropna().tolist() == scored.rows.jerk.tolist()


def test_parquet_has_the_same_with_types_and_what_the_columns_mean(
    run: Path, tables: Path, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow", reason="the extra `tables`")
    assert samples(run, "--format", "parquet", "--output", tmp_path) == 0
    for table in SAMPLE_TABLES:
        frame = pd.read_parquet(tmp_path / f"{run.name}_{table.name}.parquet")
        text = read(tables, run, table.name)
        assert list(frame) == list(text)
        for column in table.columns:
            assert f"{column.meaning} [{column.unit or '-'}]" == frame.attrs[column.name]
            if column.kind is not CellKind.TEXT:
                assert frame[column.name].dtype == column.kind.value
            if column.name != "time":  # read_csv may err in its last digit
                one, two = frame[column.name].astype(object), text[column.name].astype(object)
                given = one.notna() & (one != "")  # csv has no other empty cell
                assert one.where(given, None).tolist() == two.where(two.notna(), None).tolist()


def test_without_pyarrow_parquet_is_refused_with_the_remedy_before_any_work(
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert samples(run, "--format", "parquet", "--output", tmp_path / "tables") == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert "extra `tables`, or write csv" in said.err
    assert not (tmp_path / "tables").exists()


def test_a_bad_run_is_named_and_the_others_have_their_tables(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, output = tmp_path / "results", tmp_path / "tables"
    copies = [copy_run(results, number) for number in (1, 2)]
    twin = tmp_path / "elsewhere" / copies[0].name
    shutil.copytree(copies[0], twin)
    publish(run, tmp_path / "published")
    paths = (results, tmp_path / "nowhere", twin, tmp_path / "published")
    assert samples(*paths, "--output", output) == 2
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        str(output / f"{copy.name}_{table.name}.csv") for copy in copies for table in SAMPLE_TABLES
    ]
    same_name, nowhere, published = said.err.splitlines()
    assert str(tmp_path / "nowhere") in nowhere
    assert f"{twin}: is called like {copies[0]}" in same_name
    assert "files without a recording" in published


def test_tables_that_cannot_be_written_are_a_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert samples(run, "--output", tmp_path / "file") == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert f"{tmp_path / 'file'}: " in said.err
    assert samples(run) == 2
    assert "--output" in capsys.readouterr().err


def test_an_aborted_run_has_its_series_too(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "results")
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("somebody in the doorway"))
    drive.finish()
    drive.engine.close()
    assert samples(drive.folder, "--output", tmp_path) == 0
    assert read(tmp_path, drive.folder, "run").outcome.tolist() == ["aborted"]
    assert read(tmp_path, drive.folder, "door").since_start.max() > 3.0


def test_the_latch_sensor_has_a_table(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "results", latch=True)
    drive.whole_run(make_setup())
    drive.engine.close()
    (of,) = runs_at(drive.folder)
    write_samples(of, output=tmp_path, rules=None, kind=TableFormat.CSV)
    engaged = read(tmp_path, drive.folder, "latch").engaged
    assert engaged.iloc[0]
    assert not engaged.all()
    assert engaged.iloc[-1]
    assert read(tmp_path, drive.folder, "run").lock_detection.tolist() == ["sensor"]


def test_the_help_says_of_each_column_what_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert samples("--help") == 0
    text = " ".join(capsys.readouterr().out.split())
    for table in SAMPLE_TABLES:
        assert f"{table.name}: {table.row} " in text
    for column in DOOR.columns:
        assert f"{column.name} {column.unit} {column.meaning}".replace("  ", " ") in text
