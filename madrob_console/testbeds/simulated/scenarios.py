"""The scenarios: what a simulated robot does, and how, for each run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random

import numpy as np

from madrob_console.common.names import Scenario
from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.motion import (
    STEP,
    MotionPlan,
    Profile,
    Track,
    Tremor,
    changes,
)
from scoring.protocol import Condition

_GRIP_RISE = 0.15
"""s in which a hand closes or opens."""
_DISTANCE = 1.5
"""m from the threshold to a robot's middle at the start."""
_ARM = 0.6
"""m from a robot's front to the handle it holds."""

_REBOUND = 0.008
"""rad by which a slammed panel springs back, within the closed zone."""
_FRAME = 0.04
"""rad at which the latch of a closing door hits the frame."""


@dataclass(frozen=True, slots=True)
class Manner:
    """How a robot acts; in s, m, m/s, rad, N and Hz.

    Attributes:
        reaction: from the start until the robot sets out.
        overlap: how long before the panel is open a robot that pushes drives on.
    """

    reaction: float = 0.5
    speed: float = 0.5
    open_angle: float = 1.05
    opening_time: float = 3.0
    closing_time: float = 3.0
    pause: float = 0.4
    grip: float = 12.0
    tremor: float = 0.002
    tremor_frequency: float = 8.0
    overlap: float = 0.0
    slam_time: float = 0.9


class Performance:
    """Builds a motion plan, one act after the other.

    Positions are counted along the robot's way: 0 = threshold, positive = destination side. The
    robot starts at a distance from it, at least clear of the sensors, m.
    """

    def __init__(
        self,
        manner: Manner,
        condition: Condition,
        body: RobotBody,
        geometry: DoorGeometry,
        start_distance: float | None,
    ) -> None:
        self.manner = manner
        self.condition = condition
        self.body = body
        self.geometry = geometry
        self.now = manner.reaction
        self._way = condition.destination_side.sign
        self._opening = condition.opening_side.sign
        clear = geometry.clear_distance(body) + 0.1
        self._robot = Track(-self._way * max(start_distance or _DISTANCE, clear))
        self._panel = Track(0.0)
        self._grip = Track(0.0)
        self._tremors: list[Tremor] = []
        self._latch: list[tuple[float, bool]] = []
        self._taken: float | None = None

    @property
    def arm_reach(self) -> float:
        """From the body's middle to the handle it holds, m."""
        return self.body.length / 2 + _ARM

    @property
    def beyond_swing(self) -> float:
        """Distance from the threshold at which the panel swings past the body, m."""
        return self.geometry.panel_length + self.body.length / 2 + 0.15

    def wait(self, duration: float) -> None:
        self.now += duration

    def drive(self, position: float) -> None:
        duration = max(0.3, abs(position - self._way * self._robot.value) / self.manner.speed)
        self.now = self._robot.move(self.now, self._way * position, duration)

    def turn_panel(
        self, angle: float, duration: float, profile: Profile = Profile.MINIMUM_JERK
    ) -> None:
        """Turns the panel to an angle (abs value, rad)."""
        slowest = 2.2 * abs(angle - self._panel.value) / self.geometry.fastest_panel
        self.now = self._panel.move(self.now, angle, max(duration, slowest), profile)

    def take_handle(self, *, opening: bool) -> None:
        """Closes the hand on the handle, and turns it where the door is closed."""
        sign = self._opening if opening else -self._opening
        self._taken = self.now
        self.now = self._grip.move(self.now, sign * self.manner.grip, _GRIP_RISE)
        self.wait(self.manner.pause / 2)
        if self._panel.value == 0:
            self.unlock()
        self.wait(self.manner.pause / 2)

    def let_go(self) -> None:
        if self._taken is not None and self.manner.tremor > 0:
            self._tremors.append(
                Tremor(
                    self.manner.tremor,
                    self.manner.tremor_frequency,
                    start=self._taken,
                    end=self.now,
                )
            )
        self._taken = None
        self.now = self._grip.move(self.now, 0.0, _GRIP_RISE)

    def unlock(self) -> None:
        self._latch.append((self.now, False))

    def lock(self) -> None:
        """Engages the latch, a moment later."""
        self._latch.append((self.now + 0.15, True))

    def approach(self) -> None:
        self.drive(-self.arm_reach)
        self.wait(self.manner.pause)

    def open(self) -> None:
        """Opens the panel by hand; backs off to pull."""
        self.take_handle(opening=True)
        self.swing_open()
        self.let_go()

    def swing_open(self) -> None:
        began = self.now
        self.turn_panel(self.manner.open_angle, self.manner.opening_time)
        if self.condition.must_pull:
            self._robot.move(began, -self._way * self.beyond_swing, self.now - began)

    def cross(self, position: float | None = None) -> None:
        """Drives through the doorway, as far as closing the door needs or to `position`."""
        self.now -= self.manner.overlap
        if position is None:
            position = self.arm_reach if self.condition.must_pull else self.beyond_swing
        self.drive(position)
        self.wait(self.manner.pause)

    def close(self) -> None:
        self.take_handle(opening=False)
        self.swing_closed()
        self.wait(0.2)
        self.let_go()
        self.lock()

    def slam(self) -> None:
        self.take_handle(opening=False)
        pushed = self.now
        self.turn_panel(0.0, self.manner.slam_time, Profile.FALL)
        shut, self.now = self.now, pushed + 0.2
        self.let_go()
        self.now = shut
        self.turn_panel(_REBOUND, 0.1)
        self.turn_panel(0.0, 0.1)
        self.lock()

    def swing_closed(self) -> None:
        self.turn_panel(0.0, self.manner.closing_time)

    def plan(self, *, latch: bool) -> MotionPlan:
        panel, grip = self._panel.motion(), self._grip.motion()
        hits = changes(panel.over(np.arange(0.0, panel.end + STEP, STEP)) < _FRAME)
        knocks = grip.segments and hits.size and self._panel.value < _FRAME
        return MotionPlan(
            condition=self.condition,
            body=self.body,
            robot=self._robot.motion(),
            panel=panel,
            tremors=tuple(self._tremors),
            grip=grip,
            knock=float(hits[-1]) if knocks else None,
            latch=tuple(self._latch) if latch else None,
        )


