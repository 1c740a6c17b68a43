"""What the values of a run rest on: where doubts and uncertainties are found (section 11)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scoring.deciding import DecidingEdge
from scoring.door_angle import DoorAngle, without_top
from scoring.indicator_table import IndicatorName as Name
from scoring.indicators import (
    roughness_of_door_actuation,
    smoothness_of_door_actuation,
    unsafety_of_door_operation,
)
from scoring.kinematics import Array, JointState, joint_state
from scoring.protocol import Event, EventName, Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.rest import RestForce
from scoring.result import Indicator
from scoring.rows import Rows, cut_rows, process_rows
from scoring.rulesets import Ruleset

_NOISE = 2.0
"""What moves the largest force by less standard deviations of its noise is noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """What the values of a run rest on.

    Attributes:
        start: of the run, s since the epoch.
        end: of what is scored, s since the epoch.
        events: of the run.
        edges: on which the indicators hang.
        counters: of every signal that came.
        door: the angle's readings of the whole recording.
        impossible_angles: when the door said what it cannot, s since the epoch, shape (m,).
        guessed: stamps, s since the epoch, and angles, rad, of passage samples that were masked
            before the door angle at their stamps had come, shape (n, 2).
        force_time, force: likewise of the handle, s since the epoch and N, shape (k,).
        joint: the panel's motion over the whole recording.
        rows: cut to the run.
        rows_end: where they are cut, s since the epoch.
        rest: the handle's rest force.
        handle_zero: N.
        ruleset: whose rules.
        thresholds: the testbed's numbers.
    """

    start: float
    end: float
    events: Sequence[Event]
    edges: Sequence[DecidingEdge]
    counters: Mapping[Signal, QualityCounter]
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
        """The motion of other door angles, and the rows cut to the run.

        Args:
            time: of the whole recording, s since the epoch, shape (n,).
            angle: rad, shape (n,).
            ruleset: whose filters.
        """
        joint = joint_state(time, angle, ruleset, self.thresholds)
        rows = process_rows(joint, self.force_time, self.force, ruleset, self.thresholds)
        if ruleset.cut_rows:
            rows = cut_rows(rows, self.start, self.rows_end)
        return joint, rows

    def signal_values(self) -> dict[Name, Indicator]:
        """The indicators that are computed from rows."""
        rows = self.rows
        return {
            Name.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows.jerk, rows.opened),
            Name.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows.low_passed),
            Name.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows.load),
        }

    def without_bad_samples(self) -> Grounds | None:
        """The run without samples that fit no motion, and without its largest force.

        None where that changes next to nothing.
        """
        load, bad = self.rows.load, self.door.bad
        if self.ruleset.repairs:
            bad = bad & ~self.door.repairable
        else:
            load = without_top(self.rows.force_time, load, self.force_noise)
        change = np.abs(self.rows.load).max(initial=0.0) - np.abs(load).max(initial=0.0)
        if not bad.any():
            if abs(change) <= _NOISE * self.force_noise:
                return None
            return replace(self, rows=replace(self.rows, load=load))
        good = np.zeros_like(bad)
        angle = self.door.without(self.door.bad)
        door = replace(self.door, angle=angle, spikes=good, frozen=good)
        joint, rows = self.rows_of(door.time, angle, self.ruleset)
        rows = replace(rows, rest=self.rows.rest, load=load)
        return replace(self, door=door, joint=joint, rows=rows)

    @property
    def door_edges(self) -> list[float]:
        """Times of all openings and closings of the run, s since the epoch."""
        kinds = EventName.DOOR_OPENS, EventName.DOOR_CLOSES
        return [event.time for event in self.events if event.name in kinds]

    @property
    def force_noise(self) -> float:
        """Standard deviation of the free handle's force before the run, N; 0 where unknown."""
        return 0.0 if self.rest.before is None else self.rest.before.deviation
