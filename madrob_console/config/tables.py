"""The tables of the settings file; every number has a range, so that none is NaN or infinite."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, force_setattr

from madrob_console.common.names import SourceKind, ThemeName, clean_name
from madrob_console.config.setting_types import SettingsTable, within, written_as
from madrob_console.messages.mapping import STRIPS, TopicMapping
from madrob_console.referee.competition_plan import (
    MOST_ATTEMPTS,
    MOST_LINES,
    PlanLine,
    PlanSource,
    Task,
)
from madrob_console.referee.topic_health import SensorLimits
from madrob_console.testbeds.ros_domain import LARGEST_DOMAIN
from scoring.indicator_table import RulesetName
from scoring.protocol import LIMITS, LockDetection, Side, Signal, StartPose, Thresholds

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from madrob_console.testbeds.simulated.geometry import DoorGeometry
    from madrob_console.testbeds.simulated.sensor_model import SensorSettings


_T = Thresholds()
_L = SensorLimits()
_NAME = r"[A-Za-z_][A-Za-z0-9_]*"
_TopicName = Annotated[
    str,
    written_as(
        rf"(?=.{{2,200}}$)(/{_NAME})+",  # DDS takes 247 characters, with the namespace
        "name of a topic: at most 200 characters, of words of letters (a to z), digits and _ "
        "that each begin with / and no digit, as in /madrob/door",
    ),
]
_TypeName = Annotated[
    str, written_as(rf"{_NAME}/msg/{_NAME}", "message type, as in std_msgs/msg/Float64")
]


class Competition(SettingsTable, frozen=True):
    """[competition]: what applies to every run. Names are cleaned."""

    name: Annotated[str, Meta(description="stands on screens and in reports")] = ""
    referee: Annotated[str, Meta(description="the referee's name, proposed at set-up")] = ""
    teams_file: Annotated[
        str, Meta(description="CSV file with lines `subject,team`, read again when it changes")
    ] = ""
    best_runs: Annotated[
        int, Meta(ge=0, le=100, description="how many of the best runs count; 0 = all of them")
    ] = 0

    def __post_init__(self) -> None:
        for key in ("name", "referee"):
            force_setattr(self, key, clean_name(getattr(self, key), key))
        if self.teams_file:
            _demand_whole_path("teams_file", self.teams_file)

    @property
    def teams_path(self) -> Path | None:
        return Path(self.teams_file).expanduser() if self.teams_file else None


_Planned = tuple[
    Annotated[int, Meta(ge=1, le=999)],
    Annotated[int, Meta(ge=1, le=20)],
    Annotated[int, Meta(ge=1, le=MOST_ATTEMPTS)],
]


class PlanSettings(SettingsTable, frozen=True):
    """[plan]: who runs which condition how often, in order; see `referee/competition_plan.py`."""

    file: Annotated[
        str,
        Meta(
            description="CSV file of `subject,condition,attempts,time` in order, read again when "
            "it changes"
        ),
    ] = ""
    runs: Annotated[
        tuple[_Planned, ...],
        Meta(
            max_length=MOST_LINES,
            description="the same without a file, read at the start: [[3, 1, 2], [4, 1, 2]]",
        ),
    ] = ()

    def __post_init__(self) -> None:
        if self.file:
            _demand_whole_path("file", self.file)
        if self.file and self.runs:
            raise ValueError("runs: the file says it, keep one of the two")

    @property
    def source(self) -> PlanSource:
        lines = (
            PlanLine(Task(subject, condition), count) for subject, condition, count in self.runs
        )
        return PlanSource(tuple(lines), Path(self.file).expanduser() if self.file else None)


class RunDefaults(SettingsTable, frozen=True):
    """[run]: what the set-up of a run proposes (protocol sections 2, 7 and 9)."""

    timeout: Annotated[float, within(1, 86400, "s from the start")] = 300.0
    countdown: Annotated[float, within(0, 600, "s before the start")] = 5.0
    lock_detection: Annotated[
        LockDetection, Meta(description="what decides step 6: auto, settle, sensor or referee")
    ] = LockDetection.AUTO
    ruleset: Annotated[
        RulesetName,
        Meta(description=f"which rules make the results: {' or '.join(RulesetName)}"),
    ] = RulesetName.PROTOCOL


class TeamSetting(SettingsTable, frozen=True):
    """One [[teams]]: the team of a subject number. The name is cleaned."""

    subject: Annotated[int, Meta(ge=1, le=999)]
    name: str

    def __post_init__(self) -> None:
        force_setattr(self, "name", clean_name(self.name, "team"))


class StartPoseSetting(SettingsTable, frozen=True):
    """One [[start_poses]]: a pose to choose, in the frame `madrob_door` (protocol section 1)."""

    name: str
    x: Annotated[float, within(-20, 20, "m, positive on the CCW side")]
    y: Annotated[float, within(-20, 20, "m along the wall from the middle of the doorway")] = 0.0
    yaw: Annotated[float, within(-360, 360, "degrees, 0 = towards the CCW side")] = 0.0

    def __post_init__(self) -> None:
        force_setattr(self, "name", clean_name(self.name, "start pose name", "start pose"))
        if self.x == 0:
            raise ValueError("x: 0 is on the threshold, a start pose lies on one side")

    @property
    def pose(self) -> StartPose:
        return StartPose(self.x, self.y, self.yaw)


DEFAULT_START_POSES = (
    StartPoseSetting(name="CCW, 1.5 m", x=1.5, yaw=180.0),
    StartPoseSetting(name="CW, 1.5 m", x=-1.5),
)
"""One pose for each side, in front of the door and facing it."""


def start_pose_on(side: Side, poses: Iterable[StartPoseSetting]) -> StartPose:
    """The first of `poses` on `side`, else the default one."""
    choices = (setting.pose for setting in (*poses, *DEFAULT_START_POSES))
    return next(pose for pose in choices if pose.side is side)


class SourceSetting(SettingsTable, frozen=True):
    """[testbed]: where the messages come from. The name is cleaned."""

    name: (
        Annotated[str, Meta(description="stands with every run; the host's name when not set")]
        | None
    ) = None
    kind: (
        Annotated[SourceKind, Meta(description="ros or simulated; found out when not set")] | None
    ) = None
    domain: (
        Annotated[
            int, Meta(ge=0, le=LARGEST_DOMAIN, description="ROS domain; else ROS_DOMAIN_ID, else 0")
        ]
        | None
    ) = None

    def __post_init__(self) -> None:
        if self.name is not None:
            force_setattr(self, "name", clean_name(self.name, "name"))
        if self.kind is SourceKind.REPLAY:
            raise ValueError("kind: a replay needs its bag, use `--testbed replay PATH`")


_UNITS: dict[Signal, dict[str, float]] = {
    Signal.DOOR: {"rad": 1.0, "deg": math.pi / 180},
    Signal.HANDLE: {"N": 1.0, "gf": 0.00980665, "kgf": 9.80665},
    **{strip: {"m": 1.0, "cm": 0.01, "mm": 0.001} for strip in STRIPS},
    Signal.LATCH: {},
}
"""Units of a signal, each with its factor to the protocol's."""


