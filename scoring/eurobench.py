"""EUROBENCH's files and rules: csv in and out, YAML out, the values of 2020 (sections 9 and 10)."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy import signal

from scoring.edges import Edge
from scoring.indicator_table import IndicatorName
from scoring.indicators import (
    NEVER_CLOSED,
    NEVER_THROUGH,
    NEVER_TOUCHED,
    door_occupation_time,
    duration,
    first_time,
    last_time,
    roughness_of_door_actuation,
    smoothness_of_door_actuation,
    time_to_handle,
    unsafety_of_door_operation,
)
from scoring.kinematics import (
    WINDOW_TIME,
    Array,
    JointState,
    butterworth,
    derivatives,
    mean_interval,
    or_nan,
    too_fast,
)
from scoring.procedure import Evidence, follow_procedure
from scoring.protocol import (
    PASSAGE_SENSORS,
    Condition,
    Event,
    EventName,
    LockDetection,
    Outcome,
    ScoringError,
    Signal,
    Thresholds,
)
from scoring.quality import Quality
from scoring.result import Ending, EventRecord, Indicator, Result
from scoring.rows import Rows
from scoring.rulesets import RulesetName
from scoring.run_info import (
    CONDITION_KEYS,
    SET_UP_AS,
    RunInfo,
    condition_from,
    condition_mapping,
    numbers_of,
)
from scoring.series import Flags, Signals, is_masked, last_angles

LARGEST_FILE = 16 * 1024 * 1024
"""Larger files are refused, bytes: a run of 300 s at 100 Hz takes 3 MB."""

PRESENT_HEIGHT = 1.00
"""An obstacle higher than this is a robot, m."""

_ANY = float(np.finfo(float).max)
"""These rules take any finite number for a reading."""

_SAVGOL = 11
_COLUMNS = {
    "event": ("time", "event"),
    "wrench": ("time", "force_x"),
    "jointState": ("time", "position", "velocity", "acceleration"),
}
"""Of each csv file, by its name."""


@dataclass(frozen=True, slots=True, eq=False)
class EurobenchRun:
    """The pre-processed data in one run's files; `run_info` is empty without its file.

    `force_time` is in s, `force` in N, NaN = no reading; both of shape (k,).
    """

    condition: Condition
    events: tuple[Event, ...]
    joint_state: JointState
    force_time: Array
    force: Array
    run_info: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A run as recorded; times in s since the epoch, the handle's zero in N.

    `latch_events` are the protocol's.
    """

    signals: Signals
    start: float
    stop: float
    handle_zero: float
    latch_events: Sequence[Event]


# --- the values of 2020


def values_2020(
    events: Sequence[Event], rows: Rows, condition: Condition
) -> dict[IndicatorName, Indicator]:
    """Compute the indicators as the published scripts do; `rows` are those of `rows_2020`."""
    touched = first_time(events, EventName.HANDLE_IS_TOUCHED)
    closed = last_time(events, EventName.DOOR_CLOSES)
    through = last_time(events, EventName.moves_to(condition.destination_side))
    start = first_time(events, EventName.BENCHMARK_START)
    ended = None if closed is None or through is None else max(closed, through)
    never = NEVER_THROUGH if through is None else NEVER_CLOSED
    occupation = door_occupation_time(events, condition)
    if occupation.value is not None and occupation.value <= 0:
        why = "robot left no later than it approached"
        occupation = Indicator.missing(IndicatorName.DOOR_OCCUPATION_TIME, why)
    counted = {
        EventName.approaches(condition.starting_side),
        EventName.HANDLE_IS_TOUCHED,
        EventName.moves_to(condition.destination_side),
        EventName.DOOR_CLOSES,
    }
    level = len(counted & {event.name for event in events})
    return {
        IndicatorName.EXECUTION_TIME: duration(
            IndicatorName.EXECUTION_TIME, start, ended, "no benchmark start", never
        ),
        IndicatorName.TIME_TO_HANDLE: time_to_handle(events),
        IndicatorName.DOOR_OCCUPATION_TIME: occupation,
        IndicatorName.PASSAGE_TIME: duration(
            IndicatorName.PASSAGE_TIME, touched, closed, NEVER_TOUCHED, NEVER_CLOSED
        ),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows),
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows.force),
        IndicatorName.CAPABILITY_LEVEL: Indicator.of(IndicatorName.CAPABILITY_LEVEL, level),
    }


