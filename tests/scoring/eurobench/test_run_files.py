from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from scoring.eurobench import run_files as eurobench
from scoring.eurobench.run_files import EurobenchRun, Wrench, door_stays_closed, read_run, run_files
from scoring.eurobench.run_info import RunInfo, run_prefixes
from scoring.indicator_table import IndicatorName
from scoring.kinematics import JointState, joint_state
from scoring.protocol import Condition, Event, EventName, ScoringError, StartPose, Thresholds
from scoring.result import Indicator
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset, RulesetName

START = 1580487388.2376215
PREFIX = "subject_001_cond_001_run_001"
INFO = RunInfo(
    subject=1,
    team="Nova",
    run_number=1,
    condition=Condition.from_number(1),
    start_time=START,
    start_pose=StartPose(2.0, -0.25, 180.0),
    timeout=300.0,
    ruleset=RulesetName.PROTOCOL,
    rosbag_path="run_0.mcap",
    settings={"lock_detection": "auto"},
)
EVENTS = (
    Event(START, EventName.BENCHMARK_START),
    Event(START + 2.1, EventName.HANDLE_IS_TOUCHED),
    Event(START + 3.3, EventName.DOOR_OPENS),
)
TIME = START + np.arange(40) / 50
JOINT = joint_state(TIME, 0.1 * np.sin(TIME), PROTOCOL, Thresholds())
WRENCH = Wrench(TIME, np.where(np.arange(40) == 7, np.nan, 5.9 + np.cos(TIME)))
INDICATORS = {
    IndicatorName.TIME_TO_HANDLE: Indicator.of(IndicatorName.TIME_TO_HANDLE, 5e-07),
    IndicatorName.CAPABILITY_LEVEL: Indicator.of(IndicatorName.CAPABILITY_LEVEL, 3),
    IndicatorName.PASSAGE_TIME: Indicator.missing(IndicatorName.PASSAGE_TIME, "door never closed"),
}

EVENT_TEXT = f"time,event\n{START},benchmark_start\n{START + 2},handle_is_touched\n"
JOINT_TEXT = "time,position,velocity,acceleration\n1.0,0.01,,\n1.02,0.02,0.5,-0.25\n1.04,0.02,,\n"
WRENCH_TEXT = "time,force_x\n1.0,5.5\n1.02,-7.25\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run as published."""
    for kind, text in (("event", EVENT_TEXT), ("jointState", JOINT_TEXT), ("wrench", WRENCH_TEXT)):
        (tmp_path / f"{PREFIX}_{kind}.csv").write_text(text)
    (tmp_path / "condition_1.yaml").write_text(
        "benchmark_type: No Force\ndoor_opening_side: CCW\nrobot_approach_side: CCW\n"
    )
    (tmp_path / f"run_info_{PREFIX}.yaml").write_text("robot_name: '1'\nrun_number: 1\n")
    return tmp_path


def write(
    folder: Path,
    info: RunInfo,
    events: Sequence[Event],
    joint: JointState,
    wrench: Wrench,
    indicators: Mapping[IndicatorName, Indicator],
) -> None:
    for name, content in run_files(info, events, joint, wrench, indicators).items():
        (folder / name).write_bytes(content)


def read_eurobench(folder: Path) -> tuple[EurobenchRun, ...]:
    names = (path.name for path in folder.iterdir())
    return tuple(read_run(folder, prefix) for prefix in run_prefixes(names))


def refusal(folder: Path) -> str:
    with pytest.raises(ScoringError) as caught:
        read_eurobench(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(folder))
    return message.removeprefix(str(folder)).lstrip("/").removeprefix(f"{PREFIX}_")


def test_a_published_run_is_read_as_it_is(folder: Path) -> None:
    (run,) = read_eurobench(folder)
    assert run.condition == Condition.from_number(1)
    assert run.start_time == START
    assert run.events == (
        Event(START, EventName.BENCHMARK_START),
        Event(START + 2, EventName.HANDLE_IS_TOUCHED),
    )
    np.testing.assert_array_equal(run.joint_state.acceleration, [np.nan, -0.25, np.nan])
    np.testing.assert_array_equal(run.joint_state.velocity, [np.nan, 0.5, np.nan])
    assert run.joint_state.position.tolist() == [0.01, 0.02, 0.02]
    assert run.joint_state.reason is None
    assert run.wrench.force.tolist() == [5.5, -7.25]
    assert run.run_info["robot_name"] == "1"