def plan_run(
    scenario: Scenario,
    condition: Condition | None,
    geometry: DoorGeometry,
    rng: Random,
    start_distance: float | None = None,
    *,
    latch: bool = False,
) -> MotionPlan:
    """Plans one run; the same state of `rng` gives the same plan.

    Two runs of one scenario differ a little. A `condition` of None draws one of the twenty. A
    `start_distance` of None is 1.5 m, or what is clear of the sensors.
    """
    drawn = Condition.from_number(rng.randint(1, 20)) if condition is None else condition
    usual = MANNERS.get(scenario, Manner())
    manner = replace(
        usual, open_angle=rng.uniform(1.0, 1.1), tremor_frequency=rng.uniform(7.0, 9.0)
    )
    performance = Performance(manner, drawn, RobotBody(), geometry, start_distance)
    SCRIPTS[scenario](performance)
    return performance.plan(latch=latch)


def _nominal(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross()
    robot.close()


def _slam(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross()
    robot.slam()


def _no_touch(robot: Performance) -> None:
    robot.approach()
    robot.unlock()
    robot.swing_open()
    robot.cross()
    robot.swing_closed()
    robot.lock()


def _touch_only(robot: Performance) -> None:
    robot.approach()
    robot.take_handle(opening=True)
    robot.let_go()
    robot.lock()


SCRIPTS: dict[Scenario, Callable[[Performance], None]] = {
    Scenario.NOMINAL: _nominal,
    Scenario.SLAM: _slam,
    Scenario.SLOW: _nominal,
    Scenario.NO_TOUCH: _no_touch,
    Scenario.TOUCH_ONLY: _touch_only,
    Scenario.WORN: _nominal,
}

MANNERS: dict[str, Manner] = {
    Scenario.SLOW: Manner(speed=0.15, opening_time=9.0, closing_time=9.0, pause=1.0)
}
