"""A testbed over ROS whose robot swings the door to and fro until it has had enough.

    python -m tests.benchmarks.swinging_door <messages/s on all topics together>

serves it in the domain of `ROS_DOMAIN_ID` until it is ended.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from random import Random

from madrob_console.common.clock import Clock
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.simulated import SensorSettings, SimulatedTestbed
from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.motion import MotionPlan
from madrob_console.testbeds.simulated.scenarios import Manner, Performance
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.simulated_node import serve_testbed
from scoring.protocol import Condition
from tests.madrob_console.engine.drive import PULL, Drive

LONGEST, SERVED = 640.0, 200.0  # s
WIDE, NARROW, SWING = 1.05, 0.4, 6.0  # rad, rad, s
TOPICS = 6


def plan_swings(
    _scenario: object,
    condition: Condition | None,
    geometry: DoorGeometry,
    _random: Random,
    start_distance: float | None = None,
    *,
    latch: bool = False,
    duration: float = LONGEST,
) -> MotionPlan:
    """The robot takes the handle and swings the open door for so long, s."""
    robot = Performance(Manner(), condition or PULL, RobotBody(), geometry, start_distance)
    robot.approach()
    robot.take_handle(opening=True)
    while robot.now < duration:
        robot.turn_panel(WIDE, SWING)
        robot.turn_panel(NARROW, SWING)
    robot.let_go()
    return robot.plan(latch=latch)


class SwingingSource(SimulatedSource):
    """Its robot swings the door, whatever it was to play."""

    def __init__(
        self,
        testbed: SimulatedTestbed | None,
        clock: Clock,
        types: MessageTypes,
        mappings: Sequence[TopicMapping] = DEFAULT_MAPPINGS,
    ) -> None:
        del testbed
        super().__init__(SimulatedTestbed(plan=plan_swings), clock, types, mappings)


class SwingingDrive(Drive):
    """A referee at it, in virtual time."""

    SOURCE = SwingingSource


if __name__ == "__main__":
    sensors = SensorSettings(rate=float(sys.argv[1]) / TOPICS)
    plan = partial(plan_swings, duration=SERVED)  # a long one takes seconds to be planned
    serve_testbed(SimulatedTestbed(sensors=sensors, plan=plan), PULL, 0, say=print)
