from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from random import Random

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.testbeds.simulated import (
    DoorGeometry,
    MotionPlan,
    SimulatedTestbed,
)
from madrob_console.testbeds.simulated.motion import LOAD_CELL_LIMIT
from scoring.protocol import (
    PASSAGE_SENSORS,
    PassageSensor,
    Side,
    Thresholds,
)
from tests.madrob_console.robots import Robot, is_clear_cut, plan_run

GEOMETRY = DoorGeometry()


@pytest.mark.parametrize("sensor", PASSAGE_SENSORS, ids=lambda s: f"{s.side}{s.index}")
def test_a_sensor_sees_the_panel_only_well_inside_of_its_mask(sensor: PassageSensor) -> None:
    thresholds, mount = Thresholds(), GEOMETRY.mount(sensor)
    upper = thresholds.mask_to_cw if sensor.side is Side.CW else thresholds.mask_to_ccw
    low, high = thresholds.mask_from[sensor.index] / 0.5, upper[sensor.index] / 1.125
    angles = [i * 0.0005 for i in range(-3142, 3143)]
    seen = [a for a in angles if GEOMETRY.sees_panel(mount, math.sin(a), math.cos(a))]
    assert seen, "the panel does pass under it"
    for angle in seen:
        assert low < angle * sensor.side.sign < high
        assert thresholds.masked(sensor.side, sensor.index, angle)
    stated = GEOMETRY.panel_seen(mount)
    assert stated == pytest.approx((min(map(abs, seen)), max(map(abs, seen))), abs=0.001)


def test_a_doorway_that_does_not_fit_the_masks_is_refused() -> None:
    with pytest.raises(MadrobError, match="outside of their masks"):
        SimulatedTestbed(geometry=DoorGeometry(sensor_distance=0.4))


@cache
def any_plan(seed: int) -> MotionPlan:
    return plan_run(Robot.RANDOM, None, GEOMETRY, Random(seed))


@pytest.mark.parametrize("seed", range(30))
def test_no_robot_is_seen_before_it_sets_out_nor_turns_the_panel_too_fast(seed: int) -> None:
    plan = any_plan(seed)
    assert is_clear_cut(plan, GEOMETRY)
    side = plan.condition.starting_side
    assert plan.robot.initial * side.sign > GEOMETRY.clear_distance(plan.body)
    assert plan.robot.at(0.5) == plan.robot.initial
    times = [i * 0.005 for i in range(int(plan.end / 0.005) + 1)]
    speeds = [abs(plan.opening(b) - plan.opening(a)) / 0.005 for a, b in pairwise(times)]
    assert max(speeds) < GEOMETRY.fastest_panel
    assert min(plan.opening(t) for t in times) >= 0.0
    assert max(abs(plan.contact(t)) for t in times) <= LOAD_CELL_LIMIT
