"""What the robot of one simulated run is going to do: functions of the time since the start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from madrob_console.kinds import Scenario
from madrob_console.testbeds.simulated.geometry import RobotBody
from madrob_console.testbeds.simulated.motion import Motion, Tremor
from scoring.braking import braking_table
from scoring.protocol import GRAM_FORCE, BenchmarkType, Condition, Side

LOAD_CELL_LIMIT = 20_000 * GRAM_FORCE
"""N that the handle's load cell can measure, either way."""

_STEADY_SPEED = 0.05
"""rad/s from which on the brake resists in full."""
_DIFFERENCE = 0.001
"""s over which the panel's speed is taken."""


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """One run, in s since its start.

    Attributes:
        scenario: what the robot does; never `RANDOM`.
        condition: under which it does it.
        body: the robot's.
        robot: x of the body's middle in the frame `madrob_door`, m.
        panel: abs(panel angle) without tremor, rad.
        tremors: what the hand adds to it.
        grip: force of the hand on the handle, N, positive = pushes towards CCW.
        latch: when the latch changes and whether it is engaged from then on; it is engaged at
            first. None = no latch sensor.
    """

    scenario: Scenario
    condition: Condition
    body: RobotBody
    robot: Motion
    panel: Motion
    tremors: tuple[Tremor, ...]
    grip: Motion
    latch: tuple[tuple[float, bool], ...] | None = None

    @property
    def end(self) -> float:
        """When everything has come to rest, s."""
        latched = self.latch[-1][0] if self.latch else 0.0
        return max(self.robot.end, self.panel.end, self.grip.end, latched)

    def opening(self, time: float) -> float:
        """abs(panel angle) with tremor, rad."""
        angle = self.panel.at(time)
        return angle + sum(tremor.at(time, angle) for tremor in self.tremors)

    def angle(self, time: float) -> float:
        """Panel angle, rad, positive = CCW."""
        return self.condition.opening_side.sign * self.opening(time)

    @property
    def opening_knots(self) -> list[float]:
        """The instants between which `opening` is monotone, s."""
        knots = set(self.panel.knots)
        for tremor in self.tremors:
            knots.update(tremor.knots)
        return sorted(knots)

    def contact(self, time: float) -> float:
        """Force between hand and handle, N: the grip, and what it takes to move the brake."""
        grip = self.grip.at(time)
        if grip == 0:
            return 0.0
        before, after = self.panel.at(time - _DIFFERENCE), self.panel.at(time + _DIFFERENCE)
        speed = (after - before) / (2 * _DIFFERENCE)
        brake = _brake(self.condition.benchmark_type)[round(math.degrees(after))]
        drag = brake * max(-1.0, min(1.0, speed / _STEADY_SPEED))
        total = grip + self.condition.opening_side.sign * drag
        return max(-LOAD_CELL_LIMIT, min(LOAD_CELL_LIMIT, total))

    def latched(self, time: float) -> bool:
        """Whether the latch is engaged."""
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