SPELLINGS: dict[str, Callable[[str], str]] = {
    "semicolons": lambda text: text.replace(",", ";"),
    "blanks": lambda text: text.replace(",", " ,  "),
    "semicolons and blanks": lambda text: text.replace(",", "; "),
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "old Mac": lambda text: text.replace("\n", "\r"),
    "BOM": lambda text: "\ufeff" + text,
    "empty lines": lambda text: "\n" + text.replace("\n", "\n\n"),
    "no last newline": lambda text: text.rstrip("\n"),
    "quotes": lambda text: text.replace("time", '"time"'),
    "other columns": lambda text: "".join(f"x,{line},y\n" for line in text.splitlines()),
    "reverse order": lambda text: "".join(
        ",".join(reversed(line.split(","))) + "\n" for line in text.splitlines()
    ),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_other_spellings_of_a_table_read_the_same(folder: Path, spelling: str) -> None:
    expected = read_run(folder, PREFIX)
    for path in folder.glob("*.csv"):
        text = SPELLINGS[spelling](path.read_text())
        path.write_bytes(text.encode())
    run = read_run(folder, PREFIX)
    assert run.events == expected.events
    for column in ("time", "position", "velocity", "acceleration"):
        read, plain = (getattr(one.joint_state, column) for one in (run, expected))
        np.testing.assert_array_equal(read, plain)
    np.testing.assert_array_equal(run.wrench.force, expected.wrench.force)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("event", "", "event.csv: is empty: write it again, header line included"),
        ("event", "time,event\n", "event.csv, column event: benchmark_start is there 0 times"),
        ("event", EVENT_TEXT + EVENT_TEXT[11:], "event.csv, line 4, column time: "),
        ("event", "time,event\n1,benchmark_start\n1,benchmark_start", "is there 2 times"),
        ("event", "time,event\n1,dog_barks\n", "line 2, column event: 'dog_barks' is no event"),
        ("event", "time,event\n1\n", "event.csv, line 2, column event: is missing: give 2 cells"),
        ("event", "time,event\n1,door_opens,x", "line 2, column 3: is not in the header"),
        ("jointState", "\n \n", "jointState.csv: is empty"),
        (
            "jointState",
            "time,position,velocity\n1,2,3\n",
            "jointState.csv, line 1, column acceleration: is missing: give the header time,pos",
        ),
        (
            "jointState",
            "time,time,position,velocity,acceleration\n",
            "jointState.csv, line 1, column time: is there more than once",
        ),
        ("jointState", JOINT_TEXT.replace("0.01", ""), "line 2, column position: '' is no finite"),
        ("jointState", JOINT_TEXT.replace("0.01", "nan"), "line 2, column position: 'nan' is"),
        ("jointState", JOINT_TEXT.replace("0.01", "1e999"), "column position: '1e999' is no"),
        ("jointState", JOINT_TEXT.replace("0.01", "1_0"), "column position: '1_0' is no finite"),
        ("jointState", JOINT_TEXT.replace("-0.25", "inf"), "line 3, column acceleration: 'inf'"),
        ("jointState", JOINT_TEXT.replace("0.5", "fast"), "line 3, column velocity: 'fast' is"),
        ("jointState", JOINT_TEXT.replace("1.04", "1.02"), "line 4, column time: 1.02 does not"),
        ("jointState", JOINT_TEXT.replace("1.04", "0.5"), "line 4, column time: 0.5 does not"),
        ("jointState", JOINT_TEXT.replace("1.04", "NaN"), "line 4, column time: 'NaN' is no"),
        (
            "wrench",
            WRENCH_TEXT.replace("5.5", "-inf"),
            "wrench.csv, line 2, column force_x: '-inf'",
        ),
        ("wrench", WRENCH_TEXT.replace("5.5", "0\0"), "wrench.csv, line 2, column force_x: "),
        ("wrench", WRENCH_TEXT.replace("5.5", "9" * 200_000), "wrench.csv, line 2: is no CSV"),
        (  # the line of the file, not of the data
            "wrench",
            "\n\ntime,force_x\n\n1.0,5.5\n\n1.02,soft\n",
            "wrench.csv, line 7, column force_x: 'soft'",
        ),
    ],
)
def test_a_bad_table_is_refused_in_one_line_that_names_the_place(
    folder: Path, kind: str, text: str, message: str
) -> None:
    (folder / f"{PREFIX}_{kind}.csv").write_text(text)
    assert message in refusal(folder)


