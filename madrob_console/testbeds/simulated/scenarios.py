"""The scenarios: what a simulated robot does, and how, for each run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random

import numpy as np

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario
from madrob_console.testbeds.simulated.geometry import (
    STEP,
    DoorGeometry,
    MotionPlan,
    Profile,
    RobotBody,
    Track,
    Tremor,
    changes,
)
from madrob_console.testbeds.simulated.sensor_model import is_clear_cut
from scoring.protocol import Condition

# The scenarios, act by act: what a simulated robot does and how.


_GRIP_RISE = 0.15
"""s in which a hand closes or opens."""
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
        start_distance: of its middle from the threshold at the start.
        overlap: how long before the panel is open a robot that pushes drives on.
        turn_back_at: how far behind the threshold it turns back; negative = before it.
        leaves_after: from the closing until it leaves the sensors; negative = while the door
            closes, None = never.
    """

    reaction: float = 0.5
    start_distance: float = 1.5
    speed: float = 0.5
    open_angle: float = 1.05
    opening_time: float = 3.0
    closing_time: float = 3.0
    pause: float = 0.4
    grip: float = 12.0
    tremor: float = 0.002
    tremor_frequency: float = 8.0
    overlap: float = 0.0
    turn_back_at: float = -0.05
    bounce: float = 0.25
    closes_behind: bool = True
    slam_time: float = 0.9
    leaves_after: float | None = 2.0


class Performance:
    """Builds a motion plan, one act after the other.

    Positions are counted along the robot's way: 0 = threshold, positive = destination side.
    """

    def __init__(
        self, manner: Manner, condition: Condition, body: RobotBody, geometry: DoorGeometry
    ) -> None:
        self.manner = manner
        self.condition = condition
        self.body = body
        self.geometry = geometry
        self.now = manner.reaction
        self._way = condition.destination_side.sign
        self._opening = condition.opening_side.sign
        self._robot = Track(-self._way * manner.start_distance)
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

    def drive(self, position: float, hops: int = 1) -> None:
        origin = self._way * self._robot.value
        for hop in range(1, hops + 1):
            target = origin + (position - origin) * hop / hops
            duration = max(0.3, abs(position - origin) / hops / self.manner.speed)
            self.now = self._robot.move(self.now, self._way * target, duration)
            if hop < hops:
                self.wait(0.3)

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

    def open(self, *stages: float) -> None:
        """Opens the panel by hand, over `stages` (rad) to the end; backs off to pull."""
        self.take_handle(opening=True)
        self.swing_open(*stages)
        self.let_go()

    def swing_open(self, *stages: float) -> None:
        began = self.now
        way = (*stages, self.manner.open_angle)
        for angle in way:
            self.turn_panel(angle, self.manner.opening_time / len(way))
        if self.condition.must_pull:
            self._robot.move(began, -self._way * self.beyond_swing, self.now - began)

    def cross(self, position: float | None = None, hops: int = 1) -> None:
        """Drives through the doorway, as far as closing the door needs or to `position`."""
        self.now -= self.manner.overlap
        if position is None:
            position = self.arm_reach if self.condition.must_pull else self.beyond_swing
        self.drive(position, hops)
        self.wait(self.manner.pause)

    def close(self, *stages: float) -> None:
        self.take_handle(opening=False)
        self.swing_closed(*stages)
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

    def bounce(self) -> None:
        """Closes the panel and lets go too early: it springs open and falls shut again."""
        self.take_handle(opening=False)
        self.swing_closed()
        shut = self.now
        self.let_go()
        self.now = shut
        self.turn_panel(self.manner.bounce, 0.35)
        self.turn_panel(0.0, 0.45)
        self.lock()

    def swing_closed(self, *stages: float) -> None:
        way = (*stages, 0.0)
        for angle in way:
            self.turn_panel(angle, self.manner.closing_time / len(way))

    def plan(self, scenario: Scenario, *, latch: bool) -> MotionPlan:
        panel, grip = self._panel.motion(), self._grip.motion()
        hits = changes(panel.over(np.arange(0.0, panel.end + STEP, STEP)) < _FRAME)
        knocks = grip.segments and hits.size and self._panel.value < _FRAME
        return MotionPlan(
            scenario=scenario,
            condition=self.condition,
            body=self.body,
            robot=self._robot.motion(),
            panel=panel,
            tremors=tuple(self._tremors),
            grip=grip,
            knock=float(hits[-1]) if knocks else None,
            latch=tuple(self._latch) if latch else None,
        )


