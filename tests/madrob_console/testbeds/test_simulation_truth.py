from __future__ import annotations

from random import Random

import pytest

from madrob_console.testbeds.simulated import DoorGeometry, MotionPlan, Scenario, plan_run
from madrob_console.testbeds.simulated.perception import is_clear_cut
from scoring.protocol import Condition, EventName, Outcome, Step
from tests.madrob_console.testbeds.brute_force import STEP, BruteForce
from tests.madrob_console.testbeds.truth import truth_of

GEOMETRY = DoorGeometry()
PULL, PUSH = Condition.from_number(1), Condition.from_number(6)
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


def test_the_truth_can_be_told_in_absolute_time() -> None:
    truth = truth_of(plan_run(Scenario.NOMINAL, PULL, GEOMETRY, Random(1)), GEOMETRY)
    late = truth.since(1000.0)
    assert late.stop == truth.stop + 1000.0
    assert late.events[0].time == 1000.0
    assert late.steps[0][1] == truth.steps[0][1] + 1000.0
    assert late.outcome is truth.outcome
