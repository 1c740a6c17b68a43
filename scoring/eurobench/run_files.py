"""EUROBENCH's files of a run (protocol section 10).

The only module of `scoring` that opens data files.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from scoring.eurobench.csv_table import CsvTable, parse_table
from scoring.eurobench.run_info import (
    CONDITION_KEYS,
    SET_UP_AS,
    RunInfo,
    condition_from,
    condition_mapping,
    numbers_of,
)
from scoring.indicator_table import IndicatorName
from scoring.kinematics import JointState, or_nan
from scoring.protocol import Condition, Event, EventName, ScoringError, Thresholds
from scoring.result import Indicator
from scoring.rulesets import Ruleset, ruleset

LARGEST_TABLE = 16 * 1024 * 1024
"""Larger CSV files are refused, bytes: a run of 300 s at 100 Hz takes 3 MB."""

LARGEST_YAML = 1024 * 1024
"""Larger YAML files are refused, bytes: braking tables take 2 kB."""


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """Force on the handle, N, as recorded, one row a sample, times in s; NaN = no reading."""

    time: NDArray[np.float64]
    force: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class EurobenchRun:
    """The pre-processed data in one run's files; `run_info` is empty without its file."""

    condition: Condition
    events: tuple[Event, ...]
    joint_state: JointState
    wrench: Wrench
    run_info: Mapping[str, object] = field(default_factory=dict)

    @property
    def start_time(self) -> float:
        """Time of `benchmark_start`, s since the epoch."""
        return next(e.time for e in self.events if e.name is EventName.BENCHMARK_START)


_TOLD_BY = ("event", "force_x", "position")
"""The columns that distinguish the csv files of `read_files`, in the order of these."""


def read_run(folder: Path, prefix: str) -> EurobenchRun:
    """One run of a folder, by its prefix `subject_SSS_cond_CCC_run_RRR`.

    Raises:
        ScoringError: it cannot be read; the message names file, line and column.
    """
    numbers = numbers_of(prefix)
    if numbers is None:
        raise ScoringError(f"{prefix!r} names no run: use subject_SSS_cond_CCC_run_RRR")
    _, condition_number, _ = numbers
    info_path = folder / f"run_info_{prefix}.yaml"
    info = _read_mapping(info_path) if _exists(info_path) else {}
    corrected = info.get(SET_UP_AS) == prefix
    return EurobenchRun(
        condition=(
            condition_from(info, str(info_path))
            if corrected
            else _condition(folder, condition_number, info_path, info)
        ),
        events=_events(folder / f"{prefix}_event.csv"),
        joint_state=_joint_state(folder / f"{prefix}_jointState.csv"),
        wrench=_wrench(folder / f"{prefix}_wrench.csv"),
        run_info=info,
    )


def read_files(paths: Sequence[Path]) -> EurobenchRun:
    """One run of event, wrench, jointState and condition file, by headers or by their order.

    Raises:
        ScoringError: it cannot be read; the message names file, line and column.
    """
    kinds = [_kind(path) for path in paths]
    if sorted(kinds) == list(range(len(paths))):
        paths = [paths[kinds.index(kind)] for kind in range(len(paths))]
    event, wrench, joint, condition = paths
    return EurobenchRun(
        condition=condition_from(_read_mapping(condition), str(condition)),
        events=_events(event),
        joint_state=_joint_state(joint),
        wrench=_wrench(wrench),
    )


def _kind(path: Path) -> int:
    lines = _read_text(path, LARGEST_TABLE).split("\n")
    first = next((line for line in lines if line.strip()), "")
    header = {cell.strip(' "\r') for cell in re.split("[,;]", first)}
    kinds = (kind for kind, column in enumerate(_TOLD_BY) if column in header)
    return next(kinds, len(_TOLD_BY))


def door_stays_closed(joint: JointState, since: float, thresholds: Thresholds) -> bool:
    """Whether the door stays closed for the settle time after `since`, the last `door_closes`, s.

    Judges step 6 of a run without `benchmark_stop` (section 7). A row counts until the next one
    would come: files cut at the stop plus the settle time end less than an interval earlier.
    """
    until = since + thresholds.settle_time
    if recorded_until(joint, thresholds) < until:
        return False
    rows = (joint.time > since) & (joint.time <= until)
    return bool(rows.any() and (np.abs(joint.position[rows]) < thresholds.closed_angle).all())


def recorded_until(joint: JointState, thresholds: Thresholds) -> float:
    """Until when the panel's motion is known, s since the epoch; -inf without rows."""
    if not joint.time.size:
        return -math.inf
    intervals = np.diff(joint.time)
    regular = intervals[intervals <= thresholds.largest_gap]
    return float(joint.time[-1] + (np.max(regular) if regular.size else 0.0))


def run_files(
    info: RunInfo,
    events: Sequence[Event],
    joint: JointState,
    wrench: Wrench,
    indicators: Mapping[IndicatorName, Indicator],
) -> dict[str, bytes]:
    """EUROBENCH's files of a run by name; `joint` and `wrench` are cut as the ruleset wants it.

    Raises:
        ScoringError: a setting has no form in YAML.
    """
    prefix = info.prefix
    files = {
        f"run_info_{prefix}.yaml": _yaml(info.mapping()),
        f"condition_{info.filed_as[1]}.yaml": _yaml(condition_mapping(info.condition)),
        f"{prefix}_event.csv": _csv(
            {
                "time": [event.time for event in events],
                "event": [event.name.value for event in events],
            }
        ),
        f"{prefix}_jointState.csv": _csv(
            {
                "time": joint.time,
                "position": or_nan(joint.position),
                "velocity": or_nan(joint.velocity),
                "acceleration": or_nan(joint.acceleration),
            }
        ),
        f"{prefix}_wrench.csv": _csv({"time": wrench.time, "force_x": or_nan(wrench.force)}),
    }
    encoded = {name: text.encode() for name, text in files.items()}
    return encoded | indicator_files(indicators, ruleset(info.ruleset))


