"""The protocol's own words and numbers (protocol sections 1, 4 and 7).

Every number here is the default of a setting: a testbed with other sensors changes `Thresholds`,
not code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum, IntEnum, StrEnum
from typing import Any, Protocol, Self


class ScoringError(Exception):
    """An input to `scoring` cannot be used; the message names it and the remedy."""


POST_ROLL = 1.0
"""How long recording goes on after the stop is decided, s (section 3)."""

GRAM_FORCE = 0.00980665


class Side(StrEnum):
    """One side of the testbed, named after the turn with which the panel enters it (section 1)."""

    CW = "cw"
    CCW = "ccw"

    @property
    def opposite(self) -> Side:
        return Side.CCW if self is Side.CW else Side.CW

    @property
    def sign(self) -> int:
        """Sign of a door angle on this side: positive angles are CCW."""
        return 1 if self is Side.CCW else -1


class BenchmarkType(StrEnum):
    """How the door resists, in the order in which EUROBENCH numbers it (section 1)."""

    NO_FORCE = "No Force"
    CONSTANT_FORCE = "Constant Force"
    SUDDEN_FORCE = "Sudden Force"
    SUDDEN_RAMP = "Sudden Ramp"
    WIND_RAMP = "Wind Ramp"


@dataclass(frozen=True, slots=True)
class Condition:
    """What the robot has to do: one of 20 conditions (protocol section 1).

    Attributes:
        benchmark_type: how the door resists.
        opening_side: the side towards which the panel moves.
        starting_side: the side on which the robot starts.

    Raises:
        ScoringError: there is no such benchmark type or side.
    """

    benchmark_type: BenchmarkType
    opening_side: Side
    starting_side: Side

    def __post_init__(self) -> None:
        """Members are compared by identity, so a plain text becomes its member."""
        kinds = (BenchmarkType, Side, Side)
        for name, kind in zip(self.__slots__, kinds, strict=True):
            value = getattr(self, name)
            if value not in [*kind]:
                raise ScoringError(f"{name}: there is no {value!r}: use {' or '.join(kind)}")
            object.__setattr__(self, name, kind(value))

    @property
    def number(self) -> int:
        return (
            1
            + list(BenchmarkType).index(self.benchmark_type)
            + 5 * (self.opening_side is Side.CW)
            + 10 * (self.starting_side is Side.CW)
        )

    @property
    def destination_side(self) -> Side:
        return self.starting_side.opposite

    @property
    def must_pull(self) -> bool:
        return self.opening_side is self.starting_side

    @property
    def way(self) -> str:
        """The task in words: `pull, from CW to CCW`."""
        way = "pull" if self.must_pull else "push"
        return f"{way}, from {self.starting_side.upper()} to {self.destination_side.upper()}"

    @classmethod
    def from_number(cls, number: int) -> Condition:
        """The condition with EUROBENCH's number.

        `ScoringError` unless it is 1..20.
        """
        if number not in range(1, 21):
            raise ScoringError(f"condition {number} does not exist: use a number from 1 to 20")
        index = int(number) - 1
        return cls(
            benchmark_type=list(BenchmarkType)[index % 5],
            opening_side=Side.CW if index // 5 % 2 else Side.CCW,
            starting_side=Side.CW if index // 10 else Side.CCW,
        )


class Step(IntEnum):
    """The six steps of the procedure, in order (section 2)."""

    TOUCH = 1
    UNLOCK = 2
    OPEN = 3
    CROSS = 4
    CLOSE = 5
    LOCK = 6

    @property
    def text(self) -> str:
        return _STEP_TEXTS[self]


_STEP_TEXTS = {
    Step.TOUCH: "touch the handle",
    Step.UNLOCK: "unlock the door",
    Step.OPEN: "open the door",
    Step.CROSS: "cross the threshold",
    Step.CLOSE: "close the door",
    Step.LOCK: "lock the door",
}


class Outcome(StrEnum):
    """How a run ended (section 2)."""

    COMPLETED = "completed"
    TIMEOUT = "timeout"
    ABORTED = "aborted"
    INTERRUPTED = "interrupted"


class LockDetection(StrEnum):
    """What decides step 6 (section 7)."""

    AUTO = "auto"
    SETTLE = "settle"
    SENSOR = "sensor"
    REFEREE = "referee"


class EventName(StrEnum):
    """Events, named as in the EUROBENCH event file (section 4)."""

    BENCHMARK_START = "benchmark_start"
    BENCHMARK_STOP = "benchmark_stop"
    HANDLE_IS_TOUCHED = "handle_is_touched"
    DOOR_OPENS = "door_opens"
    DOOR_CLOSES = "door_closes"
    APPROACHES_CW = "humanoid_approaches_the_door_on_cw_side"
    APPROACHES_CCW = "humanoid_approaches_the_door_on_ccw_side"
    MOVES_TO_CW = "humanoid_moves_to_cw_side"
    MOVES_TO_CCW = "humanoid_moves_to_ccw_side"
    DOOR_IS_UNLOCKED = "door_is_unlocked"
    DOOR_IS_LOCKED = "door_is_locked"

    @classmethod
    def approaches(cls, side: Side) -> EventName:
        return cls.APPROACHES_CW if side is Side.CW else cls.APPROACHES_CCW

    @classmethod
    def moves_to(cls, side: Side) -> EventName:
        """The event of a robot that leaves the doorway on `side`."""
        return cls.MOVES_TO_CW if side is Side.CW else cls.MOVES_TO_CCW

    @property
    def words(self) -> str:
        return _EVENT_WORDS[self]


_EVENT_WORDS = {
    EventName.BENCHMARK_START: "run starts",
    EventName.BENCHMARK_STOP: "run stops",
    EventName.HANDLE_IS_TOUCHED: "handle touched",
    EventName.DOOR_OPENS: "door opens",
    EventName.DOOR_CLOSES: "door closes",
    EventName.APPROACHES_CW: "robot approaches on the CW side",
    EventName.APPROACHES_CCW: "robot approaches on the CCW side",
    EventName.MOVES_TO_CW: "robot leaves the doorway on the CW side",
    EventName.MOVES_TO_CCW: "robot leaves the doorway on the CCW side",
    EventName.DOOR_IS_UNLOCKED: "door unlocked",
    EventName.DOOR_IS_LOCKED: "door locked",
}


def event_words(name: str) -> str:
    """An event in words, for people.

    An unknown name is returned as it is.
    """
    return EventName(name).words if name in _EVENT_WORDS else name


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at `time` (ROS time, s since the epoch)."""

    time: float
    name: EventName


