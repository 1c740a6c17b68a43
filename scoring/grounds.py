"""What the values of a run rest on: where doubts and uncertainties are found (section 11)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scoring.deciding import DecidingEdge
from scoring.kinematics import Array, JointState
from scoring.protocol import Event, EventName, Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.rest import RestForce
from scoring.rows import Rows
from scoring.rulesets import Ruleset


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """What the values of a run rest on.

    Attributes:
        start: of the run, s since the epoch.
        end: of what is scored, s since the epoch.
        events: of the run.
        edges: on which the indicators hang.
        counters: of every signal that came.
        door_time, door_angle: the readings of the whole recording, s since the epoch and rad, shape
            (n,).
        impossible_angles: when the door said what it cannot, s since the epoch, shape (m,).
        force_time, force: likewise of the handle, s since the epoch and N, shape (k,).
        joint: the panel's motion over the whole recording.
        rows: cut to the run.
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
    door_time: Array
    door_angle: Array
    impossible_angles: Array
    force_time: Array
    force: Array
    joint: JointState
    rows: Rows
    rest: RestForce
    handle_zero: float
    ruleset: Ruleset
    thresholds: Thresholds

    @property
    def door_edges(self) -> list[float]:
        """Times of all openings and closings of the run, s since the epoch."""
        kinds = EventName.DOOR_OPENS, EventName.DOOR_CLOSES
        return [event.time for event in self.events if event.name in kinds]

    @property
    def force_noise(self) -> float:
        """Standard deviation of the free handle's force before the run, N; 0 where unknown."""
        return 0.0 if self.rest.before is None else self.rest.before.deviation
