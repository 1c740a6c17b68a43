"""`madrob table` and `archive.tables`: all that is known of runs, as tables for programs."""

from __future__ import annotations

import json
import shutil
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from madrob_console.archive import MadrobError, score
from madrob_console.archive import tables as all_tables
from madrob_console.archive.run_paths import RunPath, runs_at
from madrob_console.archive.table_columns import (
    DOOR,
    RUN_TABLES,
    SAMPLE_TABLES,
    WHOSE,
    TidyTable,
)
from madrob_console.archive.table_rows import Frames, SampledRun
from madrob_console.cli.table_command import write_samples
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import RulesetName
from scoring.protocol import PASSAGE_SENSORS, Thresholds
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    aborted,
    appealed,
    completed,
    copy_run,
    publish,
    recorded,
)
from tests.madrob_console.run_folders import summary, write

_EXACTLY: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__ < "3" else {}
"""Older versions round the last digit of what they read."""


def read_csv(source: object, **how: object) -> pd.DataFrame:
    frame: pd.DataFrame = pd.read_csv(source, **how, **_EXACTLY)  # type: ignore[call-overload]
    return frame


def plain(frame: pd.DataFrame) -> pd.DataFrame:
    """With None where nothing stands, as csv has it."""
    cells = frame.astype(object)
    return cells.where(cells.notna() & (cells != ""), None)


