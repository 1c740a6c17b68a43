"""EUROBENCH's files and rules: csv in and out, YAML out, the values of 2020 (sections 9 and 10)."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy import signal

from scoring.edges import Edge
from scoring.indicator_table import IndicatorName as Name
from scoring.indicator_table import RulesetName
from scoring.indicators import (
    NEVER_CLOSED,
    NEVER_THROUGH,
    NEVER_TOUCHED,
    compute_indicators,
    duration,
    first_time,
    last_time,
)
from scoring.kinematics import (
    LOW_PASS_FREQUENCY,
    WINDOW_TIME,
    Array,
    JointState,
    butterworth,
    derivatives,
    jerk,
    mean_interval,
    or_nan,
    too_fast,
)
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
from scoring.run_info import (
    CONDITION_KEYS,
    RunInfo,
    condition_from,
    condition_mapping,
    numbers_of,
)
from scoring.series import Flags, Series, Signals, passage_series

LARGEST_FILE = 16 * 1024 * 1024
"""Larger files are refused, bytes: a run of 300 s at 100 Hz takes 3 MB."""

PRESENT_HEIGHT = 1.00
"""An obstacle higher than this is a robot, m."""

_SAVGOL = 11
_MOTION = ("time", "position", "velocity", "acceleration")


@dataclass(frozen=True, slots=True, eq=False)
class EurobenchRun:
    """One run's published files; `run_info` is empty without its file.

    `rows` are the whole recording's, as the rules of 2020 filter it.
    """

    condition: Condition
    events: tuple[Event, ...]
    rows: Rows
    run_info: Mapping[str, object]


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


def values_2020(events: Sequence[Event], rows: Rows, condition: Condition) -> dict[Name, Indicator]:
    """Compute the indicators as the published scripts do.

    `rows` are those of `rows_2020`.
    """
    values = compute_indicators(events, frozenset(), rows, condition)
    start = first_time(events, EventName.BENCHMARK_START)
    arrived = first_time(events, EventName.approaches(condition.starting_side))
    touched = first_time(events, EventName.HANDLE_IS_TOUCHED)
    through = last_time(events, EventName.moves_to(condition.destination_side))
    closed = last_time(events, EventName.DOOR_CLOSES)

    ended = None if closed is None or through is None else max(closed, through)
    never = NEVER_THROUGH if through is None else NEVER_CLOSED
    values[Name.EXECUTION_TIME] = duration(
        Name.EXECUTION_TIME, start, ended, "no benchmark start", never
    )
    values[Name.PASSAGE_TIME] = duration(
        Name.PASSAGE_TIME, touched, closed, NEVER_TOUCHED, NEVER_CLOSED
    )
    if arrived is not None and through is not None and through <= arrived:
        values[Name.DOOR_OCCUPATION_TIME] = Indicator.missing(
            Name.DOOR_OCCUPATION_TIME, "robot left no later than it approached"
        )
    missing = [arrived, touched, through, closed].count(None)
    values[Name.CAPABILITY_LEVEL] = Indicator.of(Name.CAPABILITY_LEVEL, 4 - missing)
    return values


def events_2020(recording: Recording, condition: Condition, thresholds: Thresholds) -> list[Event]:
    """Return the events of a recording by the rules of 2020, in order.

    Robots are higher than a metre, a masked sensor is absent, readings beyond the sensors' ranges
    count, and the passage sensors do so to the end of the recording.
    """
    door = _readings(recording.signals[Signal.DOOR])
    handle = _readings(recording.signals[Signal.HANDLE])

    is_touched = np.abs(handle.value - recording.handle_zero) > thresholds.touch_force
    touches = _edges(handle.time, is_touched, recording.start)
    events = [Event(recording.start, EventName.BENCHMARK_START)]
    events += [Event(edge.time, EventName.HANDLE_IS_TOUCHED) for edge in touches[:1]]

    is_open = np.abs(door.value) >= thresholds.closed_angle
    for edge in _edges(door.time, is_open, recording.start):
        name = EventName.DOOR_OPENS if edge.value else EventName.DOOR_CLOSES
        events.append(Event(edge.time, name))

    events += recording.latch_events
    events = [event for event in events if event.time <= recording.stop]
    events += _passage(recording, door, condition, thresholds)
    events.append(Event(recording.stop, EventName.BENCHMARK_STOP))
    return sorted(events, key=lambda event: event.time)


def whole_rows_2020(signals: Signals, thresholds: Thresholds) -> Rows:
    """Filter a whole recording by the rules of 2020, which do not cut it and know no gaps."""
    door = _readings(signals[Signal.DOOR])
    handle = _readings(signals[Signal.HANDLE])
    interval = mean_interval(door.time) or math.inf  # of one angle there is none
    average = 1 + 2 * math.ceil(WINDOW_TIME / interval / 2)
    velocity, acceleration = derivatives(door.value, interval, average, _SAVGOL)
    joint = JointState(door.time, door.value, velocity, acceleration)
    return rows_2020(joint, handle.time, handle.value, thresholds)


def rows_2020(joint: JointState, force_time: Array, force: Array, thresholds: Thresholds) -> Rows:
    """Filter the acceleration one way, and derive the jerk of the open rows alone."""
    low_passed, problem = _low_pass(joint)
    is_open = np.abs(joint.position) > thresholds.closed_angle
    open_rows = JointState(
        joint.time[is_open],
        joint.position[is_open],
        joint.velocity[is_open],
        joint.acceleration[is_open],
    )
    jerk_time, jerks = jerk(open_rows, replace(thresholds, largest_gap=math.inf))
    return Rows(
        joint_state=joint,
        low_passed=low_passed,
        jerk_time=jerk_time,
        jerk=jerks,
        force_time=force_time,
        force=force,
        problem=problem,
        thresholds=thresholds,
    )


def _low_pass(joint: JointState) -> tuple[Array, str | None]:
    """Return the low-passed acceleration, rad/s^2, shape (n,), or why no row has one."""
    filtered = np.full(joint.time.size, np.nan)
    is_defined = np.isfinite(joint.acceleration)
    interval = mean_interval(joint.time[is_defined])
    if interval is None or 2 * LOW_PASS_FREQUENCY * interval >= 1:
        return filtered, "too few accelerations for the low-pass filter"
    if (problem := too_fast(interval)) is not None:
        return filtered, problem

    b, a = butterworth(interval)
    with np.errstate(over="ignore", invalid="ignore"):
        filtered[is_defined] = signal.lfilter(b, a, joint.acceleration[is_defined])
    return or_nan(filtered), None


def _passage(
    recording: Recording, door: Series, condition: Condition, thresholds: Thresholds
) -> list[Event]:
    """Return the first arrival under a passage sensor, and the last departure."""
    by_height = replace(thresholds, present_height=PRESENT_HEIGHT)
    seen = passage_series(recording.signals, door, by_height)
    is_present = (seen.present == 1) & ~seen.masked
    is_known = seen.masked | ~np.isnan(seen.distance)
    arrivals, departures = [], []
    for place, sensor in enumerate(PASSAGE_SENSORS):
        rows = (seen.sensor == place) & is_known
        for edge in _edges(seen.time[rows], is_present[rows], recording.start):
            if edge.value:
                arrivals.append(Event(edge.time, EventName.approaches(sensor.side)))
            else:
                departures.append(Event(edge.time, EventName.moves_to(sensor.side)))

    reached = EventName.moves_to(condition.destination_side)
    arrivals.sort(key=lambda event: event.time)
    departures.sort(key=lambda event: (event.time, event.name is reached))
    return [*arrivals[:1], *departures[-1:]]


def _readings(series: Series) -> Series:
    """Keep what is a number: these rules take any for a reading."""
    return series.where(np.isfinite(series.value))


def _edges(time: Array, is_up: Flags, start: float) -> list[Edge]:
    """Return the changes of a state from the start on.

    One that is up at the start rises there.
    """
    first = max(0, int(np.searchsorted(time, start)) - 1)  # the last reading before the start
    time, is_up = np.maximum(time[first:], start), is_up[first:]
    changes = np.flatnonzero(np.diff(is_up, prepend=False))
    return [Edge(float(time[row]), bool(is_up[row])) for row in changes]


def evaluate_published(run: EurobenchRun) -> tuple[Result, Rows]:
    """Score a published run by the rules of 2020.

    Events and acceleration are the files' own.

    They tell no steps: a run with an execution time is completed. Without a `benchmark_stop` in
    the files it stops when that time ends.
    """
    start = min(event.time for event in run.events if event.name is EventName.BENCHMARK_START)
    stop = last_time(run.events, EventName.BENCHMARK_STOP)
    values = values_2020(run.events, run.rows, run.condition)
    execution_time = values[Name.EXECUTION_TIME].value
    ending = Ending(Outcome.INTERRUPTED, "neither an end nor a stop is recorded", None)
    if execution_time is not None:
        stop = start + execution_time if stop is None else stop
        ending = Ending(Outcome.COMPLETED, "robot through, door closed", stop)
    elif stop is not None:
        ending = Ending(Outcome.TIMEOUT, "no execution time at the stop", stop)

    remarks = ["scored from published files: events and acceleration as they stand there, no steps"]
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
        indicators=values,
        lock_detection=LockDetection.SETTLE,  # decides nothing here: there are no steps
        steps=(),
        events=tuple(EventRecord.of(event, start) for event in run.events),
        quality=Quality(remarks=tuple(remarks)),
    )
    return result, run.rows


# --- files in


def read_run(folder: Path, prefix: str) -> EurobenchRun:
    """Read one run of a folder, by its prefix `subject_SSS_cond_CCC_run_RRR`.

    Raises:
        ScoringError: it cannot be read; the message names the file, and the row and the column.
    """
    _, number, _ = numbers_of(prefix)
    condition = Condition.from_number(number)
    condition_path = folder / f"condition_{number}.yaml"
    if condition_path.exists():
        condition = condition_from(_read_mapping(condition_path), str(condition_path))

    info_path = folder / f"run_info_{prefix}.yaml"
    info = _read_mapping(info_path) if info_path.exists() else {}
    if CONDITION_KEYS[0] in info:  # a run that was corrected keeps the names of its files
        condition = condition_from(info, str(info_path))
    return _read_run(
        folder / f"{prefix}_event.csv",
        folder / f"{prefix}_wrench.csv",
        folder / f"{prefix}_jointState.csv",
        condition,
        info,
    )


def read_files(event: Path, wrench: Path, joint_state: Path, condition: Path) -> EurobenchRun:
    """Read one run of its event, wrench, jointState and condition file.

    Raises:
        ScoringError: it cannot be read; the message names the file, and the row and the column.
    """
    described = condition_from(_read_mapping(condition), str(condition))
    return _read_run(event, wrench, joint_state, described, {})


def _read_run(
    event: Path,
    wrench: Path,
    joint_state: Path,
    condition: Condition,
    run_info: Mapping[str, object],
) -> EurobenchRun:
    events = _read_events(event)
    forces = _read_table(wrench, "time", "force_x")
    motion = _read_table(joint_state, *_MOTION)
    joint = JointState(
        motion["time"].to_numpy(),
        motion["position"].to_numpy(),
        motion["velocity"].to_numpy(),
        motion["acceleration"].to_numpy(),
    )
    rows = rows_2020(joint, forces["time"].to_numpy(), forces["force_x"].to_numpy(), Thresholds())
    return EurobenchRun(condition, events, rows, run_info)


def _read_events(path: Path) -> tuple[Event, ...]:
    table = _read_table(path, "time", "event")
    names = table["event"].str.strip()
    unknown = ~names.isin([*EventName])
    if unknown.any():
        where = f"{path}, row {unknown.argmax() + 1} below the header, column event"
        name = str(names[unknown].iloc[0])[:60]
        raise ScoringError(f"{where}: {name!r} is no event of the protocol: drop it")
    starts = table["time"][names == EventName.BENCHMARK_START]
    if starts.size != 1:
        raise ScoringError(f"{path}: benchmark_start is there {starts.size} times: give it once")
    if (table["time"] < starts.iloc[0]).any():
        raise ScoringError(f"{path}: something comes before benchmark_start: correct its time")
    return tuple(map(Event, table["time"], map(EventName, names)))


def _read_table(path: Path, *columns: str) -> pd.DataFrame:
    """Read some columns of a table: numbers, but for `event`.

    Cells stand between commas, semicolons or tabs; with the latter two they may have a decimal
    comma. An empty cell is NaN.
    """
    text = _read_text(path)
    header = text.lstrip().partition("\n")[0]
    separator = next((mark for mark in ";\t" if mark in header), ",")
    if separator != ",":
        text = text.replace(",", ".")
    try:
        table = pd.read_csv(io.StringIO(text), sep=separator, dtype=str, skipinitialspace=True)
    except ValueError as error:
        words = " ".join(str(error).split())
        raise ScoringError(f"{path}: is no csv ({words}): correct it") from None
    if not isinstance(table.index, pd.RangeIndex):  # pandas takes what has no name for an index
        raise ScoringError(
            f"{path}: the rows have more cells than the header: correct it; with a decimal comma "
            "write ; between cells"
        )

    table.columns = table.columns.str.strip()
    missing = [column for column in columns if column not in table]
    if missing:
        raise ScoringError(f"{path}: column {missing[0]} is missing: give {','.join(columns)}")
    for column in columns:
        if column != "event":
            table[column] = _numbers(path, table[column])
    steps = np.diff(table["time"])
    backwards = steps < 0 if "event" in columns else steps <= 0
    if backwards.any():
        raise ScoringError(
            f"{path}, row {backwards.argmax() + 2} below the header, column time: does not come "
            "after the row before: sort the rows, drop repeated times"
        )
    return table


def _numbers(path: Path, cells: pd.Series[str]) -> Array:
    numbers = pd.to_numeric(cells, errors="coerce")
    unusable = ~np.isfinite(numbers) & (cells.notna() | (cells.name in ("time", "position")))
    if unusable.any():
        where = f"{path}, row {unusable.argmax() + 1} below the header, column {cells.name}"
        cell = str(cells[unusable].iloc[0])[:40]
        raise ScoringError(f"{where}: {cell!r} is no finite number: correct it")
    # read by Python: older pandas err by one unit in the last place
    return np.array([float(cell) for cell in cells], dtype=np.float64)


def _read_mapping(path: Path) -> dict[str, object]:
    text = _read_text(path)
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, AttributeError, LookupError, RecursionError, TypeError, ValueError):
        raise ScoringError(f"{path}: is no YAML: correct it") from None
    if not isinstance(content, dict):
        raise ScoringError(f"{path}: holds no `key: value` lines: correct it")
    return content


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ScoringError(f"{path}: cannot be read ({error.strerror})") from None
    if len(content) > LARGEST_FILE:
        raise ScoringError(f"{path}: is larger than {LARGEST_FILE >> 20} MiB: cut it")
    return content.decode("utf-8-sig", errors="replace")  # what is read is ASCII


# --- files out


def run_files(
    info: RunInfo,
    events: Sequence[Event],
    rows: Rows,
    indicators: Mapping[Name, Indicator],
) -> dict[str, bytes]:
    """Return EUROBENCH's files of a run by name.

    `rows` are cut as the ruleset wants it.
    """
    event_columns = {
        "time": [event.time for event in events],
        "event": [event.name.value for event in events],
    }
    motion = {column: getattr(rows.joint_state, column) for column in _MOTION}
    wrench = {"time": rows.force_time, "force_x": rows.force}
    files = {
        f"run_info_{info.prefix}.yaml": _yaml(info.mapping()),
        f"condition_{info.filed_as[1]}.yaml": _yaml(condition_mapping(info.condition)),
        f"{info.prefix}_event.csv": _csv(event_columns),
        f"{info.prefix}_jointState.csv": _csv(motion),
        f"{info.prefix}_wrench.csv": _csv(wrench),
    }
    return files | indicator_files(indicators, RulesetName(info.ruleset))


def indicator_files(indicators: Mapping[Name, Indicator], rules: RulesetName) -> dict[str, bytes]:
    """Return a YAML file for each indicator.

    A missing value is null, in 2020 the text TIMEOUT.
    """
    missing = "TIMEOUT" if rules is RulesetName.EUROBENCH_2020 else None
    files = {}
    for name, indicator in indicators.items():
        value = missing if indicator.value is None else indicator.value
        files[f"{name}.yaml"] = _yaml({"type": "scalar", "value": value})
    return files


def _csv(columns: Mapping[str, Any]) -> bytes:
    # the shortest digits that read back as the same float64; NaN is an empty cell
    return pd.DataFrame(columns).to_csv(index=False, lineterminator="\n").encode()


def _yaml(content: Mapping[str, object]) -> bytes:
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True).encode()
