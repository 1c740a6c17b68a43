"""EUROBENCH's files, and the values of 2020 against pandas' words for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from scoring import eurobench
from scoring.eurobench import evaluate_published, indicator_files, read_files, read_run, run_files
from scoring.indicator_table import IndicatorName as Name
from scoring.indicator_table import RulesetName
from scoring.kinematics import JointState
from scoring.protocol import (
    Condition,
    Event,
    EventName,
    Outcome,
    ScoringError,
    Side,
    StartPose,
    Thresholds,
)
from scoring.result import Ending, Indicator
from scoring.rows import Rows
from scoring.run_info import RunInfo
from scoring.samples import Sample
from tests.scoring.clean_run import clean, door_fault, scored
from tests.scoring.pandas_scripts import values
from tests.scoring.runs import START, assessment, clear, door, under

PREFIX = "subject_001_cond_001_run_001"
BY_2020 = RulesetName.EUROBENCH_2020
INFO = RunInfo(
    subject=1,
    team="Nova",
    run_number=1,
    condition=Condition.from_number(1),
    start_time=START,
    start_pose=StartPose(2.0, -0.25, 180.0),
    timeout=300.0,
    ruleset=BY_2020,
    rosbag_path="run_0.mcap",
    settings={"lock_detection": "auto"},
)
EVENTS = f"time,event\n{START},benchmark_start\n{START + 2},handle_is_touched\n"
JOINT = "time,position,velocity,acceleration\n1.0,0.01,,\n1.02,0.02,0.5,-0.25\n1.04,0.02,,\n"
WRENCH = "time,force_x\n1.0,5.5\n1.02,-7.25\n"
CONDITION = "benchmark_type: No Force\ndoor_opening_side: CCW\nrobot_approach_side: CCW\n"


def files_in(folder: Path) -> list[Path]:
    return [
        *(folder / f"{PREFIX}_{kind}.csv" for kind in ("event", "wrench", "jointState")),
        folder / "condition_1.yaml",
    ]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run as published."""
    for path, text in zip(files_in(tmp_path), (EVENTS, WRENCH, JOINT, CONDITION), strict=True):
        path.write_text(text)
    return tmp_path


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """The files of a recorded run, made by the rules of 2020."""
    run = assessment(clean(), ruleset=BY_2020)
    result, rows = run.result(Ending(Outcome.COMPLETED, "", START + 11.4))
    events = [Event(one.time, one.event) for one in result.events]
    for name, content in run_files(INFO, events, rows, result.indicators).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def written_values(folder: Path) -> dict[str, float | int | str]:
    return {name: yaml.safe_load((folder / f"{name}.yaml").read_text())["value"] for name in Name}


def test_a_recording_has_the_values_of_the_scripts(recorded: Path) -> None:
    expected = values(*files_in(recorded))
    assert written_values(recorded) == pytest.approx(expected, rel=1e-14)


def test_its_files_have_the_same_values(recorded: Path) -> None:
    result, _ = evaluate_published(read_files(*files_in(recorded)))
    assert written_values(recorded) == {name: one.value for name, one in result.indicators.items()}
    assert (result.outcome, result.stop) == (Outcome.COMPLETED, START + 11.4)


@pytest.mark.parametrize(
    ("events", "outcome", "stop"),
    [
        (f"{START + 8},humanoid_moves_to_cw_side\n{START + 9},door_closes\n", "completed", 9.0),
        (f"{START + 7},door_closes\n{START + 8},benchmark_stop\n", "timeout", 8.0),
        (f"{START + 7},door_closes\n", "interrupted", None),
    ],
)
def test_the_events_tell_how_a_run_ended(
    folder: Path, events: str, outcome: str, stop: float | None
) -> None:
    files_in(folder)[0].write_text(EVENTS + events)
    result, _ = evaluate_published(read_run(folder, PREFIX))
    assert (result.outcome, result.stop) == (outcome, stop if stop is None else START + stop)


def test_what_no_sensor_can_say_counts() -> None:
    wild = door_fault(lambda t, angle: 3.0 if 6.0 < t < 6.02 else angle)(clean())
    plain, other = (scored(samples, BY_2020).indicators for samples in (clean(), wild))
    name = Name.UNSAFETY_OF_DOOR_OPERATION
    assert (other[name].value or 0) > 5 * (plain[name].value or 0)


def test_a_masked_sensor_is_absent() -> None:
    samples: list[Sample] = [
        clear(0.1, Side.CW, 0),
        under(1, Side.CW, 0),
        door(1.5, -0.2),
        under(2, Side.CW, 0),
    ]
    result, _ = assessment(samples, ruleset=BY_2020).result(
        Ending(Outcome.TIMEOUT, "", START + 9.0)
    )
    left = [one for one in result.events if one.event is EventName.MOVES_TO_CW]
    assert [one.since_start for one in left] == [2.0]


