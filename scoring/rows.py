"""The pre-processed data of a run, from which indicators are computed and figures drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from scoring.figure_table import Quantity
from scoring.kinematics import Array, JointState, jerk, joint_state, low_pass
from scoring.protocol import PassageSensor, Thresholds


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The pre-processed data of a run (section 5); N, s, rad/s^2 and rad/s^3.

    Attributes:
        low_passed: acceleration of the rows of `joint_state`, shape (n,), NaN = undefined.
        jerk_time, jerk: of the open door, shape (m,).
        force_time, force: of the handle as recorded, shape (k,).
        problem: why no low-passed acceleration could be computed.
        occupied: for each used sensor, from when to when something was under it since the start,
            s since the epoch, inf = to the end of the recording; not cut, as the departure is
            looked for until then (section 7). Empty for a published run.
    """

    joint_state: JointState
    low_passed: Array
    jerk_time: Array
    jerk: Array
    force_time: Array
    force: Array
    problem: str | None
    thresholds: Thresholds
    occupied: Mapping[PassageSensor, tuple[tuple[float, float], ...]] = field(default_factory=dict)

    @property
    def no_motion(self) -> str | None:
        return None if self.joint_state.time.size else "no door angle recorded during the run"

    @property
    def opened(self) -> bool:
        return bool((np.abs(self.joint_state.position) > self.thresholds.closed_angle).any())

    def series(self, quantity: Quantity) -> tuple[Array, Array]:
        """Times, s since the epoch, and values of a quantity, in its unit.

        Both of shape (n,).
        """
        match quantity:
            case Quantity.POSITION:
                return self.joint_state.time, self.joint_state.position
            case Quantity.ACCELERATION:
                return self.joint_state.time, self.low_passed
            case Quantity.JERK:
                return self.jerk_time, self.jerk
            case Quantity.FORCE:
                return self.force_time, self.force

    def cut(self, start: float, end: float) -> Rows:
        """The rows in [start, end], s since the epoch."""
        jerk_kept = (self.jerk_time >= start) & (self.jerk_time <= end)
        force_kept = (self.force_time >= start) & (self.force_time <= end)
        return replace(
            self,
            joint_state=self.joint_state.cut(start, end),
            low_passed=self.low_passed[self.joint_state.rows(start, end)],
            jerk_time=self.jerk_time[jerk_kept],
            jerk=self.jerk[jerk_kept],
            force_time=self.force_time[force_kept],
            force=self.force[force_kept],
        )


def process_rows(
    door_time: Array, angle: Array, force_time: Array, force: Array, thresholds: Thresholds
) -> Rows:
    """Filter a whole recording.

    Cut it with `Rows.cut` afterwards (section 5).
    """
    joint = joint_state(door_time, angle, thresholds)
    low_passed, problem = low_pass(joint, thresholds)
    jerk_time, jerks = jerk(joint, thresholds)
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