class Strip(StrEnum):
    """One of the four sensor strips above the door, named like its topic (section 3)."""

    CW_LEFT = "cw_left"
    CW_RIGHT = "cw_right"
    CCW_LEFT = "ccw_left"
    CCW_RIGHT = "ccw_right"

    __hash__ = str.__hash__  # Enum's own is many times as slow, and each sample looks one up

    @property
    def side(self) -> Side:
        return Side.CW if self in (Strip.CW_LEFT, Strip.CW_RIGHT) else Side.CCW


SENSORS_PER_STRIP = 4


class Signal(Enum):
    """A kind of data that the testbed delivers (section 3). Values are names for people."""

    DOOR = "door angle"
    HANDLE = "handle force"
    CW_LEFT = "passage cw left"
    CW_RIGHT = "passage cw right"
    CCW_LEFT = "passage ccw left"
    CCW_RIGHT = "passage ccw right"
    LATCH = "latch"

    __hash__ = object.__hash__  # as for `Strip`

    @property
    def optional(self) -> bool:
        """Whether a testbed works without it.

        An optional signal may send its changes only.
        """
        return self is Signal.LATCH

    @classmethod
    def of_strip(cls, strip: Strip) -> Signal:
        return _SIGNAL_OF_STRIP[strip]


_SIGNAL_OF_STRIP = {strip: Signal[strip.name] for strip in Strip}


@dataclass(frozen=True, slots=True)
class PassageSensor:
    """A used passage sensor (section 4): `index` 0..4 towards the hinge, `element` of `ranges`."""

    side: Side
    index: int
    strip: Strip
    element: int


PASSAGE_SENSORS: tuple[PassageSensor, ...] = tuple(
    PassageSensor(side, index, strip, element)
    for side, places in (
        (Side.CW, [(Strip.CW_RIGHT, e) for e in (3, 2, 1, 0)] + [(Strip.CW_LEFT, 3)]),
        (Side.CCW, [(Strip.CCW_LEFT, e) for e in (3, 2, 1, 0)] + [(Strip.CCW_RIGHT, 0)]),
    )
    for index, (strip, element) in enumerate(places)
)
"""Five sensors a side, by side and index."""


FARTHEST_ZERO = 0.01
"""No run starts unquestioned with a closed door that reads more, to either side, rad."""

_AMPLIFIER = 3
"""No amplifier of a load cell outputs more than this many times its range."""


LIMITS = "limits"
"""Key of the metadata of a number that is a setting: lowest, highest, and its words there."""


def _within(lowest: float, highest: float, words: str, default: Any) -> Any:  # noqa: ANN401
    return field(default=default, metadata={LIMITS: (lowest, highest, words)})


