"""Events as protocol section 4 defines them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from cProfile import Profile
from itertools import islice
from pstats import Stats
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.assessment import Assessment
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
from scoring.samples import PassageSample, Sample
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

TOUCH, OPENS, CLOSES = "handle_is_touched", "door_opens", "door_closes"
APPROACH = "humanoid_approaches_the_door_on_{}_side".format
LEFT = "humanoid_moves_to_{}_side".format


def events(samples: Iterable[Sample], stop: float = 9.0, **told: Any) -> list[tuple[float, str]]:  # noqa: ANN401
    found = detector(samples, **told).events(START + stop)
    assert (found[0].name, found[0].time) == (EventName.BENCHMARK_START, START)
    assert (found[-1].name, found[-1].time) == (EventName.BENCHMARK_STOP, START + stop)
    return [(round(e.time - START, 6), e.name.value) for e in found[1:-1]]


def scan(time: float, distance: float, ranges: int = 4, least: float = 0.0) -> PassageSample:
    """All elements of one strip read this, m."""
    at = START + time
    return PassageSample(at, at, Strip.CCW_LEFT, (distance,) * ranges, least, 2.5)


CCW, CW = Side.CCW, Side.CW
BEFORE: list[Sample] = [door(-0.5, 1.0), handle(-0.5, 9.0), under(-0.5, CCW)]
AT_THE_START = [(0.0, TOUCH), (0.0, OPENS), (0.0, APPROACH("ccw"))]
SEEN: list[Sample] = [clear(0.1, CCW), under(1, CCW)]
BOTH: list[Sample] = [under(4, CCW), under(4.4, CW)]
WHOLE = [
    (2.0, TOUCH),
    (3.0, OPENS),
    (4.0, APPROACH("ccw")),
    (5.0, LEFT("cw")),
    (6.0, CLOSES),
]
NOT_USED = [
    (which, element)
    for which in Strip
    for element in range(4)
    if (which, element) not in {(s.strip, s.element) for s in PASSAGE_SENSORS}
]


@pytest.mark.parametrize(
    ("samples", "stop", "found"),
    [
        pytest.param(passage_through(), 6.0, WHOLE, id="a whole run"),
        pytest.param([*passage_through(), door(8.0, 0.5)], 6.0, WHOLE, id="none after the stop"),
        pytest.param(
            [handle(0.5, 1.96), handle(1, 1.9614), handle(2, 0), handle(3, -50)],
            9.0,
            [(1.0, TOUCH)],
            id="a touch is beyond the threshold, and only one",
        ),
        pytest.param(
            BEFORE, 9.0, [*AT_THE_START, (9.0, LEFT("ccw"))], id="up before the start, at the start"
        ),
        pytest.param(
            [*BEFORE, door(1, 0.0), handle(1, 0.0), clear(1, CCW)],
            9.0,
            [*AT_THE_START, (1.0, CLOSES), (1.0, LEFT("ccw"))],
            id="up before the start and down after it",
        ),
        pytest.param(
            [door(-1, 0.5), door(-0.1, 0.0), door(0.1, 0.0)], 9.0, [], id="closed at the start"
        ),
        pytest.param(
            [door(t, a) for t, a in enumerate([0.0, 0.03, 0.0299, -0.4, 0.0])],
            9.0,
            [(1, OPENS), (2, CLOSES), (3, OPENS), (4, CLOSES)],
            id="every opening and closing counts",
        ),
        pytest.param(
            [door(0.5, -0.2), under(1, CW, 0), door(1.5, -0.5), clear(2, CW, 0)],
            9.0,
            [(0.5, OPENS)],
            id="a masked sensor that saw nothing",
        ),
        pytest.param(
            [
                *(clear(0.1, CW, 0), under(1, CW, 0), door(1.5, -0.2), clear(2, CW, 0)),
                *(door(3, -0.5), clear(4, CW, 0)),
            ],
            9.0,
            [(1, APPROACH("cw")), (1.5, OPENS), (4, LEFT("cw"))],
            id="a masked sensor keeps its state",
        ),
        *(
            pytest.param(
                [*before, scan(2, distance)], 9.0, found, id=f"{distance} keeps what was: {found}"
            )
            for distance in (math.nan, -0.1, 2.6)
            for before, found in (
                (SEEN, [(1, APPROACH("ccw")), (9, LEFT("ccw"))]),
                (SEEN[:1], []),
            )
        ),
        pytest.param(
            [scan(0.1, math.inf, least=0.1), scan(1, -math.inf, least=0.1), scan(2, math.inf)],
            9.0,
            [(1.0, APPROACH("ccw")), (2.0, LEFT("ccw"))],
            id="infinities are readings",
        ),
        pytest.param(
            [*SEEN, scan(2, 0.0, ranges=0)],
            9.0,
            [(1, APPROACH("ccw")), (9.0, LEFT("ccw"))],
            id="a shorter message leaves the other sensors as they are",
        ),
        pytest.param(
            [*(s for s in passage_through() if s.time < START + 4.9), door(6, 0.0)],
            6.0,
            [*WHOLE[:3], (6.0, LEFT("cw")), (6.0, CLOSES)],
            id="still under the sensors at the stop",
        ),
        *(
            pytest.param(
                [*BOTH, *cleared], 6.0, [(4, APPROACH("ccw")), (6.0, LEFT(to))], id=f"both, to {to}"
            )
            for cleared, to in (
                ([clear(6.2, CCW), clear(6.5, CW)], "cw"),
                ([clear(6.2, CW), clear(6.5, CCW)], "ccw"),
                ([], "ccw"),
            )
        ),
        pytest.param(
            [latch(-1, True), latch(1, True), latch(2, False), latch(5, True)],
            9.0,
            [(2.0, "door_is_unlocked"), (5.0, "door_is_locked")],
            id="of the latch only changes",
        ),
        *(
            pytest.param(
                [strip(0.1, which), strip(1, which, [0.0] * element + [1.5])], 9.0, [], id=which
            )
            for which, element in NOT_USED
        ),
        *(
            pytest.param(
                [
                    *(clear(0.1, s.side, s.index), under(1, s.side, s.index, height)),
                    clear(2, s.side, s.index),
                ],
                9.0,
                [(1, APPROACH(s.side)), (2, LEFT(s.side))] if height > 0.5 else [],
                id=f"{s.side}-{s.index} {height} m",
            )
            for s in PASSAGE_SENSORS
            for height in (0.5, 0.51)
        ),
    ],
)
def test_events_are_those_of_the_definition(
    samples: list[Sample], stop: float, found: list[tuple[float, str]]
) -> None:
    assert sorted(events(samples, stop)) == sorted(found)


def test_six_sensors_near_the_hinge_are_not_used() -> None:
    assert len(NOT_USED) == 6


def test_handle_zero_is_subtracted() -> None:
    resting = [handle(t / 10, 5.9) for t in range(20)]
    assert [events(resting, zero=zero) for zero in (5.9, 0.0)] == [[], [(0.0, TOUCH)]]


def test_masks_are_open_intervals_of_one_side_only() -> None:
    numbers = Thresholds()
    for side, upper in ((CW, numbers.mask_to_cw), (CCW, numbers.mask_to_ccw)):
        for index, (low, high) in enumerate(zip(numbers.mask_from, upper, strict=True)):
            angles = [(low + high) / 2, -(low + high) / 2, low, high]
            masked = [numbers.masked(side, index, angle * side.sign) for angle in angles]
            assert masked == [True, False, False, False]


def test_asking_during_the_countdown_changes_nothing() -> None:
    found = detector([under(-2, CCW)])
    found.events()
    found.evidence()
    for sample in (clear(-1, CCW), clear(1, CCW)):
        found.feed(sample)
    assert len(found.events(START + 9)) == 2


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
    assert listed.count(EventName.BENCHMARK_START) == listed.count(EventName.BENCHMARK_STOP) == 1
    assert listed.count(EventName.HANDLE_IS_TOUCHED) <= 1
    for pair in (EventName.approaches, EventName.moves_to):
        assert listed.count(pair(Side.CW)) + listed.count(pair(Side.CCW)) <= 1
    turns = [n for n in listed if n in (EventName.DOOR_OPENS, EventName.DOOR_CLOSES)]
    assert [turn is EventName.DOOR_CLOSES for turn in turns] == [i % 2 for i in range(len(turns))]


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
    profile = Profile()
    profile.runcall(work)
    return Stats(profile).total_calls  # type: ignore[attr-defined,no-any-return]


def test_the_work_of_a_second_does_not_grow_with_what_flickered_before() -> None:
    seconds = 12
    for lock in (LockDetection.SENSOR, LockDetection.SETTLE):
        found = Assessment(CONDITION, START, lock_detection=lock)
        samples = flicker(seconds)

        def follow(found: Assessment = found, samples: Iterator[Sample] = samples) -> None:
            for sample in islice(samples, RATE * 7 * seconds // 4):
                found.feed(sample)
                found.release(sample.time)
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
        self.crossed: float | None = None
        for sample in samples:
            self._feed(sample)

    def _feed(self, sample: PassageSample) -> None:
        for sensor in (s for s in PASSAGE_SENSORS if s.strip is sample.strip):
            before, now = self._state[sensor], sample.ranges[sensor.element] < 1.5
            edges, self._state[sensor] = self._edges[sensor], now
            known = len(edges)
            if sample.time >= START and not edges and before:
                edges.append((START, True))  # up at the start
            if sample.time >= START and now is not bool(before):
                edges.append((sample.time, now))
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
        """At one instant a fall on the destination side counts, whichever came first."""
        falls = (
            (time, sensor.side)
            for sensor, edges in self._edges.items()
            for time, up in edges
            if not up and time <= until
        )
        return max(
            falls,
            key=lambda fall: (fall[0], fall[1] is self._condition.destination_side),
            default=None,
        )

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
