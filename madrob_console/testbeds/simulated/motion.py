"""The motion of a simulated robot and door: smooth functions of the time since the start."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from enum import Enum, auto
from functools import lru_cache
from operator import attrgetter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from madrob_console.testbeds.simulated.geometry import RobotBody
from scoring.kinematics import Array
from scoring.protocol import GRAM_FORCE, BenchmarkType, Condition, Side
from scoring.run_info import braking_table

STEP = 0.002
"""s between two looks at a whole plan."""


def changes(flags: NDArray[np.bool_]) -> Array:
    """When flags taken every `STEP` change, s since the first."""
    changed = np.flatnonzero(flags[1:] != flags[:-1]) + 1
    return STEP * changed.astype(np.float64)


Part = TypeVar("Part", float, Array)


class Profile(Enum):
    """The shape of a move between two rests; both are monotone."""

    MINIMUM_JERK = auto()
    FALL = auto()
    """Ever faster until it hits: a slam."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A move from `origin` at `start` to `target` at `end` (s)."""

    start: float
    end: float
    origin: float
    target: float
    profile: Profile = Profile.MINIMUM_JERK

    def at(self, time: float) -> float:
        part = (time - self.start) / (self.end - self.start)
        if part >= 1:
            return self.target
        return self.origin + (self.target - self.origin) * self.done(part)

    def done(self, part: Part) -> Part:
        """The share of the way after a share of the time."""
        if self.profile is Profile.FALL:
            return part * part
        return part * part * part * (10 - part * (15 - 6 * part))


_start = attrgetter("start")


@dataclass(frozen=True, slots=True)
class Motion:
    """A value over all time: at rest before, between and after its segments."""

    initial: float
    segments: tuple[Segment, ...] = ()

    def at(self, time: float) -> float:
        index = bisect_right(self.segments, time, key=_start)
        return self.segments[index - 1].at(time) if index else self.initial

    @property
    def end(self) -> float:
        return self.segments[-1].end if self.segments else 0.0

    def over(self, times: Array) -> Array:
        values = np.full(times.shape, self.initial)
        for segment in self.segments:
            part = ((times - segment.start) / (segment.end - segment.start)).clip(0.0, 1.0)
            values += (segment.target - segment.origin) * segment.done(part)
        return values


class Track:
    """Builds a `Motion` move by move."""

    def __init__(self, initial: float) -> None:
        self._initial = initial
        self._segments: list[Segment] = []

    @property
    def value(self) -> float:
        return self._segments[-1].target if self._segments else self._initial

    def move(
        self, start: float, target: float, duration: float, profile: Profile = Profile.MINIMUM_JERK
    ) -> float:
        """Adds a move from the last value to `target`; returns its end, s."""
        if target == self.value:
            return start + duration
        if self._segments:
            start = max(start, self._segments[-1].end)
        self._segments.append(Segment(start, start + duration, self.value, target, profile))
        return start + duration

    def motion(self) -> Motion:
        return Motion(self._initial, tuple(self._segments))


@dataclass(frozen=True, slots=True)
class Tremor:
    """A shake of the hand on the panel, in rad and Hz, from `start` to `end` (s).

    Below the angle `still` the frame holds the panel still; from `full` on the shake is full.
    """

    amplitude: float
    frequency: float
    start: float
    end: float
    still: float = 0.1
    full: float = 0.2

    def at(self, time: float, angle: float) -> float:
        """Its addition to a panel at `angle` (rad, abs value)."""
        if not self.start < time < self.end or angle <= self.still:
            return 0.0
        grip = min(1.0, (time - self.start) / 0.2, (self.end - time) / 0.2)
        hold = min(1.0, (angle - self.still) / (self.full - self.still))
        swing = math.sin(math.tau * self.frequency * (time - self.start))
        return self.amplitude * grip * hold * swing


LOAD_CELL_LIMIT = 20_000 * GRAM_FORCE
"""N that the handle's load cell can measure, either way."""

_STEADY_SPEED = 0.05
"""rad/s from which on the brake resists in full."""
_DIFFERENCE = 0.001
"""s over which the panel's speed is computed."""
_KNOCK = 90.0
"""N at the handle when the latch hits the frame, towards the opening side."""
_KNOCK_TIMES = (0.0, 0.03, 0.045, 0.06, 0.11, 0.125)
_KNOCK_SHARES = (0.0, 1.0, 1.0, 0.68, 0.5, 0.0)
"""Its course, s. Two of the real door, 20 ms apart: 0, 55, 78, 53, 46, 39, 1 N and 0, 22, 135, 139,
91, 73, 21 N."""
_RELAXATION = 1.0
"""s in which a sensor's rest reading comes two thirds of the way from one value to the other."""


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """One run, in s since its start.

    `robot` is x of the body's middle in the frame `madrob_door`, m, and `panel` abs(panel angle)
    without tremor, rad. `grip` is in N, positive = pushes towards CCW. At `knock` the latch of the
    closing door hits the frame, s; None = never. `latch` is engaged at first; None = no sensor.
    """

    condition: Condition
    body: RobotBody
    robot: Motion
    panel: Motion
    tremors: tuple[Tremor, ...]
    grip: Motion
    knock: float | None = None
    latch: tuple[tuple[float, bool], ...] | None = None

    @property
    def end(self) -> float:
        latched = self.latch[-1][0] if self.latch else 0.0
        return max(self.robot.end, self.panel.end, self.grip.end, latched)

    def opening(self, time: float) -> float:
        angle = self.panel.at(time)
        return angle + sum(tremor.at(time, angle) for tremor in self.tremors)

    def angle(self, time: float) -> float:
        return self.condition.opening_side.sign * self.opening(time)

    def contact(self, time: float) -> float:
        """Force on the handle, N: the grip, what moves the brake, and the knock of the latch."""
        grip, across = self.grip.at(time), 0.0
        if grip != 0:
            before, after = self.panel.at(time - _DIFFERENCE), self.panel.at(time + _DIFFERENCE)
            speed = (after - before) / (2 * _DIFFERENCE)
            brake = _brake(self.condition.benchmark_type)[round(math.degrees(after))]
            across = brake * max(-1.0, min(1.0, speed / _STEADY_SPEED))
        if self.knock is not None and 0 < time - self.knock < _KNOCK_TIMES[-1]:
            across += _KNOCK * float(np.interp(time - self.knock, _KNOCK_TIMES, _KNOCK_SHARES))
        total = grip + self.condition.opening_side.sign * across
        return max(-LOAD_CELL_LIMIT, min(LOAD_CELL_LIMIT, total))

    def strain(self, time: float) -> float:
        """What is left of the closed door's strain on its sensors; the first move releases it."""
        moves = (*self.grip.segments[:1], *self.panel.segments[:1])
        first = min((segment.start for segment in moves), default=math.inf)
        return math.exp(min(0.0, first - time) / _RELAXATION)

    def latched(self, time: float) -> bool:
        engaged = True
        for change, state in self.latch or ():
            if time >= change:
                engaged = state
        return engaged


@lru_cache
def _brake(benchmark_type: BenchmarkType) -> tuple[float, ...]:
    """Braking force, N, for abs(angle) of 0..90 deg: the half of the table that varies."""
    table = braking_table(benchmark_type, Side.CW)
    return tuple(force * GRAM_FORCE for force in table[90:])