@dataclass(frozen=True, slots=True)
class Thresholds:
    """A testbed's numbers: what makes an event, and what good data are (sections 4, 5 and 7).

    Attributes:
        touch_force: abs(force - handle zero) above this is a touch, N.
        closed_angle: abs(angle) below this is a closed door, rad.
        lintel_height: height of the passage sensors above the ground, m.
        present_height: an obstacle higher than this is a robot, m.
        mask_from, mask_to_cw, mask_to_ccw: for sensor index 0..4, the open interval of
            abs(angle) in which the panel passes under it, rad.
        settle_time: how long the door must stay closed to count as locked, s.
        largest_gap: intervals above this between samples are gaps, s.
        largest_skew: stamps that differ by this much from reception are worth a remark, s.
        largest_force: where the load cell's range ends, in either direction, N.
        largest_angle: a door angle beyond this, to either side, is no reading, rad.
        encoder_counts: of the door's encoder, a turn.
        encoder_noise: standard deviation of the simulated angle of the closed door, rad.
        rate: what the testbed's topics should have, Hz.
        start_uncertainty: how late a start by hand may be, s.
    """

    touch_force: float = _within(0.01, 1000, "N; more is a touch", 200 * GRAM_FORCE)
    closed_angle: float = _within(0.001, 0.5, "rad; less is closed", 0.03)
    lintel_height: float = _within(0.5, 10, "height of the passage sensors, m", 2.0)
    present_height: float = _within(0.01, 10, "m; a higher obstacle is a robot", 0.50)
    mask_from: tuple[float, float, float, float, float] = _within(
        0, 3.15, "rad; panel under sensor 0..4 from", (0.0435, 0.0485, 0.0485, 0.0665, 0.0955)
    )
    mask_to_cw: tuple[float, float, float, float, float] = _within(
        0, 3.15, "rad; to, CW side", (0.30825, 0.3645, 0.417375, 0.518625, 0.72675)
    )
    mask_to_ccw: tuple[float, float, float, float, float] = _within(
        0, 3.15, "rad; to, CCW side", (0.459, 0.41625, 0.417375, 0.518625, 0.72675)
    )
    settle_time: float = _within(0, 60, "s closed to count as locked", 1.0)
    largest_gap: float = _within(0.001, 10, "s between samples", 0.1)
    largest_skew: float = 0.1
    largest_force: float = _within(
        0.1, 1e6, "N; the load cell's range ends here", 20_000 * GRAM_FORCE
    )
    largest_angle: float = _within(0.1, 100, "rad; more is no reading", 1.75)
    # the published recordings have steps of 1 mrad
    encoder_counts: int = _within(4, 10**9, "of the door, a turn", 6283)
    encoder_noise: float = _within(0, 0.1, "rad, standard deviation at rest", 0.00025)
    rate: float = 50.0
    start_uncertainty: float = _within(0, 60, "s; a start by hand is so much late", 0.2)

    @property
    def numbers(self) -> dict[str, Any]:
        """All of them by name."""
        return {name: getattr(self, name) for name in self.__slots__}

    @property
    def unlike_protocol(self) -> dict[str, Any]:
        """The numbers of this testbed that are not the defaults."""
        usual = Thresholds().numbers
        return {name: value for name, value in self.numbers.items() if value != usual[name]}

    @property
    def encoder_count(self) -> float:
        """One count, rad."""
        return math.tau / self.encoder_counts

    @property
    def near_zero(self) -> float:
        """A closed door that reads no more than this is at its zero, rad."""
        return 2 * max(self.encoder_count, math.tau / 3600)

    @property
    def impossible_force(self) -> float:
        """A force beyond this, in either direction, is no reading, N: no amplifier outputs it."""
        return _AMPLIFIER * self.largest_force

    def masked(self, side: Side, index: int, angle: float) -> bool:
        """Return whether the panel, at `angle` (rad), passes under sensor `index` of `side`."""
        low, high = self.mask(side, index)
        return low < angle * side.sign < high

    def mask(self, side: Side, index: int) -> tuple[float, float]:
        """The open interval of angles, rad towards `side`, with the panel under the sensor."""
        upper = self.mask_to_cw if side is Side.CW else self.mask_to_ccw
        return self.mask_from[index], upper[index]


@dataclass(frozen=True, slots=True)
class StartPose:
    """Where the robot stands at the start, in the frame `madrob_door` (protocol section 1).

    Attributes:
        x: towards the CCW side, m.
        y: along the wall, m.
        yaw: degrees.
    """

    x: float
    y: float
    yaw: float

    @property
    def side(self) -> Side | None:
        """The side on which the pose lies.

        None on the threshold itself.
        """
        if self.x == 0:
            return None
        return Side.CCW if self.x > 0 else Side.CW

    @property
    def mirrored(self) -> StartPose:
        return StartPose(-self.x, self.y, math.remainder(180.0 - self.yaw, 360.0))


class Named(Protocol):
    """A row of a table."""

    @property
    def name(self) -> str:
        """The name used in files."""


class NamedRow(StrEnum):
    """The name of a table row, with the row as `spec`; a name without a row fails at import."""

    _value_: str
    spec: Named

    def __new__(cls, spec: Named) -> Self:
        member = str.__new__(cls, spec.name)
        member._value_ = spec.name
        member.spec = spec
        return member
