"""The edges on which indicators depend, and what is said of a latch (protocol section 11)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from scoring.deciding_edges import EdgeKind, door_edges, passage_edge
from scoring.protocol import LockDetection, Outcome, PassageSensor, Side, Thresholds
from scoring.result import Ending
from scoring.signals import BinarySignal, Held
from tests.scoring.runs import START, assessment, detector, latch, passage_through, sensor


def signal(*changes: float, until: float = 10.0, each: float = 1.0) -> BinarySignal:
    """Down at the start, read every `each` s; the other way from each of these times on."""
    level = BinarySignal()
    for time in sorted({*(round(n * each, 3) for n in range(round(until / each) + 1)), *changes}):
        level.update(time, sum(change <= time for change in changes) % 2 == 1, 0.0)
    return level


@pytest.mark.parametrize(
    ("door", "touches", "edges"),
    [
        ((3, 6), (2,), [(EdgeKind.OPENING, 3), (EdgeKind.CLOSING, 6)]),
        ((3,), (2,), [(EdgeKind.OPENING, 3)]),
        ((1, 6), (2,), [(EdgeKind.OPENING, 1), (EdgeKind.CLOSING, 6)]),  # open when touched
        ((1, 2, 4, 6), (3,), [(EdgeKind.OPENING, 4), (EdgeKind.CLOSING, 6)]),
        ((1, 2), (3,), [(EdgeKind.CLOSING, 2)]),
        ((3, 6), (), [(EdgeKind.OPENING, 3), (EdgeKind.CLOSING, 6)]),
        ((), (2,), []),
    ],
)
def test_the_opening_is_the_one_of_the_touch_the_closing_the_last(
    door: Sequence[float], touches: Sequence[float], edges: list[tuple[EdgeKind, float]]
) -> None:
    deciding = door_edges(signal(*door), signal(*touches), math.inf)
    assert [(edge.kind, edge.time) for edge in deciding] == edges


def test_an_edge_was_held_until_the_next_one_or_the_last_reading() -> None:
    level = signal(3.0, 6.5)
    assert [level.held(index) for index in (0, 1)] == [Held(4, 3.5), Held(5, 3.5)]


FIRST, SECOND, OTHER_STRIP = (sensor(Side.CCW, index) for index in (0, 1, 4))


@pytest.mark.parametrize(
    ("kind", "there", "readings", "alone"),
    [
        (EdgeKind.ARRIVAL, {FIRST: (3.0, 3.1)}, 5, 0.1),
        (EdgeKind.ARRIVAL, {FIRST: (3.0, 3.1), SECOND: (3.06, 3.3)}, 15, 0.3),
        (EdgeKind.ARRIVAL, {FIRST: (3.0, 3.1), OTHER_STRIP: (3.06, 3.3)}, 15, None),
        (EdgeKind.ARRIVAL, {FIRST: (3.0, 3.1), SECOND: (3.16, 3.3)}, 5, 0.1),
        (EdgeKind.DEPARTURE, {FIRST: (2.9, 3.0), SECOND: (2.7, 2.96)}, 15, 0.3),
        (EdgeKind.DEPARTURE, {FIRST: (2.9, 3.0, 3.04), SECOND: (2.7, 2.96)}, 2, 0.3),
    ],
)
def test_an_arrival_and_a_leaving_rest_on_all_sensors_that_saw_it_without_a_break(
    kind: EdgeKind, there: dict[PassageSensor, Sequence[float]], readings: int, alone: float | None
) -> None:
    levels = {place: signal(*times, until=4.0, each=0.02) for place, times in there.items()}
    edge = passage_edge(kind, levels, FIRST, 3.0)
    assert (edge.time, edge.readings) == (3.0, readings)
    assert edge.alone == (alone if alone is None else pytest.approx(alone))


@pytest.mark.parametrize(("read", "since"), [(2.0, 7.98), (7.99, 7.99)])
def test_a_latch_that_publishes_changes_only_is_sampled_at_the_usual_rate(
    read: float, since: float
) -> None:
    states = [latch(-1, True), latch(1.5, False), latch(read, False), latch(8.0, True)]
    *_, locking = (
        edge
        for edge in detector([*passage_through(), *states]).deciding(START + 9)
        if edge.kind is EdgeKind.LOCKING
    )
    assert locking.since is not None
    assert locking.since - START == pytest.approx(since)
    assert locking.readings == Thresholds().doubt.least_readings


@pytest.mark.parametrize("unlocks", [False, True])
def test_a_latch_that_never_unlocked_is_doubted_where_the_door_opened(unlocks: bool) -> None:
    states = [latch(-1, True), *([latch(2.5, False)] if unlocks else []), latch(6.5, True)]
    run = assessment(
        sorted([*passage_through(), *states], key=lambda sample: sample.time),
        lock=LockDetection.SENSOR,
    )
    result, *_ = run.result(Ending(Outcome.TIMEOUT, "time over", START + 7.0))
    words = "the door opened, but the latch sensor never said that it was unlocked"
    assert (words in result.doubts) is not unlocks