SPELLINGS: dict[str, Callable[[str], str]] = {
    "semicolons": lambda text: text.replace(",", ";"),
    "decimal commas": lambda text: text.replace(",", ";").replace(".", ","),
    "tabs": lambda text: text.replace(",", "\t"),
    "blanks": lambda text: text.replace(",", " ,  "),
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "a last separator": lambda text: text.replace("\n", ",\n"),
    "BOM": lambda text: "\ufeff" + text,
    "other columns": lambda text: "".join(f"x,{line},y\n" for line in text.splitlines()),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_other_spellings_read_the_same(folder: Path, spelling: str) -> None:
    expected = read_run(folder, PREFIX)
    for path in folder.glob("*.csv"):
        path.write_bytes(SPELLINGS[spelling](path.read_text()).encode())

    run = read_run(folder, PREFIX)

    assert run.events == expected.events
    np.testing.assert_array_equal(
        run.rows.joint_state.acceleration, expected.rows.joint_state.acceleration
    )
    np.testing.assert_array_equal(run.rows.force, [5.5, -7.25])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("event.csv", "", "event.csv: is no csv (No columns to parse from file)"),
        ("event.csv", "time,event\n", "event.csv: benchmark_start is there 0 times"),
        (
            "event.csv",
            "time,event\n1,door_opens\n2,benchmark_start\n",
            "something comes before benchmark_start",
        ),
        ("event.csv", "time,event\n1,dog_barks\n", "row 1 below the header, column event: 'dog"),
        ("event.csv", EVENTS + EVENTS[11:], "row 3 below the header, column time: does not come"),
        ("wrench.csv", "time,force\n1,2\n", "column force_x is missing: give time,force_x"),
        (
            "wrench.csv",
            WRENCH.replace("5.5", "soft"),
            "row 1 below the header, column force_x: 'so",
        ),
        ("wrench.csv", WRENCH.replace(".", ","), "with a decimal comma write ; between cells"),
        ("jointState.csv", JOINT.replace("0.01", ""), "row 1 below the header, column position"),
        ("jointState.csv", JOINT.replace("1.04", "1.02"), "row 3 below the header, column time"),
        ("jointState.csv", JOINT.replace("0.5", "inf"), "column velocity: 'inf' is no finite"),
        ("jointState.csv", "x" * 3000, "jointState.csv: is larger than"),
        ("condition_1.yaml", "benchmark_type: [", "condition_1.yaml: is no YAML"),
        ("condition_1.yaml", "- 1", "condition_1.yaml: holds no `key: value` lines"),
        ("condition_1.yaml", "benchmark_type: 1", "condition_1.yaml: benchmark_type '' does not"),
    ],
)
def test_a_bad_file_is_one_line(
    folder: Path, name: str, text: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eurobench, "LARGEST_FILE", 2000)
    (path,) = folder.glob(f"*{name}")
    path.write_text(text)
    with pytest.raises(ScoringError) as refusal:
        read_run(folder, PREFIX)
    assert str(refusal.value).startswith(str(path))
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_file_is_named(folder: Path) -> None:
    (folder / f"{PREFIX}_event.csv").unlink()
    with pytest.raises(ScoringError, match=r"event\.csv: cannot be read \(No such file"):
        read_run(folder, PREFIX)


def test_what_the_files_say_of_the_condition_counts(folder: Path) -> None:
    (folder / "condition_1.yaml").write_text(CONDITION.replace("No Force", "Wind Ramp"))
    assert read_run(folder, PREFIX).condition.number == 5


def test_a_table_without_rows_has_no_values(folder: Path) -> None:
    for path in folder.glob("*[he].csv"):
        path.write_text(path.read_text().partition("\n")[0])
    result, _ = evaluate_published(read_run(folder, PREFIX))
    unsafety = result.indicators[Name.UNSAFETY_OF_DOOR_OPERATION]
    roughness = result.indicators[Name.ROUGHNESS_OF_DOOR_ACTUATION]
    assert (unsafety.reason, roughness.reason) == (
        "no door angle recorded during the run",
        "no handle force recorded",
    )


def test_every_digit_survives_the_files(tmp_path: Path) -> None:
    numbers = np.sort(np.random.RandomState(1).standard_normal(500) * 1e-7)
    joint = JointState(numbers, numbers, numbers, numbers)
    rows = Rows(joint, numbers, numbers, numbers, numbers, numbers, None, Thresholds())
    events = [Event(float(numbers[0]), EventName.BENCHMARK_START)]
    for name, content in run_files(INFO, events, rows, {}).items():
        (tmp_path / name).write_bytes(content)

    run = read_run(tmp_path, PREFIX)

    assert run.events == tuple(events)
    assert run.run_info == INFO.mapping()
    for column in (run.rows.joint_state.time, run.rows.joint_state.acceleration, run.rows.force):
        assert column.tobytes() == numbers.tobytes()


def test_run_info_has_the_published_keys() -> None:
    info = replace(INFO, condition=Condition.from_number(14), start_pose=None).mapping()
    assert (info["robot_name"], info["door_controller_mode"]) == ("1", 1)
    assert info["LUTcw"] == list(reversed(info["LUTccw"]))  # type: ignore[call-overload]


@pytest.mark.parametrize(("rules", "value"), [("protocol", "null"), (BY_2020, "TIMEOUT")])
def test_a_missing_value_is_null_or_timeout(rules: str, value: str) -> None:
    missing = {Name.PASSAGE_TIME: Indicator.missing(Name.PASSAGE_TIME, "door never closed")}
    written = indicator_files(missing, RulesetName(rules))
    assert written["passage_time.yaml"].decode() == f"type: scalar\nvalue: {value}\n"
