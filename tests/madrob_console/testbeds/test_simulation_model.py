from __future__ import annotations

import math
import statistics
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
    EventName,
    Outcome,
    PassageSensor,
    Side,
    Signal,
    Step,
    Strip,
    Thresholds,
)
from tests.madrob_console.testbeds.brute_force import STEP, BruteForce
from tests.madrob_console.testbeds.truth import truth_of, truth_of_testbed

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


Moves = list[tuple[float, float, float]]


AJAR = (0.0, 0.5, 1.0)
"""At 0.5 rad the panel has passed the sensors 0 to 2 and masks 3 and 4."""


def test_a_robot_that_no_sample_could_judge_is_refused() -> None:
    waist_high = RobotSettings(RobotBody(height=0.51))
    with pytest.raises(MadrobError, match="no clear run of nominal"):
        plan_run(Scenario.NOMINAL, PULL, GEOMETRY, Random(0), waist_high)


def test_the_hand_pushes_the_panel_the_way_it_goes() -> None:
    for number in (1, 6):
        condition = Condition.from_number(number)
        plan = plan_run(Scenario.NOMINAL, condition, GEOMETRY, Random(0))
        opens = next(t for t in plan.panel.knots)
        closes = plan.panel.segments[-1].start
        sign = condition.opening_side.sign
        assert plan.contact(opens + 0.5) * sign > 2.0
        assert plan.contact(closes + 0.5) * sign < -2.0


def test_the_brake_is_felt_at_the_handle() -> None:
    forces = {}
    for benchmark in BenchmarkType:
        condition = Condition(benchmark, Side.CCW, Side.CCW)
        plan = plan_run(Scenario.NOMINAL, condition, GEOMETRY, Random(0))
        opening = plan.panel.segments[0]
        times = [opening.start + i * 0.01 for i in range(300)]
        forces[benchmark] = max(plan.contact(t) for t in times)
    assert forces[BenchmarkType.NO_FORCE] == 12.0
    assert forces[BenchmarkType.CONSTANT_FORCE] == pytest.approx(12.0 + 4000 * 0.00980665)
    assert forces[BenchmarkType.SUDDEN_RAMP] > 150.0


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


def test_a_run_moved_to_another_start_is_the_same_run() -> None:
    testbed = SimulatedTestbed(seed=3)
    testbed.start(START_NS)
    first, plan = truth_of_testbed(testbed), testbed.plan
    testbed.start(START_NS + 5 * 10**9)
    later = truth_of_testbed(testbed)
    assert testbed.plan is plan
    assert first is not None
    assert later is not None
    assert later.stop == pytest.approx(first.stop + 5.0)


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


PLAYED = [scenario for scenario in Scenario if scenario is not Scenario.RANDOM]


def check(plan: MotionPlan, timeout: float) -> None:
    """Compare the truth with what is seen of the plan every millisecond."""
    truth = truth_of(plan, GEOMETRY, timeout)
    seen = BruteForce(plan, GEOMETRY, max(plan.end, timeout) + 3.0)
    completed = seen.completed(timeout)
    assert truth.outcome is (Outcome.TIMEOUT if completed is None else Outcome.COMPLETED)
    assert truth.stop == pytest.approx(timeout if completed is None else completed, abs=2 * STEP)
    expected = seen.events(timeout if completed is None else completed)
    assert sorted(e.name for e in truth.events) == sorted(name for _, name in expected)
    times = {(name, i): t for i, (t, name) in enumerate(sorted(expected, key=lambda e: e[1]))}
    found = sorted(truth.events, key=lambda e: e.name)
    for i, event in enumerate(found):
        assert event.time == pytest.approx(times[event.name, i], abs=2 * STEP), event
    early = [t for t in seen.early_steps() if t <= truth.stop]
    for (_, time), brute in zip(truth.steps, early, strict=False):
        assert time == pytest.approx(brute, abs=2 * STEP)
    assert truth.capability_level >= len(early)


@pytest.mark.parametrize("latch", [False, True])
@pytest.mark.parametrize("condition", [PULL, PUSH], ids=["pull", "push"])
@pytest.mark.parametrize("scenario", PLAYED)
def test_the_truth_is_what_is_seen_every_millisecond(
    scenario: Scenario, condition: Condition, latch: bool
) -> None:
    plan = plan_run(scenario, condition, GEOMETRY, Random(1), latch=latch)
    check(plan, timeout=round(plan.end + 2.0, 3))


def test_so_it_is_for_robots_of_every_kind_and_at_every_timeout() -> None:
    check_robots(range(3))


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
def test_so_it_is_for_many_robots(part: int, request: pytest.FixtureRequest) -> None:
    """With `--runs 20` two hundred."""
    check_robots(range(3 + part, 3 + 10 * request.config.getoption("--runs"), 2))