def test_a_lost_reading_of_the_force_is_an_empty_cell(folder: Path) -> None:
    (folder / f"{PREFIX}_wrench.csv").write_text("time,force_x\n1.0,\n1.02,nan\n1.04,2\n")
    (run,) = read_eurobench(folder)
    np.testing.assert_array_equal(run.wrench.force, [np.nan, np.nan, 2.0])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (JOINT_TEXT.splitlines()[0], "no door angle recorded"),
        (JOINT_TEXT.replace("-0.25", ""), "no acceleration in the file"),
    ],
)
def test_a_file_without_acceleration_gives_a_reason(folder: Path, text: str, reason: str) -> None:
    (folder / f"{PREFIX}_jointState.csv").write_text(text)
    (run,) = read_eurobench(folder)
    assert run.joint_state.reason == reason


def test_missing_and_unreadable_files_are_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / f"{PREFIX}_wrench.csv"
    path.write_bytes(b"time,force_x\n1.0,\xff\xfe\n")
    assert "wrench.csv: is no UTF-8 text" in refusal(folder)
    path.unlink()
    assert "wrench.csv: is missing" in refusal(folder)
    path.mkdir()
    assert "wrench.csv: is missing" in refusal(folder)
    monkeypatch.setattr(eurobench, "LARGEST_TABLE", 20)
    assert "event.csv: is larger than" in refusal(folder)
    with pytest.raises(ScoringError, match="names no run"):
        read_run(folder, "../subject_1")


def test_several_runs_of_a_folder_come_by_name(folder: Path) -> None:
    for kind in ("event", "jointState", "wrench"):
        text = (folder / f"{PREFIX}_{kind}.csv").read_text()
        (folder / f"subject_002_cond_012_run_003_{kind}.csv").write_text(text)
    first, second = read_eurobench(folder)
    assert (first.condition.number, second.condition.number) == (1, 12)
    assert second.run_info == {}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("condition_1.yaml", "benchmark_type: [", "condition_1.yaml, line 1: is no YAML"),
        ("condition_1.yaml", "date: 2020-13-45", "condition_1.yaml: is no YAML"),
        ("condition_1.yaml", "date: !!timestamp x", "condition_1.yaml: is no YAML"),
        ("condition_1.yaml", "[" * 1000, "condition_1.yaml: is no YAML"),
        ("condition_1.yaml", "!!python/object/apply:os.getcwd []", "condition_1.yaml, line 1: is"),
        ("condition_1.yaml", "- 1", "condition_1.yaml: holds no `key: value` lines"),
        ("condition_1.yaml", "benchmark_type: 1", "condition_1.yaml: benchmark_type '' does not"),
        (
            "condition_1.yaml",
            "benchmark_type: Wind Ramp\ndoor_opening_side: LEFT\nrobot_approach_side: CW",
            "condition_1.yaml: door_opening_side 'LEFT' is no side: use CW or CCW",
        ),
        (
            f"run_info_{PREFIX}.yaml",
            "benchmark_type: Wind Ramp\ndoor_opening_side: CW\nrobot_approach_side: CW",
            f"run_info_{PREFIX}.yaml: describes condition 20, but the run's files are named",
        ),
    ],
)
def test_a_bad_condition_is_refused(folder: Path, name: str, text: str, message: str) -> None:
    (folder / name).write_text(text)
    assert refusal(folder).startswith(message)


def test_a_condition_that_does_not_exist_is_refused(folder: Path) -> None:
    for path in list(folder.glob("*.csv")):
        path.rename(folder / path.name.replace("cond_001", "cond_021"))
    assert "condition 21 does not exist" in refusal(folder)


@settings(max_examples=30)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, unique=True))
def test_every_digit_survives_the_files(values: list[float]) -> None:
    times = np.array(sorted({*values}))
    joint = JointState(times, times[::-1], times * 0.1, times[::-1] * 0.3)
    event = (Event(float(times[0]), EventName.BENCHMARK_START),)
    with tempfile.TemporaryDirectory() as name:
        write(Path(name), INFO, event, joint, Wrench(times, times), {})
        (run,) = read_eurobench(Path(name))
    assert (run.events, run.condition) == (event, INFO.condition)
    assert run.run_info == INFO.mapping()
    for column in ("time", "position", "velocity", "acceleration"):
        written, read = getattr(joint, column), getattr(run.joint_state, column)
        assert written.tobytes() == read.tobytes()


