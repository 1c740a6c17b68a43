"""What the screens draw: the last 20 s of door and handle, and the curves of a result."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from madrob_console.archive.scored import score_opened
from madrob_console.engine.core.topic_watch import EXTENT, RECENT, RecentReadings
from madrob_console.engine.curves import MOST_CURVE_POINTS, Curve, Curves, curves_of
from madrob_console.testbeds.simulated import Scenario
from scoring.figure_table import EventMark, Quantity, marked_events
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.kinematics import JointState
from scoring.procedure import StepRecord
from scoring.protocol import Event, EventName, LockDetection, Outcome, Step, Thresholds
from scoring.quality import Quality
from scoring.result import Ending, EventRecord, Indicator, Result
from scoring.rows import Rows
from scoring.samples import Sample
from tests.madrob_console.engine.drive import EPOCH_NS, PULL, Drive, make_setup
from tests.madrob_console.recorded_runs import recorded
from tests.scoring import runs
from tests.scoring.runs import assessment, door, handle

START = 1_700_000_000.0

Array = NDArray[np.float64]


def a_result(
    outcome: Outcome = Outcome.COMPLETED, duration: float | None = 10.0, *events: Event
) -> Result:
    return Result(
        handle_zero=0.0,
        ruleset=RulesetName.PROTOCOL,
        outcome=outcome,
        outcome_reason="",
        start=START,
        stop=None if duration is None else START + duration,
        indicators={name: Indicator.missing(name, "not asked for") for name in IndicatorName},
        lock_detection=LockDetection.SETTLE,
        steps=tuple(StepRecord(step, step.text) for step in Step),
        events=tuple(EventRecord.of(event, START) for event in events),
        quality=Quality((), ()),
    )


def some_rows(time: Array, value: Array) -> Rows:
    """The same times and values in every column; `time` in s since the start."""
    at = START + time
    joint = JointState(at, value, value, value)
    return Rows(joint, value, at, value, at, value, None, Thresholds())


def values(stretches: tuple[Curve, ...]) -> list[float]:
    return [value for stretch in stretches for value in stretch.value]


@pytest.mark.parametrize("scenario", [Scenario.NOMINAL, Scenario.SLAM])
def test_the_extremes_of_a_runs_curves_are_its_indicators(scenario: Scenario) -> None:
    scored = score_opened(recorded(scenario))
    result = scored.result
    curves = curves_of(result, scored.rows)
    found = {name: indicator.value for name, indicator in result.indicators.items()}
    extremes = {
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: Quantity.ACCELERATION,
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: Quantity.FORCE,
    }
    for name, quantity in extremes.items():
        assert max(map(abs, values(curves.curves_of(quantity)))) == found[name]
    jerk = np.mean(np.abs(values(curves.curves_of(Quantity.JERK))))
    smoothness = found[IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION]
    assert 10 / jerk == pytest.approx(smoothness, rel=1e-12)
    assert curves.duration == found.get(IndicatorName.EXECUTION_TIME)
    assert curves.events[0] == (0.0, "benchmark_start")
    assert (found[IndicatorName.TIME_TO_HANDLE], "handle_is_touched") in curves.events
    first, last = curves.extent
    assert first == 0.0
    assert (curves.duration < last) is (result.outcome is Outcome.COMPLETED)  # and settles
    assert last < curves.duration + 1.1
    for coded in (msgspec.json, msgspec.msgpack):
        assert coded.decode(coded.encode(curves), type=Curves) == curves


@pytest.mark.parametrize("duration", [10.0, 0.0, -2.0, None])
def test_a_run_without_rows_has_empty_curves(duration: float | None) -> None:
    nothing = np.empty(0)
    curves = curves_of(a_result(Outcome.INTERRUPTED, duration), some_rows(nothing, nothing))
    assert curves == Curves(max(0.0, duration or 0.0))
    assert curves.empty
    assert curves.extent == (0.0, curves.duration)


def test_gaps_and_undefined_values_end_a_stretch() -> None:
    time = np.array([0.0, 0.02, 0.04, 1.0, 1.02, 1.04, 1.06])
    value = np.array([1.0, 2.0, 3.0, 4.0, np.nan, 6.0, np.inf])
    curves = curves_of(a_result(), some_rows(time, value))
    assert [stretch.value for stretch in curves.curves_of(Quantity.FORCE)] == [
        (1.0, 2.0, 3.0),
        (4.0,),
        (6.0,),
    ]


@given(
    count=st.integers(MOST_CURVE_POINTS - 1, 4 * MOST_CURVE_POINTS + 7),
    spikes=st.lists(st.tuples(st.floats(0, 1), st.floats(-1e6, 1e6)), max_size=5),
    gap=st.integers(0, MOST_CURVE_POINTS),
)
@settings(max_examples=20, deadline=None)
def test_a_long_run_is_thinned_and_keeps_its_extremes(
    count: int, spikes: list[tuple[float, float]], gap: int
) -> None:
    time = np.linspace(0.0, 0.02 * (count - 1), count)
    time[gap:] += 5.0
    value = np.sin(time)
    for place, height in spikes:
        value[round(place * (count - 1))] = height
    force = curves_of(a_result(), some_rows(time, value)).curves_of(Quantity.FORCE)
    kept = values(force)
    assert len(kept) <= MOST_CURVE_POINTS
    assert max(kept) == value.max()
    assert min(kept) == value.min()
    times = [at for stretch in force for at in stretch.time]
    assert times == sorted(set(times))
    for before, after in pairwise(force):
        assert after.time[0] - before.time[-1] > 0.1
    recorded = dict(zip(START + time - START, value, strict=True))
    assert all(recorded[at] == height for at, height in zip(times, kept, strict=True))


def test_rows_before_the_start_and_after_the_stop_are_within_the_extent() -> None:
    touched = Event(START + 1.5, EventName.HANDLE_IS_TOUCHED)
    rows = some_rows(np.array([-2.0, -1.98, 11.0]), np.zeros(3))
    curves = curves_of(a_result(Outcome.COMPLETED, 10.0, touched), rows)
    assert curves.events == ((1.5, "handle_is_touched"),)
    assert curves.extent == (-2.0, 11.0)
    # one that was cut off lasts to its last datum
    assert curves_of(a_result(Outcome.INTERRUPTED, None), rows).duration == pytest.approx(11.0)


def test_slow_samples_that_are_no_gap_on_this_testbed_make_one_curve() -> None:
    samples: list[Sample] = []
    for tick in range(8 * 20):
        time = tick / 8
        samples += [door(time, 0.5 - 0.5 * np.cos(time)), handle(time, np.sin(time))]
    of = assessment(samples, thresholds=Thresholds(largest_gap=0.3))
    curves = curves_of(*of.result(Ending(Outcome.TIMEOUT, "as told", runs.START + 20)))
    (position,), (force,) = curves.curves_of(Quantity.POSITION), curves.curves_of(Quantity.FORCE)
    assert len(position.time) == len(force.time) == 8 * 20


EPOCH, GAP = EPOCH_NS / 1e9, 0.5
SPAN = 20.0
MOST = round(RECENT / EXTENT)
STEPS = st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(-50.0, 50.0)), min_size=1, max_size=400)


def after(steps: Sequence[tuple[float, float]]) -> tuple[RecentReadings, list[tuple[float, float]]]:
    """Readings so long after each other, s; and they with their times."""
    readings, now, added = RecentReadings(), EPOCH, []
    for pause, value in steps:
        now += pause
        readings.add(now, value)
        added.append((now, value))
    return readings, added


@given(STEPS)
def test_every_reading_of_the_last_20_s_is_within_an_extent_of_its_time(
    steps: list[tuple[float, float]],
) -> None:
    readings, added = after(steps)
    now = added[-1][0]
    extents = [extent for part in readings.stretches(now, GAP) for extent in part]
    for time, value in added:
        near = [each for each in extents if abs(each.time - time) <= EXTENT / 2 + 1e-6]
        assert time < now - SPAN or any(each.low <= value <= each.high for each in near)
    values = {value for _, value in added}
    assert all({each.low, each.high} <= values for each in extents)
    assert [each.time for each in extents] == sorted({each.time for each in extents})
    assert len(extents) <= MOST


@pytest.mark.parametrize(("pause", "parts"), [(0.02, 1), (0.4, 1), (0.7, 2), (5.0, 2)])
def test_readings_that_were_missing_leave_a_gap(pause: float, parts: int) -> None:
    flow = [(0.02, 1.0)] * 50
    readings, added = after([*flow, (pause, 2.0), *flow])
    assert len(readings.stretches(added[-1][0], GAP)) == parts


def test_what_is_older_than_the_screens_show_is_not_sent() -> None:
    readings, _ = after([(0.02, 1.0)] * 50)
    assert readings.stretches(EPOCH + 1.0 + RECENT + EXTENT, GAP) == ()


def test_a_clock_that_is_set_back_begins_anew() -> None:
    readings, _ = after([(0.02, 1.0)] * 50)
    readings.add(EPOCH - 60.0, 3.0)
    ((extent,),) = readings.stretches(EPOCH - 60.0, GAP)
    assert (extent.low, extent.high) == (3.0, 3.0)


def test_a_screen_that_comes_late_gets_the_course_and_the_events_of_the_run(
    drive: Drive,
) -> None:
    drive.start(make_setup())
    drive.wait(12.0)
    shown = drive.engine.snapshot()
    extremes = [abs(end) for part in shown.handle.recent for e in part for end in (e.low, e.high)]
    assert max(extremes) >= shown.handle.maximum  # type: ignore[operator]
    events = [(each.time, each.event) for each in drive.scored_result().events]
    shown_events = [(event.time, event.name) for event in drive.engine.snapshot().events]
    assert marked_events(shown_events, PULL) == marked_events(events, PULL)
    assert {*marked_events(shown_events, PULL)} == {*EventMark}
