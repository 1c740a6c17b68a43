"""The scenarios and the choice of manner, body and condition for one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from random import Random

from madrob_console.errors import MadrobError
from madrob_console.kinds import Scenario
from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.perception import is_clear_cut
from madrob_console.testbeds.simulated.performance import Manner, Performance
from madrob_console.testbeds.simulated.plan import MotionPlan
from scoring.protocol import Condition

_ATTEMPTS = 100


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """What a user may fix of the simulated robot.

    Attributes:
        body: its size; a random scenario draws its own.
        reaction: from the start until it sets out, s.
        start_distance: of its middle from the threshold at the start, m; None = 1.5 m, or as
            much as it takes to be clear of the sensors.
    """

    body: RobotBody = field(default_factory=RobotBody)
    reaction: float = 0.5
    start_distance: float | None = None


def plan_run(
    scenario: Scenario,
    condition: Condition | None,
    geometry: DoorGeometry,
    rng: Random,
    robot: RobotSettings | None = None,
    *,
    latch: bool = False,
) -> MotionPlan:
    """Plan one run.

    Two runs of one scenario differ a little, as a robot's do. A plan in which the order of two
    events hangs on a single sample is thrown away and drawn anew, so that the truth is plain.

    Args:
        scenario: what the robot does; `RANDOM` draws scenario, manner and body.
        condition: None draws one of the twenty.
        geometry: the doorway.
        rng: where everything drawn comes from; the same state gives the same plan.
        robot: what is fixed of the robot.
        latch: whether the testbed has a latch sensor.

    Raises:
        MadrobError: the doorway and the robot leave no plan with a plain truth.
    """
    settings = robot or RobotSettings()
    for _ in range(_ATTEMPTS):
        drawn = Condition.from_number(rng.randint(1, 20)) if condition is None else condition
        plan = _draw(scenario, drawn, geometry, rng, settings, latch=latch)
        if is_clear_cut(plan, geometry):
            return plan
    raise MadrobError(
        f"no clear run of {scenario} in this doorway: give the robot or the sensors more room"
    )


def _draw(
    scenario: Scenario,
    condition: Condition,
    geometry: DoorGeometry,
    rng: Random,
    settings: RobotSettings,
    *,
    latch: bool,
) -> MotionPlan:
    if scenario is Scenario.RANDOM:
        played = rng.choice(_MIXTURE)
        body, manner = _any_body(geometry, rng), _any_manner(rng)
    else:
        played, body = scenario, settings.body
        manner = _varied(_MANNERS.get(scenario, Manner()), rng)
    clear = geometry.clear_distance(body) + 0.1
    manner = replace(
        manner,
        reaction=settings.reaction,
        start_distance=max(settings.start_distance or 1.5, clear),
    )
    performance = Performance(manner, condition, body, geometry)
    _SCRIPTS[played](performance)
    return performance.plan(played, latch=latch)


def _varied(manner: Manner, rng: Random) -> Manner:
    """The manner with what differs between two runs of one robot."""
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
}

_MANNERS = {
    Scenario.JERKY: Manner(opening_time=5.0, closing_time=5.0, tremor=0.008),
    Scenario.SLOW: Manner(speed=0.15, opening_time=9.0, closing_time=9.0, pause=1.0),
    Scenario.BOUNCES: Manner(closing_time=1.5),
}

_MIXTURE = (*_SCRIPTS, Scenario.NOMINAL, Scenario.NOMINAL)
"""What `RANDOM` draws from: more of what most robots try."""