def indicator_files(
    indicators: Mapping[IndicatorName, Indicator], rules: Ruleset
) -> dict[str, bytes]:
    files = {}
    for name, indicator in indicators.items():
        value = rules.missing_value if indicator.value is None else indicator.value
        files[f"{name.value}.yaml"] = _yaml({"type": "scalar", "value": value}).encode()
    return files


def _table(path: Path, *columns: str) -> CsvTable:
    return parse_table(str(path), _read_text(path, LARGEST_TABLE), columns)


def _events(path: Path) -> tuple[Event, ...]:
    table = _table(path, "time", "event")
    times = table.times(repeats=True).tolist()
    events = []
    for row, (time, name) in enumerate(zip(times, table.cells["event"], strict=True)):
        if name not in set(EventName):
            raise table.error(row, "event", f"{name[:60]!r} is no event of the protocol: drop it")
        events.append(Event(time, EventName(name)))
    for once, fewest in ((EventName.BENCHMARK_START, 1), (EventName.BENCHMARK_STOP, 0)):
        count = sum(event.name is once for event in events)
        if not fewest <= count <= 1:
            raise ScoringError(
                f"{path}, column event: {once.value} is there {count} times: give it once"
            )
    return tuple(events)


def _joint_state(path: Path) -> JointState:
    table = _table(path, "time", "position", "velocity", "acceleration")
    acceleration = table.numbers("acceleration", optional=True)
    reason = None
    if not np.isfinite(acceleration).any():
        reason = "no acceleration in the file" if acceleration.size else "no door angle recorded"
    return JointState(
        table.times(),
        table.numbers("position"),
        table.numbers("velocity", optional=True),
        acceleration,
        reason,
    )


def _wrench(path: Path) -> Wrench:
    table = _table(path, "time", "force_x")
    return Wrench(table.times(), table.numbers("force_x", optional=True))


def _condition(folder: Path, number: int, info_path: Path, info: Mapping[str, object]) -> Condition:
    """The condition on which file name, condition file and run info agree."""
    try:
        condition = Condition.from_number(number)
    except ScoringError as error:
        raise ScoringError(f"{folder}: files are named after a wrong number: {error}") from None
    described: dict[Path, Mapping[str, object]] = {}
    condition_path = folder / f"condition_{number}.yaml"
    if _exists(condition_path):
        described[condition_path] = _read_mapping(condition_path)
    if any(key in info for key in CONDITION_KEYS):
        described[info_path] = info
    for path, mapping in described.items():
        stated = condition_from(mapping, str(path))
        if stated != condition:
            raise ScoringError(
                f"{path}: describes condition {stated.number}, but the run's files are named after "
                f"condition {number}: correct one of them"
            )
    return condition


_YAML_PROBLEMS = (
    yaml.YAMLError,
    AttributeError,  # a tag that does not fit its value
    LookupError,
    RecursionError,  # brackets without end
    TypeError,
    ValueError,  # a date that does not exist
)


def _read_mapping(path: Path) -> dict[str, object]:
    try:
        content = yaml.safe_load(_read_text(path, LARGEST_YAML))
    except _YAML_PROBLEMS as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise ScoringError(f"{path}{line}: is no YAML: correct it") from None
    if not isinstance(content, dict):
        raise ScoringError(f"{path}: holds no `key: value` lines: correct it")
    return content


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a folder that may be listed but not entered; reading the data says so
        return False


def _read_text(path: Path, largest: int) -> str:
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe must not block
        with os.fdopen(number, "rb") as file:
            plain = stat.S_ISREG(os.fstat(number).st_mode)
            content = file.read(largest + 1) if plain else None
        if content is None:
            raise _missing(path)
        if len(content) > largest:
            raise ScoringError(f"{path}: is larger than {largest >> 20} MiB: cut it to the run")
        return content.decode("utf-8-sig")
    except (FileNotFoundError, IsADirectoryError):
        raise _missing(path) from None
    except OSError as error:
        raise ScoringError(
            f"{path}: cannot be read ({error.strerror}): check its permissions"
        ) from None
    except UnicodeDecodeError:
        raise ScoringError(f"{path}: is no UTF-8 text: write it again as text") from None


def _missing(path: Path) -> ScoringError:
    return ScoringError(f"{path}: is missing: put the run's file there")


def _yaml(content: Mapping[str, object]) -> str:
    try:
        return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True)
    except yaml.YAMLError:
        raise ScoringError("run info: a setting has no YAML form: use plain types") from None


def _csv(columns: Mapping[str, Sequence[object] | NDArray[np.float64]]) -> str:
    """The shortest digits that read back as the same float64; NaN as an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*map(_cells, columns.values()), strict=True))
    return text.getvalue()


def _cells(values: Sequence[object] | NDArray[np.float64]) -> Sequence[object]:
    if isinstance(values, np.ndarray):
        return ["" if math.isnan(value) else value for value in values.tolist()]
    return values
