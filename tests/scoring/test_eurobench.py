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
from scoring.rulesets import RulesetName
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


def test_a_recording_has_the_values_of_the_scripts(recorded: Path) -> None:
    expected = values(*files_in(recorded))
    for name, value in expected.items():
        written = yaml.safe_load((recorded / f"{name}.yaml").read_text())
        assert written["value"] == pytest.approx(value, rel=1e-14)


def test_its_files_have_the_same_values(recorded: Path) -> None:
    result, _ = evaluate_published(read_files(*files_in(recorded)))
    assert result.outcome is Outcome.COMPLETED
    for name, one in result.indicators.items():
        written = yaml.safe_load((recorded / f"{name}.yaml").read_text())
        assert written["value"] == one.value


def test_without_a_stop_the_last_step_ends_the_run(recorded: Path) -> None:
    events = files_in(recorded)[0]
    kept = [line for line in events.read_text().splitlines() if "benchmark_stop" not in line]
    events.write_text("\n".join(kept))
    result, _ = evaluate_published(read_files(*files_in(recorded)))
    assert result.outcome is Outcome.COMPLETED
    assert result.stop == pytest.approx(START + 11.05, abs=0.05)


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
    np.testing.assert_array_equal(run.joint_state.acceleration, expected.joint_state.acceleration)
    np.testing.assert_array_equal(run.force, [5.5, -7.25])


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("event", "", "event.csv: is empty"),
        ("event", "time,event\n", "event.csv: benchmark_start is there 0 times"),
        ("event", "time,event\n1,dog_barks\n", "row 1 below the header, column event: 'dog_barks'"),
        ("event", EVENTS + EVENTS[11:], "row 3 below the header, column time: does not come after"),
        ("wrench", "time,force\n1,2\n", "wrench.csv: column force_x is missing: give time,force_x"),
        ("wrench", WRENCH.replace("5.5", "soft"), "row 1 below the header, column force_x: 'soft'"),
        ("wrench", WRENCH.replace("5.5", "1_5"), "row 1 below the header, column force_x: '1_5'"),
        ("wrench", WRENCH.replace(".", ","), "with a decimal comma write ; between cells"),
        ("jointState", JOINT.replace("0.01", ""), "column position: '' is no finite number"),
        ("jointState", JOINT.replace("1.04", "1.02"), "row 3 below the header, column time"),
        ("jointState", JOINT.replace("0.5", "inf"), "column velocity: 'inf' is no finite number"),
    ],
)
def test_a_bad_table_is_one_line(folder: Path, kind: str, text: str, message: str) -> None:
    (folder / f"{PREFIX}_{kind}.csv").write_text(text)
    with pytest.raises(ScoringError) as refusal:
        read_run(folder, PREFIX)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("benchmark_type: [", "condition_1.yaml: is no YAML"),
        ("- 1", "condition_1.yaml: holds no `key: value` lines"),
        ("benchmark_type: 1", "condition_1.yaml: benchmark_type '' does not exist"),
        (CONDITION.replace("No Force", "Wind Ramp"), "describes another condition than 1"),
    ],
)
def test_a_bad_condition_is_one_line(folder: Path, text: str, message: str) -> None:
    (folder / "condition_1.yaml").write_text(text)
    with pytest.raises(ScoringError, match=message):
        read_run(folder, PREFIX)


def test_a_missing_or_large_file_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eurobench, "LARGEST_FILE", 20)
    with pytest.raises(ScoringError, match=r"event\.csv: is larger than"):
        read_run(folder, PREFIX)
    (folder / f"{PREFIX}_event.csv").unlink()
    with pytest.raises(ScoringError, match=r"event\.csv: is missing"):
        read_run(folder, PREFIX)


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
    for column in (run.joint_state.time, run.joint_state.acceleration, run.force):
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