class TopicSetting(SettingsTable, frozen=True):
    """One [[topics]]: how this testbed publishes a signal; what is left out stays as it is."""

    signal: Signal
    topic: _TopicName | None = None
    topics: tuple[_TopicName, _TopicName, _TopicName, _TopicName] | None = None
    type: _TypeName | None = None
    field: str | None = None
    scale: Annotated[float, within(-1e9, 1e9, "factor to `unit`")] = 1.0
    offset: Annotated[float, within(-1e9, 1e9, "added after scaling, in `unit`")] = 0.0
    unit: Annotated[str, Meta(description="the protocol's when not set")] | None = None
    no_echo: (
        Annotated[str, Meta(max_length=20, description="a range that says nothing is there")]
        | float
    ) = "inf"
    largest: (
        Annotated[int, Meta(ge=1, le=10**9, description="bytes of a message that is read")] | None
    ) = None

    def __post_init__(self) -> None:
        if self.scale == 0:
            raise ValueError("scale: 0 loses the signal")
        if self.unit is not None and self.unit not in _UNITS[self.signal]:
            units = ", ".join(_UNITS[self.signal]) or "none"
            raise ValueError(f"unit: {self.unit!r} is none of {self.signal.value}; use {units}")
        if self.topics is not None and (self.topic is not None or self.type is None):
            raise ValueError("topics: name their type and field, and no `topic` beside them")
        if self.type is not None and self.field is None:
            raise ValueError(f"field: name the field of {self.type} that holds the value")

    def mappings(self, default: TopicMapping) -> tuple[TopicMapping, ...]:
        """The default one with what differs, for each topic; MadrobError for a bad field."""
        changes = {key: value for key, value in asdict(self).items() if value is not None}
        factor = _UNITS[self.signal][changes.pop("unit")] if self.unit else 1.0
        changes |= {
            "scale": self.scale * factor,
            "offset": self.offset * factor,
            "no_echo": str(self.no_echo),
        }
        topics = changes.pop("topics", (self.topic or default.topic,))
        return tuple(dataclasses.replace(default, **{**changes, "topic": name}) for name in topics)


def _table_of(numbers: type[DataclassInstance], about: str, **methods: object) -> Any:  # noqa: ANN401
    """A table of the numbers that have limits in their metadata."""
    keys = []
    for each in dataclasses.fields(numbers):
        if LIMITS in each.metadata:
            low, high, words = each.metadata[LIMITS]
            number = Meta(ge=low, le=high, description=words)
            kind: Any = Annotated[type(each.default), number]
            if isinstance(each.default, tuple):
                parts = (Annotated[float, number],) * len(each.default)
                kind = Annotated[tuple[parts], Meta(description=words)]  # type: ignore[valid-type]
            keys.append((each.name, kind, each.default))
    return msgspec.defstruct(
        f"{numbers.__name__}Table",
        keys,
        bases=(SettingsTable,),
        namespace={"__doc__": about, **methods},
        frozen=True,
    )


