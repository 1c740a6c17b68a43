"""What the screens get of the last 20 s of door and handle."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.engine.core.topic_watch import EXTENT, RECENT, RecentReadings
from scoring.figure_table import EventMark, marked_events
from tests.madrob_console.engine.drive import EPOCH_NS, PULL, Drive, make_setup

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
    drive.finish()
    assert drive.engine.scored is not None
    found = [(each.time, each.event) for each in drive.engine.scored.result.events]
    told = [(event.time, event.name) for event in drive.engine.snapshot().events]
    assert marked_events(told, PULL) == marked_events(found, PULL)
    assert {*marked_events(told, PULL)} == {*EventMark}
