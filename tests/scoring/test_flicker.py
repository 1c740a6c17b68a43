"""Signals that flicker: right by the plain definition, and no slower the longer they do."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from types import FrameType

from hypothesis import given
from hypothesis import strategies as st

from scoring.evaluate import Assessment
from scoring.protocol import (
    PASSAGE_SENSORS,
    Condition,
    EventName,
    LockDetection,
    Outcome,
    PassageSensor,
    Side,
    Strip,
)
from scoring.result import Ending
from scoring.samples import PassageSample, Sample
from tests.scoring.runs import CONDITION, START, detector, door, handle, latch, strip

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