def joint_state_2020(time: Array, position: Array) -> JointState:
    """Derive the panel's motion as the published scripts do, which know no gaps."""
    interval = mean_interval(time)
    if interval is None or WINDOW_TIME / interval > time.size:
        nothing = np.full(time.size, np.nan)
        return JointState(time, position, nothing, nothing, "too few door angles recorded")
    average = 1 + 2 * math.ceil(WINDOW_TIME / interval / 2)
    velocity, acceleration = derivatives(position, interval, average, _SAVGOL)
    short = None if np.isfinite(acceleration).any() else "too few door angles for the filters"
    return JointState(time, position, velocity, acceleration, short)


def rows_2020(joint: JointState, force_time: Array, force: Array, thresholds: Thresholds) -> Rows:
    """Filter the acceleration of a whole recording one way, and derive the jerk of open rows."""
    low_passed = np.full(joint.time.size, np.nan)
    defined = np.isfinite(joint.acceleration)
    interval = mean_interval(joint.time[defined])
    problem = joint.reason
    if problem is None and interval is not None:
        problem = too_fast(interval) if interval < 1 / 4 else None
    if problem is None and interval is not None and interval < 1 / 4:
        b, a = butterworth(interval)
        with np.errstate(over="ignore", invalid="ignore"):
            low_passed[defined] = signal.lfilter(b, a, joint.acceleration[defined])
    elif problem is None:
        problem = "too few accelerations for the low-pass filter"
    is_open = np.abs(joint.position) > thresholds.closed_angle
    time, acceleration = joint.time[is_open], joint.acceleration[is_open]
    with np.errstate(over="ignore", invalid="ignore"):
        jerk = np.diff(acceleration) / np.diff(time)
    usable = np.isfinite(jerk)
    return Rows(
        joint_state=joint,
        low_passed=or_nan(low_passed),
        jerk_time=time[1:][usable],
        jerk=jerk[usable],
        force_time=force_time,
        force=force,
        problem=problem,
        thresholds=thresholds,
    )


def events_2020(recording: Recording, condition: Condition, thresholds: Thresholds) -> list[Event]:
    """Return the events of a recording by the rules of 2020, in order.

    Robots are higher than a metre, a masked sensor is absent, readings beyond the sensors' ranges
    count, and the passage sensors do so to the end of the recording.
    """
    events = [Event(recording.start, EventName.BENCHMARK_START)]
    events += _touch_and_door(recording, thresholds)
    events += recording.latch_events
    events = [event for event in events if event.time <= recording.stop]
    events += _passage(recording, condition, thresholds)
    events.append(Event(recording.stop, EventName.BENCHMARK_STOP))
    return sorted(events, key=lambda event: event.time)


def whole_rows_2020(signals: Signals, thresholds: Thresholds) -> Rows:
    """Filter a whole recording by the rules of 2020, which do not cut it."""
    door, handle = signals[Signal.DOOR].within(_ANY), signals[Signal.HANDLE].within(_ANY)
    joint = joint_state_2020(door.time, door.value)
    return rows_2020(joint, handle.time, handle.value, thresholds)


def _touch_and_door(recording: Recording, thresholds: Thresholds) -> Iterator[Event]:
    door = recording.signals[Signal.DOOR].within(_ANY)
    handle = recording.signals[Signal.HANDLE].within(_ANY)
    pressed = np.abs(handle.value - recording.handle_zero) > thresholds.touch_force
    for time, _ in edges(handle.time, pressed, recording.start)[:1]:
        yield Event(time, EventName.HANDLE_IS_TOUCHED)
    is_open = np.abs(door.value) >= thresholds.closed_angle
    for time, opens in edges(door.time, is_open, recording.start):
        yield Event(time, EventName.DOOR_OPENS if opens else EventName.DOOR_CLOSES)


