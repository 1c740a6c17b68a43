from __future__ import annotations

import math
import statistics
from functools import cache
from itertools import pairwise
from random import Random

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.testbeds.simulated import (
    DoorGeometry,
    MotionPlan,
    RobotBody,
    RobotSettings,
    Scenario,
    SensorSettings,
    SimulatedTestbed,
    plan_run,
)
from madrob_console.testbeds.simulated.geometry import LOAD_CELL_LIMIT, Profile
from madrob_console.testbeds.simulated.scenarios import Manner, Performance
from madrob_console.testbeds.simulated.sensor_model import Scene, SensorModel, is_clear_cut
from scoring.protocol import (
    PASSAGE_SENSORS,
    BenchmarkType,
    Condition,
    PassageSensor,
    Side,
    Signal,
    Strip,
    Thresholds,
)

GEOMETRY = DoorGeometry()
START_NS = 1_700_000_000_000_000_000
PULL, PUSH = Condition.from_number(1), Condition.from_number(6)


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


def test_sixteen_sensors_hang_where_the_protocol_counts_them() -> None:
    assert len({(m.strip, m.element) for m in GEOMETRY.mounts}) == 16
    for side in Side:
        used = [GEOMETRY.mount(s) for s in PASSAGE_SENSORS if s.side is side]
        assert all(mount.side is side and mount.strip.side is side for mount in used)
        reaches = [mount.reach for mount in used]
        assert reaches == sorted(reaches, reverse=True), "index 0 is the farthest from the hinge"
        row = [m.reach for m in GEOMETRY.mounts if m.side is side]
        assert row[:5] == reaches
        assert 0 < min(row) < max(row) < GEOMETRY.doorway_width


def test_a_doorway_that_does_not_fit_the_masks_is_refused() -> None:
    with pytest.raises(MadrobError, match="outside of their masks"):
        SimulatedTestbed(geometry=DoorGeometry(sensor_distance=0.4))


STEEPEST = {Profile.MINIMUM_JERK: 1.875, Profile.FALL: 2.0}
"""The highest speed of a move, times its mean."""


@cache
def any_plan(seed: int) -> MotionPlan:
    return plan_run(Scenario.RANDOM, None, GEOMETRY, Random(seed))


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


def test_random_runs_are_of_every_kind() -> None:
    plans = [any_plan(seed) for seed in range(80)]
    assert {plan.scenario for plan in plans} == set(Scenario) - {Scenario.RANDOM}
    assert len({plan.condition.number for plan in plans}) == 20
    assert min(plan.body.height for plan in plans) < 0.9
    assert max(plan.body.height for plan in plans) > 1.7


def test_no_slam_is_faster_than_the_masks_can_follow() -> None:
    hasty = Manner(slam_time=0.05, opening_time=0.1)
    robot = Performance(hasty, PUSH, RobotBody(), GEOMETRY)
    robot.open()
    robot.slam()
    segments = robot.plan(Scenario.SLAM, latch=False).panel.segments
    fastest = max(
        STEEPEST[s.profile] * abs(s.target - s.origin) / (s.end - s.start) for s in segments
    )
    assert 2.0 < fastest < GEOMETRY.fastest_panel


def test_a_robot_that_no_sample_could_judge_is_refused() -> None:
    waist_high = RobotSettings(RobotBody(height=0.51))
    with pytest.raises(MadrobError, match="no clear run of nominal"):
        plan_run(Scenario.NOMINAL, PULL, GEOMETRY, Random(0), waist_high)


@pytest.mark.parametrize("condition", [PULL, PUSH], ids=["pull", "push"])
def test_the_hand_pushes_the_panel_the_way_it_goes(condition: Condition) -> None:
    plan = plan_run(Scenario.NOMINAL, condition, GEOMETRY, Random(0))
    sign = condition.opening_side.sign
    assert plan.contact(plan.panel.segments[0].start + 0.5) * sign > 2.0
    assert plan.contact(plan.panel.segments[-1].start + 0.5) * sign < -2.0


@pytest.mark.parametrize(
    ("benchmark", "most"),
    [
        (BenchmarkType.NO_FORCE, 12.0),
        (BenchmarkType.CONSTANT_FORCE, pytest.approx(12.0 + 4000 * 0.00980665)),
        (BenchmarkType.SUDDEN_RAMP, LOAD_CELL_LIMIT),
    ],
)
def test_the_brake_is_felt_at_the_handle(benchmark: BenchmarkType, most: float) -> None:
    condition = Condition(benchmark, Side.CCW, Side.CCW)
    plan = plan_run(Scenario.NOMINAL, condition, GEOMETRY, Random(0))
    opening = plan.panel.segments[0]
    assert max(plan.contact(opening.start + i * 0.01) for i in range(300)) == most


def read_ranges(scene: Scene, strip: Strip, settings: SensorSettings) -> tuple[float, ...]:
    ranges = SensorModel(GEOMETRY, settings, seed=0).read(Signal.of_strip(strip), scene)
    assert isinstance(ranges, tuple)
    return ranges


def test_lasers_see_the_floor_the_robot_and_the_panel() -> None:
    still = SensorSettings(range_noise=0.0)
    assert read_ranges(Scene(), Strip.CCW_LEFT, still) == (2.0,) * 4
    robot = Scene(RobotBody(width=0.5, height=1.2, shift=0.25), x=0.175)
    assert read_ranges(robot, Strip.CCW_LEFT, still) == pytest.approx((0.8,) * 4)
    assert read_ranges(robot, Strip.CCW_RIGHT, still) == (2.0,) * 4, "nearer to the hinge"
    assert read_ranges(robot, Strip.CW_RIGHT, still) == (2.0,) * 4, "on the other side"
    panel = Scene(angle=0.2)
    assert read_ranges(panel, Strip.CCW_LEFT, still) == pytest.approx((2.0, 0.05, 0.05, 0.05))
    assert read_ranges(panel, Strip.CW_RIGHT, still) == (2.0,) * 4
    assert read_ranges(Scene(angle=-0.2), Strip.CW_RIGHT, still)[3] == pytest.approx(0.05)


def test_readings_have_the_stated_noise() -> None:
    testbed = SimulatedTestbed(seed=1)
    readings = [testbed.read(Signal.HANDLE, START_NS + i) for i in range(2000)]
    forces = [force for force in readings if isinstance(force, float)]
    assert statistics.mean(forces) == pytest.approx(5.9, abs=0.01)
    assert statistics.stdev(forces) == pytest.approx(0.05, rel=0.1)


def test_every_repetition_of_a_seed_is_its_own_and_comes_back() -> None:
    plans = []
    for _ in range(2):
        testbed = SimulatedTestbed(Scenario.RANDOM, seed=8)
        for _ in range(3):
            testbed.reset()
            testbed.reset()  # sent back twice is sent back once
            testbed.start(START_NS)
            plans.append(testbed.plan)
    assert plans[:3] == plans[3:]
    assert plans[0] != plans[1] != plans[2]


def test_the_condition_is_drawn_unless_it_is_set() -> None:
    testbed = SimulatedTestbed(seed=1)
    testbed.set_condition(PUSH)
    testbed.start(START_NS)
    assert testbed.plan is not None
    assert testbed.plan.condition == PUSH
    drawn = set()
    for seed in range(20):
        testbed = SimulatedTestbed(seed=seed)
        testbed.start(START_NS)
        assert testbed.plan is not None
        drawn.add(testbed.plan.condition)
    assert len(drawn) > 5
