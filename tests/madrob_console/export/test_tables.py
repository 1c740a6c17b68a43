"""`madrob table`: runs, indicators, events, steps and samples, as tables for programs."""

from __future__ import annotations

import json
import shutil
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import runs_at
from madrob_console.archive.table_columns import (
    DOOR,
    RUN_TABLES,
    SAMPLE_TABLES,
    WHOSE,
    TidyTable,
)
from madrob_console.archive.table_rows import Frames
from madrob_console.cli.main import main
from madrob_console.cli.table_command import write_samples
from madrob_console.referee.acts import Abort
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import PASSAGE_SENSORS, Thresholds
from scoring.rulesets import EUROBENCH_2020, RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import appealed, copy_run, publish, recorded
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


def code_of(*arguments: object) -> int:
    try:
        return main(["table", *map(str, arguments)])
    except SystemExit as end:  # argparse
        return int(end.code or 0)


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


def table(capsys: pytest.CaptureFixture[str], name: str, *arguments: object) -> pd.DataFrame:
    assert code_of(name, *arguments) == 0
    told = capsys.readouterr()
    assert told.err == ""
    return read_csv(StringIO(told.out))


def test_runs_has_a_row_for_each_run_with_whose_and_which_it_is(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = table(capsys, "runs", archive)
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


def test_runs_tells_which_numbers_are_not_the_protocols_and_who_reads_a_signal_otherwise(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (first, _) = results_below(archive)
    del first["journal"]
    first["thresholds"]["lintel_height"] = 2.2
    first["thresholds"]["doubt"]["gap_reach"] = 0.5
    told = first.pop("mappings")
    scaled = [one | {"scale": 2.0} if one["signal"] == "handle force" else one for one in told]
    halls = {"A": told, "B": told[::-1], "C": scaled, "D": None}
    for number, (hall, mappings) in enumerate(halls.items(), start=1):
        folder = tmp_path / f"subject_003_cond_001_run_001_2023111{number}_221323"
        folder.mkdir()
        key = {} if mappings is None else {"mappings": mappings}
        result = first | key | {"testbed": hall, "run_id": hall}
        (folder / "result.json").write_text(json.dumps(result))
    frame = table(capsys, "runs", tmp_path).set_index("testbed")
    assert set(frame.thresholds_changed) == {"lintel_height 2.2; doubt.gap_reach 0.5"}
    digests = frame.mapping_sha256
    assert digests.A == digests.B != digests.C
    assert [len(digests[hall]) for hall in "ABC"] == [16] * 3
    assert pd.isna(digests.D)
    path = folder / "result.json"
    path.write_text(path.read_text().replace('"testbed": "D"', '"testbed": "E"'))
    assert set(table(capsys, "runs", tmp_path).testbed) == set("ABCE")


@pytest.mark.parametrize("team", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\x1b[31m=1", "\uff1d1"])
def test_no_text_of_a_table_is_run_by_a_spreadsheet_or_obeyed_by_a_terminal(
    team: str, archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (first, _) = results_below(archive)
    folder = tmp_path / "subject_003_cond_001_run_001_20231114_221323"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(first | {"team": team}))
    (found,) = table(capsys, "runs", tmp_path).team
    assert found.startswith(("'", " ="))
    assert found.isprintable()
    assert Frames(tmp_path)["runs"].team.tolist() == [found.removeprefix("'")]


def test_indicators_events_and_steps_have_what_the_results_have(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = {result["run_id"]: result for result in results_below(archive)}
    told = {name: plain(table(capsys, name, archive)) for name in ("indicators", "events", "steps")}
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
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(1, 6):
        write(tmp_path / "a", summary(3, run_number=number, run_id=f"the {number}th"))
    (tmp_path / "a/subject_003_cond_001_run_009_20231114_221323").mkdir()
    shutil.copytree(tmp_path / "a", tmp_path / "deep/er/b")
    assert code_of("runs", tmp_path) == 2
    told = capsys.readouterr()
    rows = read_csv(StringIO(told.out))
    assert len(rows) == rows.run_id.nunique() == 5
    assert told.err.count("has no result.json") == 2
    assert told.err.count("the same run as") == 3
    assert "and 2 more runs that are there twice" in told.err


@pytest.mark.parametrize("one", [*RUN_TABLES, *SAMPLE_TABLES], ids=lambda one: one.name)
def test_help_and_columns_say_of_each_column_what_it_is(
    one: TidyTable, capsys: pytest.CaptureFixture[str]
) -> None:
    of_runs = one in RUN_TABLES
    name = one.name if of_runs else "samples"
    for command in ([name, "--help"], *([[name, "--columns"], ["--columns"]] if of_runs else [])):
        assert code_of(*command) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert of_runs or f"{one.name}: {one.row} " in text
        for column in one.columns if of_runs or one is DOOR else ():
            assert " ".join(f"{column.name} {column.unit} {column.meaning}".split()) in text
    assert not of_runs or one.columns[: len(WHOSE)] == WHOSE


REFUSED: dict[str, tuple[list[str], str]] = {
    "no such testbed": (
        ["runs", "{root}", "--testbed-name", "Hall B"],
        "no such runs; there are 'Hall A'",
    ),
    "no such folder": (["runs", "{root}/none", "--output", "{kept}"], "no such folder"),
    "no place for samples": (["samples", "{run}"], "--output"),
    "a file for a folder": (["samples", "{run}", "--output", "{kept}"], "{kept}: "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_made_is_a_line_and_leaves_what_is_there(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, summary(testbed="Hall A"))
    kept = tmp_path / "kept.csv"
    kept.write_text("kept\n")
    arguments, words = REFUSED[case]
    places = {"root": tmp_path, "kept": kept, "run": recorded(Scenario.TOUCH_ONLY)}
    assert code_of(*(word.format(**places) for word in arguments)) == 2
    told = capsys.readouterr()
    assert words.format(**places) in told.err.splitlines()[-1]
    assert told.out == ""
    assert kept.read_text() == "kept\n"
    assert not (tmp_path / "tables").exists()


def test_a_table_without_rows_has_its_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, summary(testbed="Hall B"))
    assert code_of("events", tmp_path, "--testbed-name", "Hall B") == 0
    assert capsys.readouterr().out.startswith("subject,team,condition,run,run_id,testbed,")


# ---------------------------------------------------------------- of a run's samples


def samples_of(run: Path, folder: Path, *options: str) -> dict[str, pd.DataFrame]:
    """The tables of a run, by name."""
    assert code_of("samples", run, "--output", folder, *options) == 0
    found = {one.name: folder / f"{run.name}_{one.name}.csv" for one in SAMPLE_TABLES}
    assert set(folder.glob("*.csv")) == set(found.values())
    return {name: read_csv(path) for name, path in found.items()}


@pytest.fixture(scope="module")
def run() -> Path:
    return recorded(Scenario.NOMINAL)


@pytest.fixture(scope="module")
def tables(run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    return samples_of(run, tmp_path_factory.mktemp("far") / "tables")


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


def test_other_rules_give_other_tables(run: Path, tmp_path: Path) -> None:
    tables = samples_of(run, tmp_path, "--ruleset", "eurobench-2020")
    (scored,) = score(run, RulesetName.EUROBENCH_2020)
    facts, door = tables["run"].iloc[0], tables["door"]
    told = (facts.ruleset, facts.present_height, facts.rows_from, facts.rows_until)
    assert told == ("eurobench-2020", EUROBENCH_2020.present_height, -np.inf, np.inf)
    np.testing.assert_array_equal(door.low_passed_acceleration, scored.result.rows.low_passed)
    assert door.jerk.dropna().tolist() == scored.result.rows.jerk.tolist()


def test_a_bad_run_is_named_and_the_others_have_their_tables(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, output = tmp_path / "results", tmp_path / "tables"
    copies = [copy_run(results, number) for number in (1, 2)]
    twin = shutil.copytree(copies[0], tmp_path / "elsewhere" / copies[0].name)
    publish(run, tmp_path / "published")
    paths = (results, tmp_path / "nowhere", twin, tmp_path / "published")
    assert code_of("samples", *paths, "--output", output) == 2
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        str(output / f"{copy.name}_{table.name}.csv") for copy in copies for table in SAMPLE_TABLES
    ]
    same_name, nowhere, published = said.err.splitlines()
    assert str(tmp_path / "nowhere") in nowhere
    assert f"{twin}: is called like {copies[0]}" in same_name
    assert "files without a recording" in published


def test_an_aborted_run_has_its_series_too_and_the_latch_sensor_a_table(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "results", latch=True)
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("somebody in the doorway"))
    drive.finish()
    drive.whole_run(make_setup(run_number=2))
    drive.engine.close()
    aborted, whole = sorted(runs_at(tmp_path / "results"), key=lambda run: run.name)
    for of in (aborted, whole):
        write_samples(of, output=tmp_path, rules=None)
    stems = [tmp_path / of.path.name for of in (aborted, whole)]
    facts, door = (read_csv(f"{stems[0]}_{name}.csv") for name in ("run", "door"))
    assert facts.outcome.tolist() == ["aborted"]
    assert door.since_start.max() > 3.0
    facts, latch = (read_csv(f"{stems[1]}_{name}.csv") for name in ("run", "latch"))
    assert facts.lock_detection.tolist() == ["sensor"]
    engaged = latch.engaged.tolist()
    assert (engaged[0], all(engaged), engaged[-1]) == (True, False, True)
