"""EUROBENCH's words for a run's set-up, its file names and braking tables (sections 3 and 10)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, repeat

from scoring.protocol import GRAM_FORCE, BenchmarkType, Condition, ScoringError, Side, StartPose

CONDITION_KEYS = ("benchmark_type", "door_opening_side", "robot_approach_side")


def series_prefix(subject: int, condition_number: int) -> str:
    return f"subject_{subject:03d}_cond_{condition_number:03d}_run_"


@dataclass(frozen=True, slots=True)
class RunInfo:
    """Everything set for a run; `start_time` in s since the epoch, `timeout` in s.

    Attributes:
        rosbag_path: relative to the folder.
        settings: whatever else was set, in plain YAML types.
        set_up_as: subject, condition and run in the file names, if these were corrected later.
    """

    subject: int
    team: str
    run_number: int
    condition: Condition
    start_time: float
    start_pose: StartPose | None
    timeout: float
    ruleset: str
    rosbag_path: str
    settings: Mapping[str, object] = field(default_factory=dict)
    set_up_as: tuple[int, int, int] | None = None

    @property
    def filed_as(self) -> tuple[int, int, int]:
        """Subject, condition number and run number in the run's file names."""
        return self.set_up_as or (self.subject, self.condition.number, self.run_number)

    @property
    def prefix(self) -> str:
        """The beginning of the names of the run's files, `subject_SSS_cond_CCC_run_RRR`."""
        subject, condition_number, run_number = self.filed_as
        return f"{series_prefix(subject, condition_number)}{run_number:03d}"

    def mapping(self) -> dict[str, object]:
        """The content of `run_info_<prefix>.yaml`: EUROBENCH's keys and ours."""
        kind, pose = self.condition.benchmark_type, self.start_pose
        return {
            "start_time": float(self.start_time),
            "robot_name": str(self.subject),
            "run_number": self.run_number,
            **condition_mapping(self.condition),
            "condition_number": self.condition.number,
            "door_controller_mode": door_controller_mode(kind),
            **({"set_up_as": self.prefix} if self.set_up_as else {}),
            "rosbag_path": self.rosbag_path,
            "team": self.team,
            "start_pose": None if pose is None else {"x": pose.x, "y": pose.y, "yaw": pose.yaw},
            "timeout": float(self.timeout),
            "ruleset": str(self.ruleset),
            "settings": dict(self.settings),
            "LUTcw": list(braking_table(kind, Side.CW)),
            "LUTccw": list(braking_table(kind, Side.CCW)),
        }


def condition_mapping(condition: Condition) -> dict[str, object]:
    """The content of `condition_N.yaml`."""
    sides = (condition.opening_side, condition.starting_side)
    values = (condition.benchmark_type.value, *(side.value.upper() for side in sides))
    return dict(zip(CONDITION_KEYS, values, strict=True))


def condition_from(mapping: Mapping[str, object], name: str) -> Condition:
    """Raise `ScoringError` if a key is missing or its value does not exist."""
    values = (mapping.get(key) for key in CONDITION_KEYS)
    kind, opening, starting = (value if isinstance(value, str) else "" for value in values)
    if kind not in set(BenchmarkType):
        raise ScoringError(
            f"{name}: {CONDITION_KEYS[0]} {kind[:40]!r} does not exist: "
            f"use {', '.join(BenchmarkType)}"
        )
    for key, side in zip(CONDITION_KEYS[1:], (opening, starting), strict=True):
        if side.lower() not in set(Side):
            raise ScoringError(f"{name}: {key} {side[:40]!r} is no side: use CW or CCW")
    return Condition(BenchmarkType(kind), Side(opening.lower()), Side(starting.lower()))


_RUN_FILE = re.compile(
    r"(subject_([0-9]{1,9})_cond_([0-9]{1,9})_run_([0-9]{1,9}))_(event|jointState|wrench)\.csv"
)


def run_prefixes(names: Iterable[str]) -> list[str]:
    """The prefixes `subject_SSS_cond_CCC_run_RRR` of file names, in order, each once."""
    return sorted({match[1] for name in names if (match := _RUN_FILE.fullmatch(name))})


def numbers_of(prefix: str) -> tuple[int, int, int]:
    """Return subject, condition and run number.

    ScoringError for a text that is no prefix.
    """
    match = _RUN_FILE.fullmatch(f"{prefix}_event.csv")
    if match is None:
        raise ScoringError(f"{prefix!r} names no run: use subject_SSS_cond_CCC_run_RRR")
    return int(match[2]), int(match[3]), int(match[4])


_CW_RUNS: dict[BenchmarkType, tuple[tuple[int, int], ...]] = {
    BenchmarkType.NO_FORCE: ((0, 181),),
    BenchmarkType.CONSTANT_FORCE: ((4000, 181),),
    BenchmarkType.SUDDEN_FORCE: ((0, 112), (4000, 69)),
    BenchmarkType.SUDDEN_RAMP: (
        (0, 112),
        (2000, 2),
        (3000, 2),
        (5000, 2),
        (8000, 3),
        (12000, 3),
        (20000, 5),
        (0, 52),
    ),
    BenchmarkType.WIND_RAMP: (
        (0, 7),
        (1000, 11),
        (2000, 15),
        (3000, 20),
        (4000, 77),
        (3000, 20),
        (2000, 15),
        (1000, 11),
        (0, 5),
    ),
}


def braking_table(benchmark_type: BenchmarkType, side: Side) -> tuple[int, ...]:
    """181 braking forces, gram-force, for -90..+90 deg in steps of 1 deg.

    CCW is CW reversed.
    """
    runs = _CW_RUNS[benchmark_type]
    table = tuple(chain.from_iterable(repeat(force, degrees) for force, degrees in runs))
    return table if side is Side.CW else table[::-1]


def largest_brake(benchmark_type: BenchmarkType) -> float:
    """The largest force of a braking table, N."""
    return GRAM_FORCE * max(braking_table(benchmark_type, Side.CW))


def door_controller_mode(benchmark_type: BenchmarkType) -> int:
    """0 = brake off, 1 = brake by table."""
    return 0 if benchmark_type is BenchmarkType.NO_FORCE else 1
