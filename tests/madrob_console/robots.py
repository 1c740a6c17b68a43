"""What only tests let a simulated robot do, drawn so that samples can tell what happened."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from random import Random
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from madrob_console.testbeds.simulated import Scenario, SensorSettings, SimulatedTestbed
from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.motion import STEP, MotionPlan, changes
from madrob_console.testbeds.simulated.scenarios import MANNERS, SCRIPTS, Manner, Performance
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, POST_ROLL, Condition, Side


class Robot(StrEnum):
    """What a robot does beside the scenarios; `RANDOM` is any of all, but for `WORN`."""

    JERKY = "jerky"
    OPEN_ONLY = "open-only"
    NO_CLOSE = "no-close"
    TURNS_BACK = "turns-back"
    CLOSES_UNDER_SENSORS = "closes-under-sensors"
    BOUNCES = "bounces"
    RANDOM = "random"


Played: TypeAlias = Scenario | Robot


@dataclass(frozen=True, slots=True)
class RobotManner(Manner):
    """How a robot acts, in s, m and rad.

    Attributes:
        turn_back_at: how far behind the threshold it turns back; negative = before it.
        bounce: how far the panel springs open again.
        closes_behind: whether it closes the door when it has turned back.
        leaves_after: from the closing until it leaves the sensors; negative = while the door
            closes, None = never.
    """

    turn_back_at: float = -0.05
    bounce: float = 0.25
    closes_behind: bool = True
    leaves_after: float | None = 2.0


Script: TypeAlias = Callable[[Performance, RobotManner], None]


def _jerky(robot: Performance, manner: RobotManner) -> None:
    robot.approach()
    robot.take_handle(opening=True)
    for part in (0.4, 0.33, 0.75):
        robot.turn_panel(part * manner.open_angle, manner.opening_time / 4)
    robot.swing_open()
    robot.let_go()
    for position in (-0.3, 0.4):
        robot.drive(position)
        robot.wait(0.3)
    robot.cross()
    robot.take_handle(opening=False)
    for part in (0.6, 0.65, 0.2):
        robot.turn_panel(part * manner.open_angle, manner.closing_time / 4)
    robot.swing_closed()
    robot.wait(0.2)
    robot.let_go()
    robot.lock()


def _open_only(robot: Performance, _manner: RobotManner) -> None:
    robot.approach()
    robot.open()


def _no_close(robot: Performance, _manner: RobotManner) -> None:
    robot.approach()
    robot.open()
    robot.cross()


def _turns_back(robot: Performance, manner: RobotManner) -> None:
    robot.approach()
    robot.open()
    robot.cross(manner.turn_back_at)
    robot.drive(-robot.beyond_swing)
    if manner.closes_behind:
        robot.close()


def _closes_under_sensors(robot: Performance, manner: RobotManner) -> None:
    robot.approach()
    robot.open()
    robot.cross(max(robot.body.length / 2 + 0.06, robot.geometry.sensor_distance))
    robot.close()
    if manner.leaves_after is not None:
        robot.wait(manner.leaves_after)
        robot.drive(robot.beyond_swing)


def _bounces(robot: Performance, manner: RobotManner) -> None:
    """It lets go of the closed panel too early: that springs open and falls shut again."""
    robot.approach()
    robot.open()
    robot.cross()
    robot.take_handle(opening=False)
    robot.swing_closed()
    shut = robot.now
    robot.let_go()
    robot.now = shut
    robot.turn_panel(manner.bounce, 0.35)
    robot.turn_panel(0.0, 0.45)
    robot.lock()


_SCRIPTS: dict[Played, Script] = {
    Robot.JERKY: _jerky,
    Robot.OPEN_ONLY: _open_only,
    Robot.NO_CLOSE: _no_close,
    Robot.TURNS_BACK: _turns_back,
    Robot.CLOSES_UNDER_SENSORS: _closes_under_sensors,
    Robot.BOUNCES: _bounces,
}
_MANNERS: dict[str, Manner] = {
    **MANNERS,
    Robot.JERKY: Manner(opening_time=5.0, closing_time=5.0, tremor=0.008),
    Robot.BOUNCES: Manner(closing_time=1.5),
}
EVERY: tuple[Played, ...] = (
    *(Scenario.NOMINAL, Robot.JERKY, Scenario.SLAM, Scenario.SLOW, Scenario.NO_TOUCH),
    *(Scenario.TOUCH_ONLY, Robot.OPEN_ONLY, Robot.NO_CLOSE, Robot.TURNS_BACK),
    *(Robot.CLOSES_UNDER_SENSORS, Robot.BOUNCES),
)
"""All but `WORN`, whose zeros move."""
_MIXTURE = (*EVERY, Scenario.NOMINAL, Scenario.NOMINAL)  # more of what most robots try
_ATTEMPTS = 100


def any_testbed(
    scenario: Played = Scenario.NOMINAL,
    seed: int = 0,
    geometry: DoorGeometry | None = None,
    sensors: SensorSettings | None = None,
) -> SimulatedTestbed:
    """A simulated testbed that plays any robot."""
    return SimulatedTestbed(scenario, seed, geometry, sensors, plan_run)


def plan_run(
    scenario: Played,
    condition: Condition | None,
    geometry: DoorGeometry,
    rng: Random,
    start_distance: float | None = None,
    *,
    latch: bool = False,
) -> MotionPlan:
    """Plans a run of any robot; one whose order depends on a single sample is drawn anew."""
    for _ in range(_ATTEMPTS):
        drawn = Condition.from_number(rng.randint(1, 20)) if condition is None else condition
        played, body = scenario, RobotBody()
        if scenario is Robot.RANDOM:
            played = rng.choice(_MIXTURE)
            body, manner = _any_body(geometry, rng), _any_manner(rng)
        else:
            manner = _varied(_MANNERS.get(scenario, Manner()), rng)
        robot = Performance(manner, drawn, body, geometry, start_distance)
        if isinstance(played, Scenario):
            SCRIPTS[played](robot)
        else:
            _SCRIPTS[played](robot, manner)
        plan = robot.plan(latch=latch)
        if is_clear_cut(plan, geometry):
            return plan
    raise AssertionError(f"no clear run of {scenario} in this doorway")


def _varied(usual: Manner, rng: Random) -> RobotManner:
    return RobotManner(
        **{name: getattr(usual, name) for name in Manner.__slots__}
        | {"open_angle": rng.uniform(1.0, 1.1), "tremor_frequency": rng.uniform(7.0, 9.0)},
        turn_back_at=rng.uniform(-0.15, 0.1),
        closes_behind=rng.random() < 0.5,
        bounce=rng.uniform(0.15, 0.35),
        leaves_after=rng.uniform(0.3, 3.0),
    )


def _any_manner(rng: Random) -> RobotManner:
    opening_time, closing_time = rng.uniform(1.5, 8.0), rng.uniform(1.2, 8.0)
    return RobotManner(
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


# Whether samples can tell a plan.


def openings(plan: MotionPlan, times: Array) -> Array:
    """As `MotionPlan.opening`, at many times."""
    angle = plan.panel.over(times)
    whole = angle.copy()
    for one in plan.tremors:
        grip = (np.minimum(times - one.start, one.end - times) / 0.2).clip(0.0, 1.0)
        hold = ((angle - one.still) / (one.full - one.still)).clip(0.0, 1.0)
        swing = np.sin(math.tau * one.frequency * (times - one.start))
        whole += one.amplitude * grip * hold * swing
    return whole


_MARGIN = 0.06
"""s between two events whose order matters, at least: two samples, their jitter, and more."""

_HEIGHT_MARGIN = 0.03
"""m by which a body must be taller or smaller than the limit for a robot."""


def is_clear_cut(plan: MotionPlan, geometry: DoorGeometry, timeout: float | None = None) -> bool:
    """Whether samples taken 20 ms apart cannot tell another story than the plan.

    False where two events whose order matters lie too close together, or a state is too short to be
    sampled. `timeout` (s since the start) and the end of the recording after it count as events.
    """
    thresholds, body, opening_side = geometry.thresholds, plan.body, plan.condition.opening_side
    if abs(body.height - thresholds.present_height) < _HEIGHT_MARGIN:
        return False
    times = np.arange(0.0, plan.end + 1.0, STEP)
    opening, x = openings(plan, times), plan.robot.over(times)
    reading = np.rint(opening / thresholds.encoder_count) * thresholds.encoder_count
    door = changes(reading >= thresholds.closed_angle)
    # the brake resists only a hand that holds the handle already, so the grip alone decides
    touch = changes(np.abs(plan.grip.over(times)) > thresholds.touch_force)[:1]
    latched = [time for time, _ in plan.latch or ()]
    sides: dict[Side, list[float]] = {side: [] for side in Side}
    clear = body.height > thresholds.present_height
    for sensor in PASSAGE_SENSORS:
        mount, (low, high) = geometry.mount(sensor), geometry.mask(sensor)
        seen = clear and geometry.covers(body, mount)
        present = (np.abs(x - mount.x) < geometry.half_view(body)) & seen
        masked = (low < reading) & (reading < high) & (sensor.side is opening_side)
        looked = np.maximum.accumulate(np.where(masked, 0, np.arange(times.size)))
        occupied, mask = changes(present[looked]), changes(masked)
        unmasked = zip(mask[1::2], mask[2::2], strict=False)
        if (
            not _apart(changes(present), mask)
            or any(until - since <= _MARGIN for since, until in unmasked if since in occupied)
            or (np.diff(occupied) <= _MARGIN).any()
        ):
            return False
        sides[sensor.side] += occupied.tolist()
    passages = [*sides[Side.CW], *sides[Side.CCW]]
    ends = [] if timeout is None else [timeout, timeout + POST_ROLL]
    closed = door[2::2] - door[1:-1:2]
    return bool(
        _apart(sides[Side.CW], sides[Side.CCW])
        and _apart(door, [*passages, *latched, *touch])
        and _apart(ends, [*passages, *door, *touch, *latched])
        and (np.diff(door) > _MARGIN).all()
        and (np.abs(closed - thresholds.settle_time) >= 2 * _MARGIN).all()
    )


def _apart(one: ArrayLike, other: ArrayLike) -> bool:
    between = np.abs(np.subtract.outer(one, other))
    return bool(between.min(initial=np.inf) > _MARGIN)