def check_robots(seeds: range) -> None:
    for seed in seeds:
        plan = plan_run(Scenario.RANDOM, None, GEOMETRY, Random(seed), latch=seed % 3 == 0)
        for timeout in (plan.end + 2.0, *(Random(seed).uniform(2.0, plan.end) for _ in range(2))):
            if is_clear_cut(plan, GEOMETRY, timeout):
                check(plan, round(timeout, 3))


EXPECTED = {
    Scenario.NOMINAL: (Outcome.COMPLETED, 6),
    Scenario.JERKY: (Outcome.COMPLETED, 6),
    Scenario.SLAM: (Outcome.COMPLETED, 6),
    Scenario.SLOW: (Outcome.COMPLETED, 6),
    Scenario.NO_TOUCH: (Outcome.TIMEOUT, 0),
    Scenario.TOUCH_ONLY: (Outcome.TIMEOUT, 1),
    Scenario.OPEN_ONLY: (Outcome.TIMEOUT, 3),
    Scenario.NO_CLOSE: (Outcome.TIMEOUT, 4),
    Scenario.TURNS_BACK: (Outcome.TIMEOUT, 3),
    Scenario.CLOSES_UNDER_SENSORS: (Outcome.COMPLETED, 6),
    Scenario.BOUNCES: (Outcome.COMPLETED, 6),
}


@pytest.mark.parametrize("number", [1, 7, 13, 19])
@pytest.mark.parametrize("scenario", PLAYED)
def test_a_scenario_gets_as_far_as_its_name_says_from_either_side_and_to_either_side(
    scenario: Scenario, number: int
) -> None:
    condition = Condition.from_number(number)
    truth = truth_of(plan_run(scenario, condition, GEOMETRY, Random(number)), GEOMETRY, 90.0)
    assert (truth.outcome, truth.capability_level) == EXPECTED[scenario]
    assert [step for step, _ in truth.steps] == list(Step)[: truth.capability_level]
    names = [event.name for event in truth.events]
    assert names[0] is EventName.BENCHMARK_START
    assert names[-1] is EventName.BENCHMARK_STOP
    assert [e.time for e in truth.events] == sorted(e.time for e in truth.events)


@pytest.mark.parametrize("condition", [PULL, PUSH], ids=["pull", "push"])
def test_a_robot_that_closes_under_the_sensors_leaves_them_at_the_stop(
    condition: Condition,
) -> None:
    plan = plan_run(Scenario.CLOSES_UNDER_SENSORS, condition, GEOMETRY, Random(4))
    truth = truth_of(plan, GEOMETRY)
    arrives = EventName.moves_to(condition.destination_side)
    assert [e.time for e in truth.events if e.name is arrives] == [truth.stop]
    assert dict(truth.steps)[Step.CROSS] == truth.stop


def test_a_door_that_springs_open_is_closed_at_the_last_time() -> None:
    truth = truth_of(plan_run(Scenario.BOUNCES, PULL, GEOMETRY, Random(2)), GEOMETRY)
    closings = [e.time for e in truth.events if e.name is EventName.DOOR_CLOSES]
    assert len(closings) == 2
    assert closings[1] - closings[0] < GEOMETRY.thresholds.settle_time
    assert truth.stop == closings[1]


def test_a_robot_that_turns_back_returns_to_the_starting_side() -> None:
    for seed in range(5):
        truth = truth_of(plan_run(Scenario.TURNS_BACK, PUSH, GEOMETRY, Random(seed)), GEOMETRY)
        names = [event.name for event in truth.events]
        assert EventName.moves_to(PUSH.starting_side) in names
        assert EventName.moves_to(PUSH.destination_side) not in names


def test_a_timeout_in_the_settle_time_waits_for_its_end() -> None:
    plan = plan_run(Scenario.NOMINAL, PULL, GEOMETRY, Random(1))
    stop = truth_of(plan, GEOMETRY).stop
    assert truth_of(plan, GEOMETRY, stop + 0.5).outcome is Outcome.COMPLETED
    assert truth_of(plan, GEOMETRY, stop - 0.1).outcome is Outcome.TIMEOUT


def test_a_latch_sensor_decides_steps_2_and_6_unless_it_is_ignored() -> None:
    plan = plan_run(Scenario.NOMINAL, PULL, GEOMETRY, Random(1), latch=True)
    assert plan.latch is not None
    (unlocked, _), (locked, _) = plan.latch
    decided = truth_of(plan, GEOMETRY)
    assert dict(decided.steps)[Step.UNLOCK] == unlocked
    assert dict(decided.steps)[Step.LOCK] == decided.stop == locked
    ignored = truth_of(plan, GEOMETRY, latch_decides=False)
    steps = dict(ignored.steps)
    assert steps[Step.UNLOCK] == steps[Step.OPEN]
    assert steps[Step.LOCK] == steps[Step.CLOSE] == ignored.stop < locked