_ATTEMPTS = 100


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

    Two runs of one scenario differ a little. A plan in which the order of two events depends on a
    single sample is drawn anew, so that the truth is plain. A `condition` of None draws one of the
    twenty. A `start_distance` of None is 1.5 m, or what is clear of the sensors.

    Raises:
        MadrobError: the doorway and the robot leave no plan with a plain truth.
    """
    for _ in range(_ATTEMPTS):
        drawn = Condition.from_number(rng.randint(1, 20)) if condition is None else condition
        plan = _draw(scenario, drawn, geometry, rng, start_distance, latch=latch)
        if is_clear_cut(plan, geometry):
            return plan
    raise MadrobError(f"no clear run of {scenario} in this doorway: give the sensors more room")


def _draw(
    scenario: Scenario,
    condition: Condition,
    geometry: DoorGeometry,
    rng: Random,
    start_distance: float | None,
    *,
    latch: bool,
) -> MotionPlan:
    if scenario is Scenario.RANDOM:
        played = rng.choice(_MIXTURE)
        body, manner = _any_body(geometry, rng), _any_manner(rng)
    else:
        played, body = scenario, RobotBody()
        manner = _varied(_MANNERS.get(scenario, Manner()), rng)
    clear = geometry.clear_distance(body) + 0.1
    manner = replace(manner, start_distance=max(start_distance or 1.5, clear))
    performance = Performance(manner, condition, body, geometry)
    _SCRIPTS[played](performance)
    return performance.plan(played, latch=latch)


def _varied(manner: Manner, rng: Random) -> Manner:
    return replace(
        manner,
        open_angle=rng.uniform(1.0, 1.1),
        tremor_frequency=rng.uniform(7.0, 9.0),
        turn_back_at=rng.uniform(-0.15, 0.1),
        closes_behind=rng.random() < 0.5,
        bounce=rng.uniform(0.15, 0.35),
        leaves_after=rng.uniform(0.3, 3.0),
    )


def _any_manner(rng: Random) -> Manner:
    opening_time, closing_time = rng.uniform(1.5, 8.0), rng.uniform(1.2, 8.0)
    return Manner(
        speed=rng.uniform(0.2, 1.0),
        open_angle=rng.uniform(0.85, 1.5),
        opening_time=opening_time,
        closing_time=closing_time,
        pause=rng.uniform(0.0, 2.0),
        grip=rng.uniform(6.0, 60.0),
        tremor=rng.uniform(0.0, 0.006),
        tremor_frequency=rng.uniform(4.0, 10.0),
        overlap=rng.choice([0.0, rng.uniform(0.0, opening_time)]),
        turn_back_at=rng.uniform(-0.2, 0.2),
        bounce=rng.uniform(0.15, 0.35),
        closes_behind=rng.random() < 0.5,
        slam_time=rng.uniform(0.8, 1.3),
        leaves_after=rng.choice([None, rng.uniform(-closing_time, 3.0)]),
    )


def _any_body(geometry: DoorGeometry, rng: Random) -> RobotBody:
    width = rng.uniform(0.35, 0.6)
    room = max(0.0, (geometry.doorway_width - width) / 2)
    return RobotBody(
        length=rng.uniform(0.3, 1.0),
        width=width,
        height=rng.uniform(0.7, 1.9),
        shift=rng.uniform(0.3, 1.0) * room,
    )


def _nominal(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross()
    robot.close()


def _jerky(robot: Performance) -> None:
    angle = robot.manner.open_angle
    robot.approach()
    robot.open(0.4 * angle, 0.33 * angle, 0.75 * angle)
    robot.cross(hops=3)
    robot.close(0.6 * angle, 0.65 * angle, 0.2 * angle)


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


def _open_only(robot: Performance) -> None:
    robot.approach()
    robot.open()


def _no_close(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross()


def _turns_back(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross(robot.manner.turn_back_at)
    robot.drive(-robot.beyond_swing)
    if robot.manner.closes_behind:
        robot.close()


def _closes_under_sensors(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross(max(robot.body.length / 2 + 0.06, robot.geometry.sensor_distance))
    robot.close()
    if robot.manner.leaves_after is not None:
        robot.wait(robot.manner.leaves_after)
        robot.drive(robot.beyond_swing)


def _bounces(robot: Performance) -> None:
    robot.approach()
    robot.open()
    robot.cross()
    robot.bounce()


_SCRIPTS: dict[Scenario, Callable[[Performance], None]] = {
    Scenario.NOMINAL: _nominal,
    Scenario.JERKY: _jerky,
    Scenario.SLAM: _slam,
    Scenario.SLOW: _nominal,
    Scenario.NO_TOUCH: _no_touch,
    Scenario.TOUCH_ONLY: _touch_only,
    Scenario.OPEN_ONLY: _open_only,
    Scenario.NO_CLOSE: _no_close,
    Scenario.TURNS_BACK: _turns_back,
    Scenario.CLOSES_UNDER_SENSORS: _closes_under_sensors,
    Scenario.BOUNCES: _bounces,
    Scenario.WORN: _nominal,
}

_MANNERS = {
    Scenario.JERKY: Manner(opening_time=5.0, closing_time=5.0, tremor=0.008),
    Scenario.SLOW: Manner(speed=0.15, opening_time=9.0, closing_time=9.0, pause=1.0),
    Scenario.BOUNCES: Manner(closing_time=1.5),
}

_MIXTURE = (*tuple(_SCRIPTS)[:-1], Scenario.NOMINAL, Scenario.NOMINAL)
"""What `RANDOM` draws from, all but `WORN`: more of what most robots try."""