def test_files_are_spelt_as_eurobench_spells_them(tmp_path: Path) -> None:
    write(tmp_path, INFO, EVENTS, JOINT, WRENCH, INDICATORS)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "capability_level.yaml",
        "condition_1.yaml",
        "passage_time.yaml",
        "run_info_subject_001_cond_001_run_001.yaml",
        "subject_001_cond_001_run_001_event.csv",
        "subject_001_cond_001_run_001_jointState.csv",
        "subject_001_cond_001_run_001_wrench.csv",
        "time_to_handle.yaml",
    ]
    assert (tmp_path / "condition_1.yaml").read_text() == (
        "benchmark_type: No Force\ndoor_opening_side: CCW\nrobot_approach_side: CCW\n"
    )
    lines = (tmp_path / f"{PREFIX}_jointState.csv").read_bytes().decode().split("\n")
    assert lines[0] == "time,position,velocity,acceleration"
    assert lines[1] == f"{START!r},{float(JOINT.position[0])!r},,"
    lines = (tmp_path / f"{PREFIX}_event.csv").read_bytes().decode().split("\n")
    assert lines[:2] == ["time,event", "1580487388.2376215,benchmark_start"]
    assert (tmp_path / "capability_level.yaml").read_text() == "type: scalar\nvalue: 3\n"
    assert yaml.safe_load((tmp_path / "time_to_handle.yaml").read_text())["value"] == 5e-07


@pytest.mark.parametrize(
    ("rules", "value"), [(PROTOCOL, "null"), (EUROBENCH_2020, "TIMEOUT")], ids=["null", "TIMEOUT"]
)
def test_a_missing_value_is_null_or_what_the_published_scripts_write(
    rules: Ruleset, value: str
) -> None:
    files = run_files(replace(INFO, ruleset=rules.name), EVENTS, JOINT, WRENCH, INDICATORS)
    assert files["passage_time.yaml"].decode() == f"type: scalar\nvalue: {value}\n"


def test_run_info_has_the_published_keys_and_ours() -> None:
    info = replace(INFO, condition=Condition.from_number(14), start_pose=None)
    files = run_files(info, EVENTS, JOINT, WRENCH, {})
    text = files["run_info_subject_001_cond_014_run_001.yaml"].decode()
    assert "start_time: 1580487388.2376215\nrobot_name: '1'\n" in text
    assert "&id" not in text
    content = yaml.safe_load(text)
    assert content["LUTcw"] == content["LUTccw"][::-1]
    assert len(content["LUTcw"]) == 181
    expected = {
        "benchmark_type": "Sudden Ramp",
        "door_opening_side": "CCW",
        "robot_approach_side": "CW",
        "condition_number": 14,
        "door_controller_mode": 1,
        "team": "Nova",
        "start_pose": None,
        "timeout": 300.0,
        "ruleset": "protocol",
        "settings": {"lock_detection": "auto"},
    }
    assert {key: content[key] for key in expected} == expected


def test_a_setting_without_a_yaml_form_is_refused() -> None:
    info = replace(INFO, settings={"zero": object()})
    with pytest.raises(ScoringError, match="use plain types"):
        run_files(info, EVENTS, JOINT, WRENCH, {})


def test_an_empty_run_is_written_and_read(tmp_path: Path) -> None:
    nothing = np.array([])
    joint = joint_state(nothing, nothing, PROTOCOL, Thresholds())
    write(tmp_path, INFO, EVENTS[:1], joint, Wrench(nothing, nothing), {})
    (run,) = read_eurobench(tmp_path)
    assert run.joint_state.reason == joint.reason == "no door angle recorded"
    assert run.wrench.force.size == 0


SHUT = [0.01] * 50


@pytest.mark.parametrize(
    ("angles", "interval", "limits", "stays"),
    [
        *(
            ([0.05, 0.02, *angles], 1 / 64, Thresholds(settle_time=50 / 64), stays)
            for angles, stays in (
                (SHUT, True),
                ([-0.029] * 50, True),
                (SHUT[1:], True),  # a row stands until the next would come
                (SHUT[2:], False),  # the recording ends before the settle time
                ([*SHUT[1:], 0.03], False),
                ([*SHUT, 0.9], True),  # opened after the settle time
                ([*SHUT[:20], -0.04, *SHUT[:40]], False),
                ([0.04, *SHUT, *SHUT[:10]], False),
            )
        ),
        ([], 1 / 64, Thresholds(), False),
        ([0.0] * 9, 1 / 8, Thresholds(largest_gap=0.3), True),  # the last stands until 1.125 s
        ([0.0] * 9, 1 / 8, Thresholds(), False),  # who knows what the last gap hides
        ([0.0] * 3, 10.0, Thresholds(), False),  # unseen for the settle time
    ],
)
def test_a_door_counts_as_locked_only_if_seen_closed_for_the_settle_time(
    angles: list[float], interval: float, limits: Thresholds, stays: bool
) -> None:
    time = np.arange(len(angles), dtype=np.float64) * interval
    joint = joint_state(time, np.array(angles), PROTOCOL, limits)
    assert door_stays_closed(joint, interval, limits) is stays
