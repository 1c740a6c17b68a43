"""Events as protocol section 4 defines them."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from types import FrameType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.evaluate import Assessment
from scoring.events import EventDetector
from scoring.protocol import (
    PASSAGE_SENSORS,
    Condition,
    EventName,
    LockDetection,
    Outcome,
    PassageSensor,
    Side,
    Strip,
    Thresholds,
)
from scoring.result import Ending
from scoring.rulesets import EUROBENCH_2020
from scoring.signals import PassageSample, Sample
from tests.scoring.runs import (
    CONDITION,
    START,
    clear,
    detector,
    door,
    handle,
    latch,
    passage_through,
    strip,
    under,
)


def names(found: EventDetector, stop: float) -> list[tuple[float, str]]:
    return [(round(e.time - START, 6), e.name.value) for e in found.events(START + stop)]


def test_a_whole_run_gives_its_events_in_order() -> None:
    assert names(detector(passage_through()), 6.0) == [
        (0.0, "benchmark_start"),
        (2.0, "handle_is_touched"),
        (3.0, "door_opens"),
        (4.0, "humanoid_approaches_the_door_on_ccw_side"),
        (5.0, "humanoid_moves_to_cw_side"),
        (6.0, "door_closes"),
        (6.0, "benchmark_stop"),
    ]


def test_touch_is_the_first_force_beyond_the_threshold_and_only_one() -> None:
    found = detector([handle(0.5, 1.96), handle(1, 1.9614), handle(2, 0), handle(3, -50)])
    assert names(found, 9)[1:-1] == [(1.0, "handle_is_touched")]


def test_handle_zero_is_subtracted() -> None:
    resting = [handle(t / 10, 5.9) for t in range(20)]
    assert names(detector(resting, zero=5.9), 9)[1:-1] == []
    assert names(detector(resting), 9)[1:-1] == [(0.0, "handle_is_touched")]


def test_what_is_up_before_the_start_happens_at_the_start() -> None:
    before: list[Sample] = [door(-0.5, 1.0), handle(-0.5, 9.0), under(-0.5, Side.CCW)]
    expected = [
        (0.0, "handle_is_touched"),
        (0.0, "door_opens"),
        (0.0, "humanoid_approaches_the_door_on_ccw_side"),
        (9.0, "humanoid_moves_to_ccw_side"),
    ]
    assert sorted(names(detector(before), 9)[1:-1]) == sorted(expected)
    after: list[Sample] = [door(1, 0.0), handle(1, 0.0), clear(1, Side.CCW)]
    expected[3:] = [(1.0, "door_closes"), (1.0, "humanoid_moves_to_ccw_side")]
    assert sorted(names(detector([*before, *after]), 9)[1:-1]) == sorted(expected)


def test_door_open_before_the_start_and_closed_at_it_is_no_event() -> None:
    assert names(detector([door(-1, 0.5), door(-0.1, 0.0), door(0.1, 0.0)]), 9)[1:-1] == []


def test_every_opening_and_closing_counts() -> None:
    angles = [0.0, 0.03, 0.0299, -0.4, 0.0]
    found = detector([door(t, a) for t, a in enumerate(angles)])
    assert [n for _, n in names(found, 9)][1:-1] == ["door_opens", "door_closes"] * 2


def test_events_after_the_stop_are_left_out() -> None:
    found = detector([*passage_through(), door(8.0, 0.5)])
    assert all(time <= 6.0 for time, _ in names(found, 6.0))


@pytest.mark.parametrize("used", PASSAGE_SENSORS, ids=lambda s: f"{s.side}-{s.index}")
def test_each_used_sensor_sees_a_robot_higher_than_half_a_metre(used: object) -> None:
    side, index = used.side, used.index  # type: ignore[attr-defined]
    low = detector([clear(0.1, side, index), under(1, side, index, 0.5)])
    assert names(low, 9)[1:-1] == []
    high = detector([clear(0.1, side, index), under(1, side, index, 0.51), clear(2, side, index)])
    assert [e for _, e in names(high, 9)][1:-1] == [
        f"humanoid_approaches_the_door_on_{side}_side",
        f"humanoid_moves_to_{side}_side",
    ]


def test_the_six_sensors_near_the_hinge_are_not_used() -> None:
    used = {(s.strip, s.element) for s in PASSAGE_SENSORS}
    for which in Strip:
        for element in range(4):
            if (which, element) in used:
                continue
            heights = [0.0] * 4
            heights[element] = 1.5
            assert names(detector([strip(0.1, which), strip(1, which, heights)]), 9)[1:-1] == []


def test_a_masked_sensor_keeps_its_state() -> None:
    masked: list[Sample] = [
        door(0.5, -0.2),
        under(1, Side.CW, 0),
        door(1.5, -0.5),
        clear(2, Side.CW, 0),
    ]
    assert not [n for _, n in names(detector(masked), 9) if "humanoid" in n]
    held: list[Sample] = [
        under(1, Side.CW, 0),
        door(1.5, -0.2),
        clear(2, Side.CW, 0),
        door(3, -0.5),
    ]
    found = detector([clear(0.1, Side.CW, 0), *held, clear(4, Side.CW, 0)])
    assert (4.0, "humanoid_moves_to_cw_side") in names(found, 9)


def test_eurobench_counts_a_masked_sensor_as_absent() -> None:
    held: list[Sample] = [
        clear(0.1, Side.CW, 0),
        under(1, Side.CW, 0),
        door(1.5, -0.2),
        under(2, Side.CW, 0),
    ]
    found = detector(held, ruleset=EUROBENCH_2020)
    assert (2.0, "humanoid_moves_to_cw_side") in names(found, 9)


def test_masks_are_open_intervals_of_one_side_only() -> None:
    numbers = Thresholds()
    for side, upper in ((Side.CW, numbers.mask_to_cw), (Side.CCW, numbers.mask_to_ccw)):
        for index in range(5):
            low, high = numbers.mask_from[index], upper[index]
            inside = (low + high) / 2 * side.sign
            assert numbers.masked(side, index, inside)
            assert not numbers.masked(side, index, -inside)
            assert not numbers.masked(side, index, low * side.sign)
            assert not numbers.masked(side, index, high * side.sign)


@pytest.mark.parametrize("distance", [math.nan, -0.1, 2.6])
def test_no_reading_keeps_the_state(distance: float) -> None:
    bad = PassageSample(START + 2, START + 2, Strip.CCW_LEFT, (distance,) * 4, 0.0, 2.5)
    assert names(detector([clear(0.1, Side.CCW), bad]), 9)[1:-1] == []
    held = detector([clear(0.1, Side.CCW), under(1, Side.CCW), bad])
    assert (9.0, "humanoid_moves_to_ccw_side") in names(held, 9)


def test_infinities_are_readings() -> None:
    def ranges(time: float, distance: float) -> PassageSample:
        at = START + time
        return PassageSample(at, at, Strip.CCW_LEFT, (distance,) * 4, 0.1, 2.5)

    found = detector([ranges(0.1, math.inf), ranges(1, -math.inf), ranges(2, math.inf)])
    assert names(found, 9)[1:-1] == [
        (1.0, "humanoid_approaches_the_door_on_ccw_side"),
        (2.0, "humanoid_moves_to_ccw_side"),
    ]


def test_a_shorter_message_leaves_the_other_sensors_as_they_are() -> None:
    short = PassageSample(START + 2, START + 2, Strip.CCW_LEFT, (), 0.0, 2.5)
    found = detector([clear(0.1, Side.CCW), under(1, Side.CCW), short])
    assert (9.0, "humanoid_moves_to_ccw_side") in names(found, 9)


def test_robot_still_on_one_side_at_the_stop_has_left_there_at_the_stop() -> None:
    samples = [s for s in passage_through() if s.time < START + 4.9]
    found = detector([*samples, door(6, 0.0)])
    assert (6.0, "humanoid_moves_to_cw_side") in names(found, 6.0)


@pytest.mark.parametrize(
    ("first", "reached"), [(Side.CCW, Side.CW), (Side.CW, Side.CCW), (None, Side.CCW)]
)
def test_both_sides_occupied_at_the_stop(first: Side | None, reached: Side) -> None:
    samples: list[Sample] = [under(4, Side.CCW), under(4.4, Side.CW)]
    if first is not None:
        samples += [clear(6.2, first), clear(6.5, first.opposite)]
    assert (6.0, f"humanoid_moves_to_{reached}_side") in names(detector(samples), 6.0)


def test_latch_events_are_changes_only() -> None:
    found = detector([latch(-1, True), latch(1, True), latch(2, False), latch(5, True)])
    assert names(found, 9)[1:-1] == [(2.0, "door_is_unlocked"), (5.0, "door_is_locked")]


def test_asking_during_the_countdown_changes_nothing() -> None:
    found = detector([under(-2, Side.CCW)])
    found.events()
    found.evidence()
    for sample in (clear(-1, Side.CCW), clear(1, Side.CCW)):
        found.feed(sample)
    assert names(found, 9)[1:-1] == []


values = st.floats(allow_nan=True, allow_infinity=True, width=32)
any_sample = st.one_of(
    st.builds(door, st.floats(-3, 20), values),
    st.builds(handle, st.floats(-3, 20), values),
    st.builds(latch, st.floats(-3, 20), st.booleans()),
    st.builds(
        lambda t, which, ranges: PassageSample(
            START + t, START + t, which, tuple(ranges), 0.05, 2.5
        ),
        st.floats(-3, 20),
        st.sampled_from(Strip),
        st.lists(st.one_of(values, st.floats(0, 2.5)), max_size=5),
    ),
)


@given(st.lists(any_sample, max_size=60), st.floats(0, 20), st.sampled_from(Side))
def test_any_signal_gives_well_formed_events(
    samples: list[Sample], stop: float, starting: Side
) -> None:
    samples.sort(key=lambda s: s.time)
    condition = Condition(CONDITION.benchmark_type, Side.CW, starting)
    found = detector(samples, condition=condition).events(START + stop)
    listed = [e.name for e in found]
    assert all(START <= e.time <= START + stop for e in found)
    assert [e.time for e in found] == sorted(e.time for e in found)
    for once in (EventName.BENCHMARK_START, EventName.BENCHMARK_STOP):
        assert listed.count(once) == 1
    assert listed.count(EventName.HANDLE_IS_TOUCHED) <= 1
    for pair in (EventName.approaches, EventName.moves_to):
        assert listed.count(pair(Side.CW)) + listed.count(pair(Side.CCW)) <= 1
    turns = [n for n in listed if n in (EventName.DOOR_OPENS, EventName.DOOR_CLOSES)]
    assert turns == [
        (EventName.DOOR_OPENS, EventName.DOOR_CLOSES)[i % 2] for i in range(len(turns))
    ]


RATE = 50


def flicker(seconds: int) -> Iterator[Sample]:
    """Everything that can flicker does so at 50 Hz."""
    for i in range(RATE * seconds):
        time, up = i / RATE + 0.001, i % 2 == 0
        yield handle(time, 20.0 if up else 0.0)
        yield door(time, 0.5 if up else 0.0)
        yield latch(time, not up)
        for k, which in enumerate(Strip):
            heights = [1.2 if (i + k) % 2 else 0.0] * 4
            yield strip(time + 0.002 * k, which, heights)


def calls_of(work: Callable[[], object]) -> int:
    """How many calls `work` makes; resuming a generator is one, too."""
    count = 0

    def profile(_frame: FrameType, _event: str, _argument: object) -> None:
        nonlocal count
        count += 1

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


def test_the_work_of_a_second_does_not_grow_with_what_flickered_before() -> None:
    seconds = 24
    for lock in (LockDetection.SENSOR, LockDetection.SETTLE):
        found = Assessment(CONDITION, START, lock_detection=lock)
        samples = flicker(seconds)

        def follow(found: Assessment = found, samples: Iterator[Sample] = samples) -> None:
            for sample in islice(samples, RATE * 7 * seconds // 4):
                found.feed(sample)
                found.provisional(found.procedure())

        quarters = [calls_of(follow) for _ in range(4)]
        assert max(quarters[1:]) < 1.1 * min(quarters[1:])


def test_the_work_at_the_stop_grows_with_the_flicker_and_not_with_its_square() -> None:
    def at_the_stop(seconds: int, stop: float) -> int:
        found = Assessment(CONDITION, START)
        for sample in flicker(seconds):
            found.feed(sample)
        ending = Ending(Outcome.TIMEOUT, "", START + stop)
        return calls_of(lambda: found.result(ending))

    at_the_stop(1, 1)  # whatever is imported is
    assert at_the_stop(20, 20.0) < 2.5 * at_the_stop(10, 10.0)  # it flickered before the stop
    assert at_the_stop(20, 0.25) < 2.5 * at_the_stop(10, 0.25)  # and goes on after it


# ---------------------------------------------------------------- by the plain definition


class Plain:
    """Section 7 word by word: every fall is looked at again, each time."""

    def __init__(self, samples: list[PassageSample], condition: Condition) -> None:
        self._condition = condition
        self._state: dict[PassageSensor, bool | None] = dict.fromkeys(PASSAGE_SENSORS)
        self._edges: dict[PassageSensor, list[tuple[float, bool]]] = {
            sensor: [] for sensor in PASSAGE_SENSORS
        }
        self._falls: list[tuple[float, Side]] = []
        self.crossed: float | None = None
        for sample in samples:
            self._feed(sample)

    def _feed(self, sample: PassageSample) -> None:
        for sensor in (s for s in PASSAGE_SENSORS if s.strip is sample.strip):
            before, self._state[sensor] = self._state[sensor], sample.ranges[sensor.element] < 1.5
            now = self._state[sensor]
            edges, known = self._edges[sensor], len(self._edges[sensor])
            if sample.time >= START and not edges and before:
                edges.append((START, True))  # up at the start
            if sample.time >= START and now is not bool(before):
                edges.append((sample.time, bool(now)))
            self._falls += [(time, sensor.side) for time, value in edges[known:] if not value]
            if now is not before or len(edges) > known:
                self._judge(max(sample.time, START))

    def _judge(self, time: float) -> None:
        destination = self._condition.destination_side
        last = self._last_fall(math.inf)
        there = last is not None and last[1] is destination
        there = there or self._any(destination)
        if self._any(self._condition.starting_side) or not there:
            self.crossed = None
        elif self.crossed is None:
            self.crossed = time

    def _any(self, side: Side) -> bool:
        return any(state for sensor, state in self._state.items() if sensor.side is side)

    def _last_fall(self, until: float) -> tuple[float, Side] | None:
        newest = None
        for fall in self._falls:
            if fall[0] <= until and (newest is None or fall[0] >= newest[0]):
                newest = fall
        return newest

    def _up(self, side: Side, at: float) -> bool:
        up = False
        for sensor, edges in self._edges.items():
            before = [value for time, value in edges if time <= at]
            if not edges and at >= START:  # it never spoke after the start
                before = [bool(self._state[sensor])]
            up = up or (sensor.side is side and before[-1:] == [True])
        return up

    def left(self, stop: float) -> tuple[float, Side] | None:
        """When and on which side the robot left, of a run that was stopped."""
        occupied = [side for side in Side if self._up(side, stop)]
        if len(occupied) == 1:
            return stop, occupied[0]
        if not occupied:
            return self._last_fall(stop)
        later = sorted({time for edges in self._edges.values() for time, _ in edges if time > stop})
        cleared = {
            side: next((time for time in later if not self._up(side, time)), math.inf)
            for side in Side
        }
        starting, destination = self._condition.starting_side, self._condition.destination_side
        return stop, destination if cleared[starting] < cleared[destination] else starting


times = st.integers(-20, 60).map(lambda tick: tick / 10)
"""Few of them, so that much happens at the same instant."""
strips = st.builds(
    lambda time, which, up: strip(time, which, [1.2 * one for one in up]),
    times,
    st.sampled_from(Strip),
    st.lists(st.booleans(), min_size=4, max_size=4),
)


@given(st.lists(strips, max_size=80), st.floats(0, 6), st.sampled_from(Side))
def test_crossing_and_leaving_are_those_of_the_plain_definition(
    samples: list[PassageSample], stop: float, starting: Side
) -> None:
    once = {(sample.strip, sample.time): sample for sample in samples}  # stamps never repeat
    ordered = sorted(once.values(), key=lambda sample: sample.time)
    condition = Condition(CONDITION.benchmark_type, Side.CW, starting)
    plain, found = Plain(ordered, condition), detector(ordered, condition=condition)
    assert found.evidence().crossed == plain.crossed
    left = [e for e in found.events(START + stop) if e.name in map(EventName.moves_to, Side)]
    expected = plain.left(START + stop)
    assert [(e.time, e.name) for e in left] == (
        [] if expected is None else [(expected[0], EventName.moves_to(expected[1]))]
    )
