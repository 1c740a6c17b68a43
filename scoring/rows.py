"""The pre-processed data of a run, from which indicators are computed and figures drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from scoring.figure_table import Quantity
from scoring.kinematics import Array, JointState, jerk, low_pass, low_pass_problem
from scoring.protocol import PassageSensor, Thresholds
from scoring.rulesets import Ruleset


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
        """Times, s since the epoch, and values of a quantity, in its unit; both of shape (n,)."""
        match quantity:
            case Quantity.POSITION:
                return self.joint_state.time, self.joint_state.position
            case Quantity.ACCELERATION:
                return self.joint_state.time, self.low_passed
            case Quantity.JERK:
                return self.jerk_time, self.jerk
            case Quantity.FORCE:
                return self.force_time, self.force


def process_rows(
    joint: JointState,
    force_time: Array,
    force: Array,
    ruleset: Ruleset,
    thresholds: Thresholds,
) -> Rows:
    """Filter a whole recording; cut with `cut_rows` afterwards (section 5)."""
    jerk_time, jerks = jerk(joint, ruleset, thresholds)
    return Rows(
        joint_state=joint,
        low_passed=low_pass(joint, ruleset, thresholds),
        jerk_time=jerk_time,
        jerk=jerks,
        force_time=force_time,
        force=force,
        problem=low_pass_problem(joint, ruleset, thresholds),
        thresholds=thresholds,
    )


def cut_rows(rows: Rows, start: float, end: float) -> Rows:
    jerk_kept = (rows.jerk_time >= start) & (rows.jerk_time <= end)
    force_kept = (rows.force_time >= start) & (rows.force_time <= end)
    return replace(
        rows,
        joint_state=rows.joint_state.cut(start, end),
        low_passed=rows.low_passed[rows.joint_state.rows(start, end)],
        jerk_time=rows.jerk_time[jerk_kept],
        jerk=rows.jerk[jerk_kept],
        force_time=rows.force_time[force_kept],
        force=rows.force[force_kept],
    )
