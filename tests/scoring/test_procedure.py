"""The six steps and the capability level (protocol section 7)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from scoring.evaluate import Assessment
from scoring.procedure import Procedure, Ruling
from scoring.protocol import LockDetection, Side, Step
from scoring.signals import Sample
from tests.scoring.runs import (
    CONDITION,
    START,
    assessment,
    clear,
    door,
    handle,
    latch,
    passage_through,
    under,
)


def times(procedure: Procedure) -> list[float | None]:
    return [None if s.final is None else round(s.final - START, 6) for s in procedure.steps]


def until(samples: list[Sample], time: float) -> Assessment:
    return assessment([s for s in samples if s.time <= START + time])


def ruling(step: Step, confirmed: bool | None, time: float = 20.0) -> Ruling:
    return Ruling(step, confirmed, START + time, "seen", "R. Eferee")


def test_a_whole_run_completes_at_the_time_of_closing() -> None:
    run = assessment(passage_through())
    assert run.procedure().completed == START + 6
    assert times(run.procedure(stop=START + 6)) == [2, 3, 3, 5, 6, 6]
    assert run.procedure(stop=START + 6).level == 6


def test_step_six_waits_for_the_settle_time() -> None:
    run = until(passage_through(), 6.5)
    assert run.procedure().settling
    assert run.procedure().completed is None
    assert until(passage_through(), 7.0).procedure().completed == START + 6


def test_a_door_that_springs_open_within_the_settle_time_is_not_locked() -> None:
    samples = [*passage_through()[:-1], door(6.5, 0.2), door(7.5, 0.2)]
    procedure = assessment(samples).procedure()
    assert procedure.level == 4
    closed = [*samples, door(8, 0.0), door(9, 0.0)]
    assert times(assessment(closed).procedure(stop=START + 8)) == [2, 3, 3, 5, 8, 8]


def test_steps_count_only_in_order() -> None:
    untouched = [s for s in passage_through() if s.signal.name != "HANDLE"]
    assert assessment(untouched).procedure(stop=START + 9).level == 0


def test_a_door_opened_before_the_touch_counts_from_the_touch() -> None:
    samples = [door(1.0, 0.5), *passage_through()[2:]]
    assert times(assessment(samples).procedure())[:3] == [2, 2, 2]


def test_a_door_closed_again_before_the_touch_does_not_count() -> None:
    samples: list[Sample] = [door(0.5, 0.5), door(1, 0.0), handle(2, 9)]
    assert times(assessment(samples).procedure())[:3] == [2, None, None]


def test_a_robot_that_turns_back_has_not_crossed() -> None:
    samples: list[Sample] = [
        handle(2, 9), door(3, 0.5), under(4, Side.CCW), under(4.4, Side.CW),
        clear(5, Side.CW), clear(6, Side.CCW), door(7, 0.0), door(9, 0.0),
    ]  # fmt: skip
    run = assessment(samples)
    assert run.procedure().level == 3
    assert run.procedure(stop=START + 9).level == 3


def test_a_robot_that_closes_under_the_sensors_completes_at_the_closing() -> None:
    samples = [s for s in passage_through() if s.time != START + 5]
    run = assessment(samples)
    assert run.procedure().completed == START + 6
    assert times(run.procedure(stop=START + 6)) == [2, 3, 3, 6, 6, 6]
    left = assessment([*samples, clear(7.5, Side.CW)])
    assert times(left.procedure(stop=START + 6)) == [2, 3, 3, 6, 6, 6]


def test_while_the_starting_side_is_occupied_the_robot_is_not_through() -> None:
    run = until(passage_through(), 4.5)
    assert run.procedure().level == 3
    assert until(passage_through(), 4.7).procedure().level == 4


def test_somebody_on_the_destination_side_before_the_opening_is_no_crossing() -> None:
    samples: list[Sample] = [under(1, Side.CW), handle(2, 9), door(3, 0.5), door(4, 0.0)]
    assert assessment(samples).procedure().level == 3


def test_a_latch_that_spoke_before_the_start_decides_unlocking_and_locking() -> None:
    samples = passage_through()
    samples[1:1] = [latch(-0.5, True)]
    samples += [latch(7.5, True)]
    samples.sort(key=lambda s: s.time)
    never_unlocked = assessment(samples)
    assert never_unlocked.procedure().level == 1
    samples += [latch(2.6, False)]
    samples.sort(key=lambda s: s.time)
    run = assessment(samples)
    assert times(run.procedure()) == [2, 2.6, 3, 4.6, 6, 7.5]
    assert times(run.procedure(stop=START + 7.5)) == [2, 2.6, 3, 5, 6, 7.5]


def test_settle_ignores_the_latch() -> None:
    samples = sorted([*passage_through(), latch(-0.5, True)], key=lambda s: s.time)
    assert assessment(samples, lock=LockDetection.SETTLE).procedure().completed == START + 6


def test_under_referee_only_the_referee_stops_the_run() -> None:
    run = assessment([*passage_through(), door(30, 0.0)], lock=LockDetection.REFEREE)
    assert run.procedure().completed is None
    confirmed = run.procedure([ruling(Step.LOCK, True, 12.0)])
    assert confirmed.completed == START + 12


def test_the_sensor_mode_without_a_value_leaves_it_to_the_referee() -> None:
    run = assessment(passage_through(), lock=LockDetection.SENSOR)
    assert run.procedure().completed is None
    assert "referee" in (run.procedure().steps[-1].reason or "")


@pytest.mark.parametrize("step", list(Step))
def test_a_denied_step_ends_the_chain_and_keeps_the_automatic_finding(step: Step) -> None:
    procedure = assessment(passage_through()).procedure([ruling(step, False)], stop=START + 6)
    assert procedure.level == step - 1
    assert all(record.sensors is not None for record in procedure.steps)
    assert procedure.steps[step - 1].reason == "denied by the referee: seen"


def test_a_confirmed_step_lets_the_later_ones_count_at_their_own_times() -> None:
    untouched = [s for s in passage_through() if s.signal.name != "HANDLE"]
    run = assessment(untouched)
    procedure = run.procedure([ruling(Step.TOUCH, True)], stop=START + 6)
    assert times(procedure) == [0, 3, 3, 5, 6, 6]
    assert [record.sensors for record in procedure.steps] == [None] * 6


def test_the_latest_ruling_counts() -> None:
    rulings = [ruling(Step.CROSS, False, 10), ruling(Step.CROSS, True, 11)]
    assert assessment(passage_through()).procedure(rulings, stop=START + 6).level == 6


def test_a_ruling_taken_back_leaves_what_the_sensors_say() -> None:
    run = assessment(passage_through())
    taken_back = [ruling(Step.CROSS, False), ruling(Step.CROSS, None)]
    assert run.procedure(taken_back, stop=START + 6) == run.procedure((), stop=START + 6)


def test_a_step_confirmed_against_an_open_door_does_not_lock_it() -> None:
    samples = [s for s in passage_through() if s.time < START + 6]
    run = assessment([*samples, door(9, 0.5)])
    assert run.procedure([ruling(Step.CLOSE, True, 8)]).completed is None


def test_times_of_steps_never_go_back() -> None:
    samples = [*passage_through(), latch(-0.5, False)]
    for stop in (2.5, 4.5, 5.5, 6.0, 8.0):
        found = times(
            assessment(sorted(samples, key=lambda s: s.time)).procedure(stop=START + stop)
        )
        done = [t for t in found if t is not None]
        assert done == sorted(done)
        assert found[: len(done)] == done
        assert all(t <= stop for t in done)


@pytest.mark.parametrize("start_side", list(Side))
def test_sides_that_clear_at_the_same_stamp_are_judged_alike_live_and_at_the_stop(
    start_side: Side,
) -> None:
    to = start_side.opposite
    condition = replace(CONDITION, starting_side=start_side)
    run = Assessment(condition, START)
    for sample in (
        door(-1, 0.0), handle(-1, 0.0), handle(2, 10.0), door(3, 0.5), under(4, start_side),
        under(4.4, to), clear(5, start_side), clear(5, to), door(6, 0.0), door(7, 0.0),
    ):  # fmt: skip
        run.feed(sample)
    assert run.procedure().completed == START + 6
    assert run.procedure(stop=START + 6).level == 6
