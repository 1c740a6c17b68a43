"""`madrob table runs`, `indicators`, `events`, `steps`: all runs as one table each."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from madrob_console.cli.main import main
from madrob_console.common.files import read_bounded
from madrob_console.export.table_columns import RUN_TABLES, WHOSE, CellKind, TidyTable
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.recorded_runs import appealed, recorded
from tests.madrob_console.run_folders import summary, write

_EXACTLY: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__ < "3" else {}
"""Older versions round the last digit of what they read."""

OLDER = Path(__file__).parents[1] / "whole/version_0_1_0/results"


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
    assert main(["table", name, *map(str, arguments)]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    frame: pd.DataFrame = pd.read_csv(StringIO(told.out), **_EXACTLY)
    return frame


def test_runs_has_a_row_for_each_run_with_whose_and_which_it_is(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = table(capsys, "runs", archive)
    for row, stored in zip(frame.to_dict("records"), results_below(archive), strict=True):
        for key in ("subject", "team", "run_id", "testbed", "start", "outcome", "ruleset", "issue"):
            assert row[key] == stored[key]
        assert (row["condition"], row["run"]) == (stored["condition_number"], stored["run_number"])
        assert row["valid"] == (stored["outcome"] in {"completed", "timeout"})
        assert row["practice"]
        assert row["final"] == (stored["closure"] is not None)
        assert row["flags"] == "; ".join(flag["words"] for flag in stored["flags"])
        assert row["duration"] == stored["stop"] - stored["start"]
        assert row["libraries"] == "; ".join(map(" ".join, stored["libraries"].items()))
        recording = stored["files"][f"{row['folder']}_0.mcap"]
        assert row["recording_sha256"] == recording["sha256"]
        assert json.loads((Path(row["place"]) / "result.json").read_text()) == stored


def test_runs_tells_which_numbers_of_the_testbed_are_not_the_protocols(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (first, _) = results_below(archive)
    first["thresholds"]["lintel_height"] = 2.2
    first["thresholds"]["doubt"]["gap_reach"] = 0.5
    del first["journal"]
    folder = tmp_path / "subject_003_cond_001_run_001_20231114_221323"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(first))
    (changed,) = table(capsys, "runs", tmp_path).thresholds_changed
    assert changed == "lintel_height 2.2; doubt.gap_reach 0.5"


def test_runs_of_halls_that_read_a_signal_otherwise_have_another_digest(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (first, _) = results_below(archive)
    del first["journal"]
    told = first.pop("mappings")
    scaled = [one | {"scale": 2.0} if one["signal"] == "handle force" else one for one in told]
    halls = {"A": told, "B": told[::-1], "C": scaled, "D": None}
    for number, (hall, mappings) in enumerate(halls.items(), start=1):
        folder = tmp_path / f"subject_003_cond_001_run_001_2023111{number}_221323"
        folder.mkdir()
        key = {} if mappings is None else {"mappings": mappings}
        result = first | key | {"testbed": hall, "run_id": hall}
        (folder / "result.json").write_text(json.dumps(result))
    for _ in range(2):  # the second time from the index
        digests = table(capsys, "runs", tmp_path).set_index("testbed").mapping_sha256
        assert digests.A == digests.B != digests.C
        assert digests.map(len, na_action="ignore").tolist()[:3] == [16, 16, 16]
        assert pd.isna(digests.D)


def test_a_table_reads_each_result_once_and_not_again_while_it_stays(
    archive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(archive, tmp_path / "archive")
    archive = tmp_path / "archive"
    read: list[str] = []

    def noted(path: str, largest: int) -> object:
        read.append(path)
        return read_bounded(path, largest)

    monkeypatch.setattr("madrob_console.archive.result_reader.read_bounded", noted)
    results = sorted(map(str, archive.rglob("result.json")))
    for one in RUN_TABLES:
        first = table(capsys, one.name, archive)
        assert sorted(read) == results
        read.clear()
        pd.testing.assert_frame_equal(table(capsys, one.name, archive), first)
        assert read == []
    archive.rename(tmp_path / "moved")
    place = table(capsys, "runs", tmp_path / "moved").place.tolist()
    assert sorted(f"{folder}/result.json" for folder in place) == [
        path.replace(str(archive), str(tmp_path / "moved")) for path in results
    ]
    read.clear()
    for path in (tmp_path / "moved").rglob("result.json"):
        path.with_name("journal.jsonl").unlink()
    table(capsys, "runs", tmp_path / "moved")
    assert len(read) == len(results)


def test_the_folder_one_is_in_is_read_again_when_its_result_changes(
    archive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = tmp_path / recorded(Scenario.TOUCH_ONLY).name
    shutil.copytree(next(archive.glob("hall_0/practice/*")), run)
    monkeypatch.chdir(run)
    assert len(table(capsys, "runs", ".")) == 1
    (run / "result.json").unlink()
    assert main(["table", "runs", "."]) == 2
    assert "has no result.json" in capsys.readouterr().err
    assert not (run / ".history.sqlite").exists()


def test_indicators_events_and_steps_have_what_the_results_have(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = {result["run_id"]: result for result in results_below(archive)}
    indicators = table(capsys, "indicators", archive)
    assert len(indicators) == 8 * len(results)
    for row in indicators.to_dict("records"):
        one = results[row["run_id"]]["indicators"][row["indicator"]]
        known = one["uncertainty"] or {"u": None, "expanded": None}
        told = row["value"], row["uncertainty"], row["expanded_uncertainty"], row["reason"]
        stored = one["value"], known["u"], known["expanded"], one["reason"]
        assert [None if pd.isna(cell) else cell for cell in told] == list(stored)
        assert row["unit"] == one["unit"]
        assert ("" if pd.isna(row["doubts"]) else row["doubts"]) == "; ".join(one["doubts"])
    events = table(capsys, "events", archive)
    assert list(zip(events.run_id, events.event, events.time, strict=True)) == [
        (key, event["event"], event["time"])
        for key, result in results.items()
        for event in result["events"]
    ]
    steps = table(capsys, "steps", archive)
    counting = [step["final"] for result in results.values() for step in result["steps"]]
    assert [None if pd.isna(cell) else cell for cell in steps.time] == counting
    assert steps.done.tolist() == [time is not None for time in counting]


def test_every_format_has_the_same_cells_with_their_types(archive: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `tables`")
    for one in RUN_TABLES:
        for kind in ("csv", "ndjson", "parquet"):
            file = tmp_path / f"{one.name}.{kind}"
            arguments = ["table", one.name, str(archive), "--format", kind, "--output", str(file)]
            assert main(arguments) == 0
        lines = (tmp_path / f"{one.name}.ndjson").read_text().splitlines()
        rows = [json.loads(line) for line in lines]
        frame = pd.read_parquet(tmp_path / f"{one.name}.parquet")
        plain = frame.astype(object).where(frame.notna(), None)
        assert plain.to_dict("records") == rows
        kinds: dict[str, Any] = {column.name: column.kind.value for column in one.columns}
        text = pd.read_csv(tmp_path / f"{one.name}.csv", dtype=kinds, **_EXACTLY)
        assert list(text) == list(frame) == [column.name for column in one.columns]
        for column in one.columns:
            if column.kind is not CellKind.TEXT:
                assert frame[column.name].dtype == column.kind.value
                pd.testing.assert_series_equal(text[column.name], frame[column.name])
            assert frame.attrs[column.name] == f"{column.meaning} [{column.unit or '-'}]"


def test_runs_of_before_are_in_the_tables_and_what_has_no_result_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(OLDER, tmp_path / "a")
    shutil.copytree(OLDER, tmp_path / "deep/er/b")
    assert main(["table", "runs", str(tmp_path), "--format", "ndjson"]) == 2
    told = capsys.readouterr()
    rows = [json.loads(line) for line in told.out.splitlines()]
    assert len(rows) == len({row["run_id"] for row in rows}) == 5
    assert {row["testbed"] for row in rows} == {""}
    assert told.err.count("has no result.json") == 2
    assert told.err.count("the same run as") == 3
    assert "and 2 more runs that are there twice" in told.err


def test_an_archive_without_runs_gives_the_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "a", summary(testbed="Hall A"))
    assert main(["table", "runs", str(tmp_path), "--testbed-name", "Hall B"]) == 2
    assert "no such runs; there are 'Hall A'" in capsys.readouterr().err
    write(tmp_path / "b", summary(testbed="Hall B"))
    assert main(["table", "events", str(tmp_path), "--testbed-name", "Hall B"]) == 0
    assert capsys.readouterr().out.startswith("subject,team,condition,run,run_id,testbed,")
    assert main(["table", "runs", str(tmp_path), "--format", "parquet"]) == 2
    assert "--output" in capsys.readouterr().err


@pytest.mark.parametrize("one", RUN_TABLES, ids=lambda one: one.name)
@pytest.mark.parametrize(
    "command", [["{}", "--help"], ["{}", "--columns"], ["--columns"]], ids=" ".join
)
def test_help_and_columns_say_of_each_column_what_it_is(
    one: TidyTable, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["table", *(word.format(one.name) for word in command)])
    assert not end.value.code
    text = " ".join(capsys.readouterr().out.split())
    assert one.columns[: len(WHOSE)] == WHOSE
    for column in one.columns:
        assert " ".join(f"{column.name} {column.unit} {column.meaning}".split()) in text


_MEASURED = """
import re, sys
from pathlib import Path
from madrob_console.cli.main import main
code = main(sys.argv[1:])
print(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
sys.exit(code)
"""


@pytest.mark.slow
@pytest.mark.machine
@pytest.mark.parametrize("kind", ["csv", "ndjson", "parquet"])
def test_more_runs_need_no_more_memory(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow", reason="the extra `tables`")
    few = max(request.config.getoption("--runs"), 500)
    (told,) = results_below(recorded(Scenario.TOUCH_ONLY))
    peaks, made = [], 0
    for count in (few, 4 * few):
        while made < count:
            made += 1
            run = summary(made % 999 + 1, made % 20 + 1, made // 999 + 1, hour=made / 10)
            result = {
                **told,
                "subject": run.subject,
                "condition_number": run.condition,
                "run_number": run.run_number,
                "run_id": f"{made:032x}",
                "corrections": [],
            }
            del result["journal"]
            (tmp_path / "runs" / run.folder).mkdir(parents=True)
            (tmp_path / "runs" / run.folder / "result.json").write_text(json.dumps(result))
        command = ["table", "indicators", str(tmp_path / "runs"), "--format", kind]
        command += ["--output", str(tmp_path / "table")]
        program = [sys.executable, "-c", _MEASURED, *command]
        said = subprocess.run(program, capture_output=True, text=True, check=True)
        peaks.append(int(said.stdout.split()[-1]) * 1024)
    print(f"{few} runs: {peaks[0] / 1e6:.1f} MB, {4 * few}: {peaks[1] / 1e6:.1f} MB")
    assert peaks[1] - peaks[0] < 4000 * 3 * few  # what is known of a run, without its rows


def test_a_path_that_does_not_exist_leaves_the_table_that_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "runs.csv"
    table.write_text("kept\n")
    assert main(["table", "runs", str(tmp_path / "none"), "--output", str(table)]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert table.read_text() == "kept\n"