def _passage(recording: Recording, condition: Condition, thresholds: Thresholds) -> Iterator[Event]:
    signals, door = recording.signals, recording.signals[Signal.DOOR].within(_ANY)
    rises, falls = [], []
    for sensor in PASSAGE_SENSORS:
        strip = signals[Signal.of_strip(sensor.strip)]
        distance = strip.value[:, sensor.element]
        masked = is_masked(sensor, last_angles(door, strip.time), thresholds)
        present = (thresholds.lintel_height - distance > PRESENT_HEIGHT) & ~masked
        known = masked | ~np.isnan(distance)
        changes = edges(strip.time[known], present[known], recording.start)
        reached = sensor.side is condition.destination_side
        rises += [(time, sensor.side) for time, up in changes[:1]]
        falls += [(time, reached) for time, up in changes if not up]
    if rises:
        time, side = min(rises, key=lambda rise: rise[0])
        yield Event(time, EventName.approaches(side))
    if falls:
        time, reached = max(falls)
        side = condition.destination_side if reached else condition.starting_side
        yield Event(time, EventName.moves_to(side))


def edges(time: Array, up: Flags, start: float) -> list[tuple[float, bool]]:
    """The changes of a state from the start on; one that is up at the start rises there."""
    before = int(np.searchsorted(time, start))
    state = bool(up[before - 1]) if before else False
    later = np.concatenate(([state], up[before:]))
    changes = np.flatnonzero(later[1:] != later[:-1])
    found = [(start, True)] if state else []
    return found + [(float(time[before + at]), bool(later[at + 1])) for at in changes]


def evaluate_published(
    run: EurobenchRun, thresholds: Thresholds | None = None
) -> tuple[Result, Rows]:
    """Score a published run by the rules of 2020; events and acceleration are the files' own.

    Without a `benchmark_stop` in the files, the stop is the time of step 6, if all were done.
    """
    thresholds = thresholds or Thresholds()
    rows = rows_2020(run.joint_state, run.force_time, run.force, thresholds)
    start = first_time(run.events, EventName.BENCHMARK_START)
    stop = last_time(run.events, EventName.BENCHMARK_STOP)
    assert start is not None
    procedure = follow_procedure(
        _evidence(run, start, stop),
        lock_detection=LockDetection.AUTO,
        settle_time=thresholds.settle_time,
    )
    ending = Ending(Outcome.INTERRUPTED, "steps are missing and no stop is recorded", None)
    if procedure.completed is not None:
        ending = Ending(Outcome.COMPLETED, "all six steps done", stop or procedure.completed)
    elif stop is not None:
        ending = Ending(Outcome.TIMEOUT, "steps are missing at the stop", stop)
    remarks = ["scored from published files: events and acceleration as they stand there"]
    made_by = run.run_info.get("ruleset", RulesetName.EUROBENCH_2020)
    if made_by != RulesetName.EUROBENCH_2020:
        remarks.append(f"the files were made by {made_by}: the recording gives other values")
    result = Result(
        handle_zero=0.0,
        ruleset=RulesetName.EUROBENCH_2020,
        outcome=ending.outcome,
        outcome_reason=ending.reason,
        start=start,
        stop=ending.stop,
        indicators=values_2020(run.events, rows, run.condition),
        lock_detection=procedure.lock_detection,
        steps=procedure.steps,
        events=tuple(EventRecord.of(event, start) for event in run.events),
        quality=Quality(remarks=tuple(remarks)),
    )
    return result, rows


def _evidence(run: EurobenchRun, start: float, stop: float | None) -> Evidence:
    crossed = last_time(run.events, EventName.moves_to(run.condition.destination_side))
    door = {EventName.DOOR_OPENS: True, EventName.DOOR_CLOSES: False}
    latch = {EventName.DOOR_IS_LOCKED: True, EventName.DOOR_IS_UNLOCKED: False}
    until = math.inf  # a file that names its stop was cut there
    if stop is None:
        until = float(run.joint_state.time[-1]) if run.joint_state.time.size else -math.inf
    return Evidence(
        start=start,
        stop=stop,
        touched=first_time(run.events, EventName.HANDLE_IS_TOUCHED),
        door=[Edge(e.time, door[e.name]) for e in run.events if e.name in door],
        door_seen=until,
        latch=[Edge(e.time, latch[e.name]) for e in run.events if e.name in latch],
        latch_before_start=any(e.name in latch for e in run.events),
        crossed=crossed if crossed is None or stop is None else min(crossed, stop),
    )


# --- files in


