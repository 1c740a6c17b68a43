"""`archive.tables`: the tables of many runs as DataFrames."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest

from madrob_console.archive import MadrobError, tables
from madrob_console.archive.folders import RunPath
from madrob_console.archive.table_columns import RUN_TABLES, SAMPLE_TABLES
from madrob_console.archive.table_rows import SampledRun
from madrob_console.cli.main import main
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.recorded_runs import appealed, completed, recorded


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs, one of them there twice."""
    root = tmp_path_factory.mktemp("archive")
    for hall, run in (("a", recorded(Scenario.TOUCH_ONLY)), ("b", appealed()), ("c", appealed())):
        shutil.copytree(run, root / hall / "practice" / run.name)
    return root


def test_the_frames_are_the_tables_of_the_command(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = tables(archive)
    for table in RUN_TABLES:
        file = tmp_path / f"{table.name}.csv"
        main(["table", table.name, str(archive), "--output", str(file)])
        assert file.read_text() == frames[table.name].to_csv(index=False)
    assert len(frames["runs"]) == 2
    assert [str(kind) for kind in frames["indicators"].dtypes] != ["object"] * 18
    capsys.readouterr()


def test_the_frames_of_samples_have_what_was_measured_in_all_runs(archive: Path) -> None:
    frames = tables(archive)
    runs = [SampledRun.of(RunPath(Path(place))) for place in frames["runs"].place]
    for table in SAMPLE_TABLES:
        assert list(frames[table.name].columns) == [column.name for column in table.columns]
    assert frames["door"].position.tolist() == [
        angle for run in runs for angle in run.series.rows.joint_state.position.tolist()
    ]
    samples = frames["samples"]
    force = samples[samples.signal == "handle"]
    assert force.value.tolist() == frames["handle"].force.tolist()
    assert force.since_start.tolist() == frames["handle"].since_start.tolist()
    ranges = samples[samples.signal == "cw_right_3"].groupby("run").size()
    assert (ranges > 100).all()
    assert set(frames) == {*(t.name for t in (*RUN_TABLES, *SAMPLE_TABLES)), "samples"}
    assert all(isinstance(frame, pd.DataFrame) for frame in frames.values())


def test_what_cannot_be_read_is_left_out_with_a_warning(tmp_path: Path) -> None:
    torn, whole = (
        Path(shutil.copytree(run, tmp_path / hall / "practice" / run.name))
        for hall, run in (("a", recorded(Scenario.TOUCH_ONLY)), ("b", completed()))
    )
    next(torn.glob("*.mcap")).unlink()
    frames = tables(tmp_path)
    assert len(frames["runs"]) == 2
    with pytest.warns(match="No such file"):
        assert set(frames["run"].outcome) == {"completed"}
    (torn / "result.json").write_text("{}")
    with pytest.warns(match=r"result\.json"):
        assert tables(tmp_path)["runs"].place.tolist() == [str(whole)]
    with pytest.raises(MadrobError, match="no such folder"):
        tables(tmp_path / "nowhere")
