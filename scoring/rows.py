"""The pre-processed data of a run: what the indicators are computed from and figures show."""

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
    """The pre-processed data of a run (section 5).

    Attributes:
        joint_state: panel motion.
        low_passed: low-passed acceleration of its rows, rad/s^2, shape (n,), NaN = undefined.
        jerk_time, jerk: jerk of the open door, s and rad/s^3, shape (m,).
        force_time, force: handle force as recorded, s and N, shape (k,).
        rest: the force of a free handle at these times, from which the roughness is measured, N,
            shape (k,); 0 where the ruleset takes the force as it was recorded.
        load: the force from which the roughness is taken, N, shape (k,).
        problem: why no low-passed acceleration could be computed; None if it could.
        thresholds: the testbed's numbers by which all this was made.
        occupied: for each used passage sensor, from when to when something was under it since the
            start, s since the epoch, inf = to the end of the recording; not cut, as the departure
            is looked for until then (section 7). Empty where only the rest was published.
    """

    joint_state: JointState
    low_passed: Array
    jerk_time: Array
    jerk: Array
    force_time: Array
    force: Array
    rest: Array
    load: Array
    problem: str | None
    thresholds: Thresholds
    occupied: Mapping[PassageSensor, tuple[tuple[float, float], ...]] = field(default_factory=dict)

    @property
    def no_motion(self) -> str | None:
        """Why there is no motion of the panel, in words; None if there is."""
        return None if self.joint_state.time.size else "no door angle recorded during the run"

    @property
    def opened(self) -> bool:
        """Whether the door is open in any row."""
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
                return self.force_time, self.load


def process_rows(
    joint: JointState,
    force_time: Array,
    force: Array,
    ruleset: Ruleset,
    thresholds: Thresholds,
    rest: Array | None = None,
) -> Rows:
    """Filter a whole recording; cut with `cut_rows` afterwards (section 5).

    Args:
        joint: the panel's motion.
        force_time: of the handle's force, s, shape (k,).
        force: of the handle, N, shape (k,).
        ruleset: whose rules.
        thresholds: the testbed's numbers.
        rest: the free handle's force at these times, N, shape (k,), if the ruleset looks at it.
    """
    jerk_time, jerks = jerk(joint, ruleset, thresholds)
    rest = np.zeros(force.size) if rest is None else rest
    load = force - rest
    return Rows(
        joint_state=joint,
        low_passed=low_pass(joint, ruleset, thresholds),
        jerk_time=jerk_time,
        jerk=jerks,
        force_time=force_time,
        force=force,
        rest=rest,
        load=median_of_three(load) if ruleset.repairs else load,
        problem=low_pass_problem(joint, ruleset, thresholds),
        thresholds=thresholds,
    )


def median_of_three(values: Array) -> Array:
    """The median of each value and its neighbours along the last axis; the ends stay."""
    left, here, right = values[..., :-2], values[..., 1:-1], values[..., 2:]
    low, high = np.minimum(left, here), np.maximum(left, here)
    medians = values.copy()
    medians[..., 1:-1] = np.maximum(low, np.minimum(high, right))
    return medians


def cut_rows(rows: Rows, start: float, end: float) -> Rows:
    """Only the rows that lie in [start, end]."""
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
        rest=rows.rest[force_kept],
        load=rows.load[force_kept],
    )