def read_run(folder: Path, prefix: str) -> EurobenchRun:
    """Read one run of a folder, by its prefix `subject_SSS_cond_CCC_run_RRR`.

    Raises:
        ScoringError: it cannot be read; the message names the file, and the line or the column.
    """
    numbers = numbers_of(prefix)
    if numbers is None:
        raise ScoringError(f"{prefix!r} names no run: use subject_SSS_cond_CCC_run_RRR")
    info_path = folder / f"run_info_{prefix}.yaml"
    info = _read_mapping(info_path) if info_path.exists() else {}
    run = _read_tables({kind: folder / f"{prefix}_{kind}.csv" for kind in _COLUMNS})
    if info.get(SET_UP_AS) == prefix:  # a corrected run keeps its name
        return replace(run, condition=condition_from(info, str(info_path)), run_info=info)
    condition = Condition.from_number(numbers[1])
    condition_path = folder / f"condition_{numbers[1]}.yaml"
    described = {info_path: info} if any(key in info for key in CONDITION_KEYS) else {}
    if condition_path.exists():
        described[condition_path] = _read_mapping(condition_path)
    for path, mapping in described.items():
        if condition_from(mapping, str(path)) != condition:
            raise ScoringError(
                f"{path}: describes another condition than {numbers[1]}, after which the run's "
                "files are named: correct one of them"
            )
    return replace(run, condition=condition, run_info=info)


def read_files(event: Path, wrench: Path, joint_state: Path, condition: Path) -> EurobenchRun:
    """Read one run of its event, wrench, jointState and condition file.

    Raises:
        ScoringError: it cannot be read; the message names the file, and the line or the column.
    """
    run = _read_tables({"event": event, "wrench": wrench, "jointState": joint_state})
    return replace(run, condition=condition_from(_read_mapping(condition), str(condition)))


def _read_tables(paths: Mapping[str, Path]) -> EurobenchRun:
    tables = {kind: _read_table(paths[kind], columns) for kind, columns in _COLUMNS.items()}
    joint, wrench = tables["jointState"], tables["wrench"]
    acceleration = joint["acceleration"].to_numpy()
    reason = None if np.isfinite(acceleration).any() else "no acceleration in the file"
    return EurobenchRun(
        condition=Condition.from_number(1),
        events=_events(paths["event"], tables["event"]),
        joint_state=JointState(
            joint["time"].to_numpy(),
            joint["position"].to_numpy(),
            joint["velocity"].to_numpy(),
            acceleration,
            reason,
        ),
        force_time=wrench["time"].to_numpy(),
        force=wrench["force_x"].to_numpy(),
    )


