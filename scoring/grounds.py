"""The data behind the values, in which doubts and uncertainties are searched (section 11)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scoring.braking import largest_brake
from scoring.deciding_edges import DecidingEdge
from scoring.door_angle import DoorAngle, Flags, last_closing, without_spikes
from scoring.events import Evidence
from scoring.indicator_table import IndicatorName as Name
from scoring.indicators import (
    roughness_of_door_actuation,
    smoothness_of_door_actuation,
    unsafety_of_door_operation,
)
from scoring.kinematics import Array, JointState, joint_state
from scoring.procedure import Procedure
from scoring.protocol import Condition, Event, EventName, PassageSensor, Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.rest import RestForce
from scoring.result import Indicator
from scoring.rows import Rows, cut_rows, process_rows
from scoring.rulesets import Ruleset

_NOISE = 2.0
"""A change of the largest force by fewer standard deviations of its noise is noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """The evidence behind the values of a run; times in s since the epoch, rad and N.

    Attributes:
        end: of what is scored.
        start_uncertainty: of a start by hand, s.
        completed: whether the run ended as completed.
        evidence: of the steps.
        presences: for each used sensor, from when to when something was under it.
        doubted: words that cast doubt on a signal, from the reader of the recording.
        door, joint, force_time, force: over the whole recording.
        impossible_angles: times of impossible door angles, shape (m,).
        guessed: stamps and angles, shape (n, 2), of passage samples that were masked before the
            door angle at their stamps had come.
        rows: cut to the run, at `rows_end`.
    """

    condition: Condition
    start: float
    end: float
    start_uncertainty: float
    completed: bool
    procedure: Procedure
    evidence: Evidence
    events: Sequence[Event]
    presences: Mapping[PassageSensor, Sequence[tuple[float, float]]]
    edges: Sequence[DecidingEdge]
    counters: Mapping[Signal, QualityCounter]
    doubted: Mapping[str, Signal]
    door: DoorAngle
    impossible_angles: Array
    guessed: Array
    force_time: Array
    force: Array
    joint: JointState
    rows: Rows
    rows_end: float
    rest: RestForce
    handle_zero: float
    ruleset: Ruleset
    thresholds: Thresholds

    def rows_of(self, time: Array, angle: Array, ruleset: Ruleset) -> tuple[JointState, Rows]:
        """The motion of other door angles, rad, shape (n,), and the rows cut to the run."""
        joint = joint_state(time, angle, ruleset, self.thresholds)
        rows = process_rows(joint, self.force_time, self.force, ruleset, self.thresholds)
        if ruleset.cut_rows:
            rows = cut_rows(rows, self.start, self.rows_end)
        return joint, rows

    def signal_values(self) -> dict[Name, Indicator]:
        rows = self.rows
        return {
            Name.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows.jerk, rows.opened),
            Name.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows.low_passed),
            Name.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows.force),
        }

    def without_bad_samples(self) -> Grounds | None:
        """The run without bad samples and its largest force; None if next to nothing changes."""
        force = without_spikes(self.rows.force_time, self.rows.force, self.force_noise)
        change = np.abs(self.rows.force).max(initial=0.0) - np.abs(force).max(initial=0.0)
        door = self.door.repaired(self.thresholds)
        if door is self.door:
            if abs(change) <= _NOISE * self.force_noise:
                return None
            return replace(self, rows=replace(self.rows, force=force))
        joint, rows = self.rows_of(door.time, door.angle, self.ruleset)
        return replace(self, door=door, joint=joint, rows=replace(rows, force=force))

    def zero_shift(self) -> float:
        """How far the door's zero moves its last closing, s; inf = it makes it, or undoes it."""
        zero, thresholds = self.door.before, self.thresholds
        if zero is None or abs(zero) <= thresholds.near_zero:
            return 0.0
        since = self.door.time >= self.start
        time, angle = self.door.time[since], self.door.angle[since]
        as_recorded, corrected = (
            last_closing(time, each, thresholds.closed_angle) for each in (angle, angle - zero)
        )
        return abs(as_recorded - corrected) if as_recorded != corrected else 0.0

    def drift_shift(self) -> float:
        """How far the touch moves by the handle at rest just before it and after the run, s.

        inf = it is none: the force is that of the handle after the run.
        """
        force, threshold = self.force - self.handle_zero, self.thresholds.touch_force

        def first(pressed: Flags) -> float:
            times = self.force_time[pressed & (self.force_time >= self.start)]
            return float(times[0]) if times.size else math.inf

        touch = first(pressed := np.abs(force) > threshold)
        if touch == math.inf:
            return 0.0
        since, until = (touch - early for early in JUST_BEFORE)
        free = force[(self.force_time > since) & (self.force_time < until)]
        zero = float(np.median(free)) if free.size else 0.0
        surely = pressed & (np.abs(force - (self.rest.drift or 0.0)) > threshold)
        return max(abs(first(np.abs(force - zero) > threshold) - touch), first(surely) - touch)

    @property
    def recorded_until(self) -> float:
        """When the last reading of any signal came, s since the epoch."""
        return max((c.read_until for c in self.counters.values()), default=-math.inf)

    @property
    def brake_ends_range(self) -> bool:
        """Whether the condition's brake reaches the end of the load cell's range."""
        return largest_brake(self.condition.benchmark_type) >= self.thresholds.largest_force

    @property
    def force_ends_range(self) -> bool:
        end = self.thresholds.doubt.range_end * self.thresholds.largest_force
        return bool(np.abs(self.rows.force).max(initial=0.0) >= end)

    @property
    def door_edges(self) -> list[float]:
        kinds = EventName.DOOR_OPENS, EventName.DOOR_CLOSES
        return [event.time for event in self.events if event.name in kinds]

    @property
    def force_noise(self) -> float:
        """Standard deviation of the free handle's force before the run, N; 0 where unknown."""
        return 0.0 if self.rest.before is None else self.rest.before.deviation


JUST_BEFORE = (0.7, 0.2)
"""When the free handle is looked at, s before the touch."""