def _demand_low_robots(thresholds: Thresholds) -> None:
    if thresholds.present_height >= thresholds.lintel_height:
        raise ValueError("present_height: must be below lintel_height")


if TYPE_CHECKING:
    ThresholdSettings = SettingsTable
else:
    ThresholdSettings = _table_of(
        Thresholds,
        "[thresholds]: the numbers that turn signals into events (protocol sections 4 and 7).",
        __post_init__=_demand_low_robots,
    )


class FreshnessSettings(SettingsTable, frozen=True):
    """[freshness]: how old the newest message of a topic may be."""

    fresh: Annotated[float, within(0.01, 60, "s; up to this age a topic is fresh")] = _L.fresh
    lost: Annotated[float, within(0.01, 600, "s; above this age it is lost")] = _L.lost

    def __post_init__(self) -> None:
        if self.lost < self.fresh:
            raise ValueError("lost: must not be below fresh")


class Checks(SettingsTable, frozen=True):
    """[checks]: limits of the checks before a start."""

    rate: Annotated[float, within(0.1, 10000, "Hz; what the testbed's topics should have")] = (
        _L.rate
    )
    least_rate: Annotated[float, within(0, 1, "healthy from this part of it")] = _L.least_rate
    most_rate: Annotated[float, within(1, 1000, "healthy up to this part of it")] = _L.most_rate
    largest_skew: Annotated[float, within(0.001, 3600, "s between stamp and reception")] = (
        _T.largest_skew
    )
    disk_space: Annotated[int, Meta(ge=0, le=10**15, description="bytes that must be free")] = (
        500_000_000
    )


class Results(SettingsTable, frozen=True):
    """[results]: where runs are kept."""

    folder: Annotated[str, Meta(min_length=1, description="one folder a run in it")] = (
        "~/madrob_runs"
    )
    reports: Annotated[bool, Meta(description="make report.html after every result")] = True
    publish: Annotated[
        str, Meta(description="folder of the competition's pages, written again after every result")
    ] = ""

    def __post_init__(self) -> None:
        _demand_whole_path("folder", self.folder)
        if self.publish:
            _demand_whole_path("publish", self.publish)

    @property
    def root(self) -> Path:
        return Path(self.folder).expanduser()


class EvidenceSettings(SettingsTable, frozen=True):
    """[evidence]: what is recorded beside the testbed's own topics; nothing is scored from it."""

    topics: Annotated[
        tuple[_TopicName, ...],
        Meta(
            max_length=100,
            description='cameras and others: ["/camera/image/compressed", "/tf"]',
        ),
    ] = ()


class EngineSettings(SettingsTable, frozen=True):
    """[engine]: the process behind the screens."""

    idle_time: Annotated[
        float, within(1, 1e6, "s without screen and run, then it ends; at most 20 where simulated")
    ] = 600.0


class ConsoleSettings(SettingsTable, frozen=True):
    """[console]: the referee's screens."""

    theme: Annotated[ThemeName, Meta(description="dark, light or high-contrast")] = ThemeName.DARK
    bell: Annotated[bool, Meta(description="ring at start, stop and fault")] = True
    mouse: Annotated[bool, Meta(description="false leaves the mouse to the terminal")] = True


def _demand_whole_path(key: str, path: str) -> None:
    """Demands a path that means the same wherever the console is started."""
    try:
        whole = Path(path).expanduser()
    except RuntimeError:  # `~name` of a user that does not exist
        whole = Path(path)
    if not whole.is_absolute():
        raise ValueError(f"{key}: begin it with / or ~/")


class SimulatedDoor(SettingsTable, frozen=True):
    """[simulated.door]: doorway, panel, sensor places; m. `lintel_height` is in [thresholds]."""

    doorway_width: Annotated[float, within(0.5, 5, "m between the jambs")] = 1.0
    panel_length: Annotated[float, within(0.5, 5, "m")] = 0.98
    panel_height: Annotated[float, within(0.5, 10, "m")] = 1.95
    sensor_distance: Annotated[float, within(0.02, 2, "m from the wall")] = 0.175
    sensor_spacing: Annotated[float, within(0.01, 1, "m between neighbours")] = 0.125

    def geometry(self, thresholds: Thresholds) -> DoorGeometry:
        from madrob_console.testbeds.simulated.geometry import DoorGeometry

        return DoorGeometry(
            **asdict(self), lintel_height=thresholds.lintel_height, thresholds=thresholds
        )


class SimulatedSensors(SettingsTable, frozen=True):
    """[simulated.sensors]: how the sensors behave."""

    rate: Annotated[float, within(1, 1000, "Hz, each topic")] = 50.0
    latch: Annotated[bool, Meta(description="whether there is a latch sensor")] = False

    def settings(self) -> SensorSettings:
        from madrob_console.testbeds.simulated.sensor_model import SensorSettings

        return SensorSettings(**asdict(self))


class Simulated(SettingsTable, frozen=True):
    """[simulated]: the simulated testbed."""

    door: SimulatedDoor = SimulatedDoor()
    sensors: SimulatedSensors = SimulatedSensors()