# ---------------------------------------------------------------- of all runs


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of today, one of them with all that a referee can say."""
    root = tmp_path_factory.mktemp("archive")
    for number, run in enumerate((recorded(Scenario.TOUCH_ONLY), appealed())):
        shutil.copytree(run, root / f"hall_{number}" / "practice" / run.name)
    return root


def results_below(root: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(root.rglob("result.json"))]


def table(madrob: Madrob, name: str, *arguments: object) -> pd.DataFrame:
    said = madrob.say(f"table {name}", *arguments)
    assert (said.code, said.err) == (0, "")
    return read_csv(StringIO(said.out))


def test_runs_has_a_row_for_each_run_with_whose_and_which_it_is(
    archive: Path, madrob: Madrob
) -> None:
    frame = table(madrob, "runs", archive)
    for row, stored in zip(frame.to_dict("records"), results_below(archive), strict=True):
        same = ("subject", "team", "run_id", "testbed", "start", "outcome", "ruleset", "issue")
        expected = {key: stored[key] for key in same} | {
            "condition": stored["condition_number"],
            "run": stored["run_number"],
            "valid": stored["outcome"] in {"completed", "timeout"},
            "practice": True,
            "final": stored["closure"] is not None,
            "flags": "; ".join(flag["words"] for flag in stored["flags"]),
            "duration": stored["stop"] - stored["start"],
            "libraries": "; ".join(map(" ".join, stored["libraries"].items())),
            "recording_sha256": stored["files"][f"{row['folder']}_0.mcap"]["sha256"],
        }
        assert {key: row[key] for key in expected} == expected
        assert json.loads((Path(row["place"]) / "result.json").read_text()) == stored


def put(root: Path, result: dict[str, Any], number: int = 1) -> None:
    """A run of which there is no more than a result."""
    folder = root / f"subject_003_cond_001_run_001_2023111{number}_221323"
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(json.dumps(result))


def test_runs_tells_which_numbers_and_mappings_are_not_the_usual_ones(
    archive: Path, tmp_path: Path, madrob: Madrob
) -> None:
    (first, _) = results_below(archive)
    first["thresholds"]["lintel_height"] = 2.2
    told = first["mappings"]
    scaled = [one | {"scale": 2.0} if one["signal"] == "handle force" else one for one in told]
    halls = {"A": told, "B": told[::-1], "C": scaled}
    for number, (hall, mappings) in enumerate(halls.items(), start=1):
        put(tmp_path, first | {"mappings": mappings, "testbed": hall, "run_id": hall}, number)
    frame = table(madrob, "runs", tmp_path).set_index("testbed")
    assert set(frame.thresholds_changed) == {"lintel_height 2.2"}
    digests = frame.mapping_sha256
    assert digests.A == digests.B != digests.C
    assert [len(digests[hall]) for hall in "ABC"] == [16] * 3
    put(tmp_path, first | {"testbed": "D", "run_id": "C"}, 3)  # it is read again
    assert set(table(madrob, "runs", tmp_path).testbed) == set("ABD")


@pytest.mark.parametrize(
    "team",
    ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\x1b[31m=1", "\uff1d1", '=HYPERLINK("http://x")'],
)
def test_no_text_of_a_table_is_run_by_a_spreadsheet_or_obeyed_by_a_terminal(
    team: str, archive: Path, tmp_path: Path, madrob: Madrob
) -> None:
    put(tmp_path, results_below(archive)[0] | {"team": team})
    (found,) = table(madrob, "runs", tmp_path).team
    assert found.startswith(("'", " ="))
    assert found.isprintable()
    assert Frames(tmp_path)["runs"].team.tolist() == [found.removeprefix("'")]


def test_indicators_events_and_steps_have_what_the_results_have(
    archive: Path, madrob: Madrob
) -> None:
    results = {result["run_id"]: result for result in results_below(archive)}
    told = {name: plain(table(madrob, name, archive)) for name in ("indicators", "events", "steps")}
    unknown = {"u": None, "expanded": None, "rest": None}
    columns = [
        *("run_id", "indicator", "value", "uncertainty", "expanded_uncertainty", "at_rest"),
        *("reason", "unit", "doubts"),
    ]
    assert told["indicators"][columns].to_numpy().tolist() == [
        [
            *(run_id, name, one["value"], *(one["uncertainty"] or unknown).values()),
            *(one["reason"], one["unit"], "; ".join(one["doubts"]) or None),
        ]
        for run_id, result in results.items()
        for name, one in result["indicators"].items()
    ]
    assert told["events"][["run_id", "event", "time"]].to_numpy().tolist() == [
        [key, event["event"], event["time"]]
        for key, result in results.items()
        for event in result["events"]
    ]
    counting = [step["final"] for result in results.values() for step in result["steps"]]
    assert told["steps"][["time", "done"]].to_numpy().tolist() == [
        [time, time is not None] for time in counting
    ]


def test_a_run_that_is_there_twice_is_one_row_and_what_has_no_result_is_named(
    tmp_path: Path, madrob: Madrob
) -> None:
    for number in range(1, 6):
        write(tmp_path / "a", summary(3, run_number=number, run_id=f"the {number}th"))
    (tmp_path / "a/subject_003_cond_001_run_009_20231114_221323").mkdir()
    shutil.copytree(tmp_path / "a", tmp_path / "deep/er/b")
    said = madrob.say("table runs", tmp_path)
    rows = read_csv(StringIO(said.out))
    assert (said.code, len(rows), rows.run_id.nunique()) == (2, 5, 5)
    counts = {"has no result.json": 2, "the same run as": 3, "2 more runs that are there twice": 1}
    assert {words: said.err.count(words) for words in counts} == counts


@pytest.mark.parametrize("one", [*RUN_TABLES, *SAMPLE_TABLES], ids=lambda one: one.name)
def test_help_and_columns_say_of_each_column_what_it_is(one: TidyTable, madrob: Madrob) -> None:
    of_runs = one in RUN_TABLES
    name = one.name if of_runs else "samples"
    lines = (f"{name} --help", f"{name} --columns", "--columns") if of_runs else (f"{name} --help",)
    for line in lines:
        text = " ".join(madrob(f"table {line}").split())
        assert of_runs or f"{one.name}: {one.row} " in text
        for column in one.columns if of_runs or one is DOOR else ():
            assert " ".join(f"{column.name} {column.unit} {column.meaning}".split()) in text
    assert not of_runs or one.columns[: len(WHOSE)] == WHOSE


def test_a_table_without_rows_has_its_columns(tmp_path: Path, madrob: Madrob) -> None:
    write(tmp_path, summary(testbed="Hall B"))
    out = madrob("table events", tmp_path, "--testbed-name", "Hall B")
    assert out.startswith("subject,team,condition,run,run_id,testbed,")


# ---------------------------------------------------------------- of a run's samples


def samples_of(run: Path, folder: Path, rules: RulesetName | None) -> dict[str, pd.DataFrame]:
    """The tables of a run, by name."""
    (of,) = runs_at(run)
    write_samples(of, output=folder, rules=rules)
    found = {one.name: folder / f"{run.name}_{one.name}.csv" for one in SAMPLE_TABLES}
    assert set(folder.glob("*.csv")) >= set(found.values())
    return {name: read_csv(path) for name, path in found.items()}


@pytest.fixture(scope="module")
def run() -> Path:
    return recorded(Scenario.NOMINAL)


@pytest.fixture(scope="module")
def tables(run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    return samples_of(run, tmp_path_factory.mktemp("far"), None)


def test_the_rows_of_the_run_are_those_behind_its_result_to_the_last_digit(
    run: Path, tables: dict[str, pd.DataFrame]
) -> None:
    (scored,) = score(run)
    facts, rows, start = tables["run"].iloc[0], scored.result.rows, scored.result.start
    for name in ("door", "handle", "passage"):  # they begin before the run and end after it
        since = tables[name].since_start
        assert since.min() < -1
        assert since.max() > facts.duration + 0.9
        assert (since.diff().dropna() >= -0.02).all()
    assert all(set(frame["run"]) <= {run.name} for frame in tables.values())
    door, handle = (
        frame[frame.since_start.between(facts.rows_from, facts.rows_until)]
        for frame in (tables["door"], tables["handle"])
    )
    jerk = door[["since_start", "jerk"]].dropna()
    state = rows.joint_state
    for column, values in (
        (door.since_start, state.time - start),
        (door.position, state.position),
        (door.velocity, state.velocity),
        (door.acceleration, state.acceleration),
        (door.low_passed_acceleration, rows.low_passed),
        (jerk.jerk, rows.jerk),
        (jerk.since_start, rows.jerk_time - start),
        (handle.force, rows.force),
    ):
        np.testing.assert_array_equal(column, values)
    assert set(state.time.tolist()) < set(tables["door"].time.tolist())


def test_each_used_passage_sensor_has_its_reading_its_state_and_its_mask(
    tables: dict[str, pd.DataFrame],
) -> None:
    limits, passage, door = Thresholds(), tables["passage"], tables["door"]
    sensors = passage[["side", "index", "strip", "element"]].drop_duplicates()
    assert set(sensors.itertuples(index=False, name=None)) == {
        (s.side, s.index, s.strip, s.element) for s in PASSAGE_SENSORS
    }
    np.testing.assert_allclose(passage.height, limits.lintel_height - passage["range"])
    seen = passage[~passage.masked]
    assert (seen.present == (seen.height > limits.present_height)).all()
    assert passage.masked.any()
    opened = door[door.position.abs() > min(limits.mask_from)].since_start
    masked = passage[passage.masked].since_start
    assert masked.between(opened.min() - 0.02, opened.max() + 0.02).all()


def test_other_rules_give_other_tables(run: Path, tmp_path: Path, madrob: Madrob) -> None:
    madrob(f"table samples --ruleset eurobench-2020 --output {tmp_path}", run)
    facts, door = (read_csv(tmp_path / f"{run.name}_{name}.csv") for name in ("run", "door"))
    (scored,) = score(run, RulesetName.EUROBENCH_2020)
    assert facts[["ruleset", "present_height", "rows_from", "rows_until"]].to_numpy().tolist() == [
        ["eurobench-2020", 0.5, -np.inf, np.inf]
    ]
    np.testing.assert_array_equal(door.low_passed_acceleration, scored.result.rows.low_passed)
    assert door.jerk.dropna().tolist() == scored.result.rows.jerk.tolist()


def test_a_bad_run_is_named_and_the_others_have_their_tables(
    run: Path, tmp_path: Path, madrob: Madrob
) -> None:
    results, output = tmp_path / "results", tmp_path / "tables"
    copies = [copy_run(results, number) for number in (1, 2)]
    twin = shutil.copytree(copies[0], tmp_path / "elsewhere" / copies[0].name)
    publish(run, tmp_path / "published")
    paths = (results, tmp_path / "nowhere", twin, tmp_path / "published")
    said = madrob.say("table samples", *paths, "--output", output)
    assert (said.code, said.out.splitlines()) == (
        2,
        [str(output / f"{copy.name}_{one.name}.csv") for copy in copies for one in SAMPLE_TABLES],
    )
    same_name, nowhere, published = said.err.splitlines()
    assert str(tmp_path / "nowhere") in nowhere
    assert f"{twin}: is called like {copies[0]}" in same_name
    assert "files without a recording" in published


def test_an_aborted_run_has_its_series_too_and_the_latch_sensor_a_table(tmp_path: Path) -> None:
    of_aborted = samples_of(aborted(), tmp_path, None)
    assert of_aborted["run"].outcome.tolist() == ["aborted"]
    assert of_aborted["door"].since_start.max() > 3.0
    drive = Drive(tmp_path / "results", latch=True)
    drive.whole_run(make_setup())
    drive.engine.close()
    write_samples(*runs_at(drive.folder), output=tmp_path, rules=None)
    facts, latch = (read_csv(tmp_path / f"{drive.folder.name}_{n}.csv") for n in ("run", "latch"))
    assert facts.lock_detection.tolist() == ["sensor"]
    engaged = latch.engaged.tolist()
    assert (engaged[0], all(engaged), engaged[-1]) == (True, False, True)


# ---------------------------------------------------------------- in a program


def test_the_frames_are_the_tables_of_the_command(archive: Path, madrob: Madrob) -> None:
    frames = all_tables(archive)
    for one in RUN_TABLES:
        assert madrob(f"table {one.name}", archive) == frames[one.name].to_csv(index=False)
    assert [str(kind) for kind in frames["indicators"].dtypes] != ["object"] * 18


def test_the_frames_of_samples_have_what_was_measured_in_all_runs(archive: Path) -> None:
    frames = all_tables(archive)
    runs = [SampledRun.of(RunPath(Path(place))) for place in frames["runs"].place]
    for one in SAMPLE_TABLES:
        assert list(frames[one.name].columns) == [column.name for column in one.columns]
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
    frames = all_tables(tmp_path)
    assert len(frames["runs"]) == 2
    with pytest.warns(match="No such file"):
        assert set(frames["run"].outcome) == {"completed"}
    (torn / "result.json").write_text("{}")
    with pytest.warns(match=r"result\.json"):
        assert all_tables(tmp_path)["runs"].place.tolist() == [str(whole)]
    with pytest.raises(MadrobError, match="no such folder"):
        all_tables(tmp_path / "nowhere")