def _read_table(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """Read a table with a header line, any of `, ; tab` between cells, and a decimal comma."""
    text = _read_text(path)
    header = text.lstrip().partition("\n")[0]
    separator = next((mark for mark in ";\t" if mark in header), ",")
    try:
        with warnings.catch_warnings(action="error", category=pd.errors.ParserWarning):
            table = pd.read_csv(
                io.StringIO(text),
                sep=separator,
                dtype=str,
                keep_default_na=False,
                skip_blank_lines=True,
                skipinitialspace=True,
                index_col=False,
            )
    except pd.errors.ParserWarning:  # pandas would drop the last cells of each row
        raise ScoringError(
            f"{path}: the rows have more cells than the header: correct it; with a decimal comma "
            "write ; between cells"
        ) from None
    except (ValueError, pd.errors.ParserError) as error:
        raise ScoringError(f"{path}: is no csv ({error}): correct it".replace("\n", " ")) from None
    table.columns = table.columns.str.strip()
    for column in columns:
        if column not in table:
            raise ScoringError(f"{path}: column {column} is missing: give {','.join(columns)}")
        if column != "event":
            table[column] = _numbers(path, column, table[column], separator)
    _demand_order(path, table)
    return table


def _numbers(path: Path, column: str, cells: pd.Series[str], separator: str) -> list[float]:
    """Python reads the numbers: pandas' own parser errs by one unit in the last place."""
    numbers = []
    for row, cell in enumerate(cells):
        text = cell.strip() if separator == "," else cell.strip().replace(",", ".")
        try:
            number = math.inf if "_" in text else float(text or "nan")
        except ValueError:
            number = math.inf
        if math.isinf(number) or (math.isnan(number) and column in ("time", "position")):
            where = f"{path}, row {row + 1} below the header, column {column}"
            raise ScoringError(f"{where}: {cell[:40]!r} is no finite number: correct it")
        numbers.append(number)
    return numbers


def _demand_order(path: Path, table: pd.DataFrame) -> None:
    steps = np.diff(table["time"].to_numpy())
    backwards = steps < 0 if "event" in table else steps <= 0
    if backwards.any():
        row = int(np.flatnonzero(backwards)[0]) + 2
        raise ScoringError(
            f"{path}, row {row} below the header, column time: does not come after the row before: "
            "sort the rows, drop repeated times"
        )


def _events(path: Path, table: pd.DataFrame) -> tuple[Event, ...]:
    names = table["event"].str.strip()
    for row, name in enumerate(names):
        if name not in [*EventName]:
            where = f"{path}, row {row + 1} below the header, column event"
            raise ScoringError(f"{where}: {name[:60]!r} is no event of the protocol: drop it")
    starts = int((names == EventName.BENCHMARK_START).sum())
    if starts != 1:
        raise ScoringError(f"{path}: benchmark_start is there {starts} times: give it once")
    times = table["time"]
    return tuple(Event(time, EventName(name)) for time, name in zip(times, names, strict=True))


def _read_mapping(path: Path) -> dict[str, object]:
    try:
        content = yaml.safe_load(_read_text(path))
    except (yaml.YAMLError, AttributeError, LookupError, RecursionError, TypeError, ValueError):
        raise ScoringError(f"{path}: is no YAML: correct it") from None
    if not isinstance(content, dict):
        raise ScoringError(f"{path}: holds no `key: value` lines: correct it")
    return content


def _read_text(path: Path) -> str:
    if not path.is_file():  # a pipe would block
        raise ScoringError(f"{path}: is missing: put the run's file there")
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise ScoringError(f"{path}: is larger than {LARGEST_FILE >> 20} MiB: cut it")
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise ScoringError(
            f"{path}: cannot be read ({error.strerror}): check its permissions"
        ) from None
    except UnicodeDecodeError:
        raise ScoringError(f"{path}: is no UTF-8 text: write it again as text") from None
    if not text.strip():
        raise ScoringError(f"{path}: is empty: write it again")
    return text


# --- files out


def run_files(
    info: RunInfo,
    events: Sequence[Event],
    rows: Rows,
    indicators: Mapping[IndicatorName, Indicator],
) -> dict[str, bytes]:
    """EUROBENCH's files of a run by name; `rows` are cut as the ruleset wants it."""
    joint = rows.joint_state
    tables: dict[str, dict[str, Any]] = {
        "event": {"time": [e.time for e in events], "event": [e.name.value for e in events]},
        "jointState": {
            "time": joint.time,
            "position": joint.position,
            "velocity": joint.velocity,
            "acceleration": joint.acceleration,
        },
        "wrench": {"time": rows.force_time, "force_x": rows.force},
    }
    files = {
        f"run_info_{info.prefix}.yaml": _yaml(info.mapping()),
        f"condition_{info.filed_as[1]}.yaml": _yaml(condition_mapping(info.condition)),
    }
    for kind, columns in tables.items():
        # the shortest digits that read back as the same float64; NaN is an empty cell
        files[f"{info.prefix}_{kind}.csv"] = pd.DataFrame(columns).to_csv(
            index=False, lineterminator="\n"
        )
    encoded = {name: text.encode() for name, text in files.items()}
    return encoded | indicator_files(indicators, RulesetName(info.ruleset))


def indicator_files(
    indicators: Mapping[IndicatorName, Indicator], rules: RulesetName
) -> dict[str, bytes]:
    """A YAML file for each indicator; a missing value is null, in 2020 the text TIMEOUT."""
    files = {}
    for name, indicator in indicators.items():
        value: object = indicator.value
        if value is None and rules is RulesetName.EUROBENCH_2020:
            value = "TIMEOUT"
        files[f"{name.value}.yaml"] = _yaml({"type": "scalar", "value": value}).encode()
    return files


def _yaml(content: Mapping[str, object]) -> str:
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True)
