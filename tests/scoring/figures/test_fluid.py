"""Phases and passage lanes: drawings that are as wide as their place."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.figures.fluid import rows_of_words, ticks
from scoring.figures.passage_lanes import Lane, passage_figure, passage_svg
from scoring.figures.phases import TimedPhase, median_phases, phase_bars, phases_of
from scoring.protocol import PASSAGE_SENSORS, Outcome, Side, Step
from scoring.result import Ending, Result
from scoring.rows import Rows
from scoring.samples import Sample
from tests.scoring.runs import CONDITION, START, assessment, clear, door, handle, under

ALL_DONE = {step: 10.0 + step for step in Step}


def test_phases_add_up_to_the_run() -> None:
    found = phases_of(ALL_DONE, 10.0, 17.0)
    assert found == {
        TimedPhase.TOUCH: 1.0,
        TimedPhase.OPEN: 2.0,
        TimedPhase.CROSS: 1.0,
        TimedPhase.CLOSE: 1.0,
        TimedPhase.LOCK: 1.0,
        TimedPhase.REST: 1.0,
    }


def test_a_door_without_a_latch_has_no_phase_of_locking() -> None:
    settled = ALL_DONE | {Step.LOCK: ALL_DONE[Step.CLOSE]}
    assert TimedPhase.LOCK not in phases_of(settled, 10.0, 15.0)
    assert TimedPhase.REST not in phases_of(settled, 10.0, 15.0)


def test_what_came_after_the_last_step_of_a_timeout_is_a_phase() -> None:
    assert phases_of({Step.TOUCH: 13.0}, 10.0, 310.0) == {
        TimedPhase.TOUCH: 3.0,
        TimedPhase.REST: 297.0,
    }
    assert phases_of({}, 10.0, None) == {}


def test_the_median_is_of_those_runs_that_ended_a_phase() -> None:
    whole, stuck = (
        {TimedPhase.TOUCH: 1.0, TimedPhase.OPEN: 4.0},
        {TimedPhase.TOUCH: 3.0, TimedPhase.REST: 200.0},
    )
    assert median_phases([whole, stuck]) == {TimedPhase.TOUCH: 2.0, TimedPhase.OPEN: 4.0}
    assert median_phases([]) == {}


def widths(svg: str) -> list[float]:
    return [float(width) for width in re.findall(r'<rect [^>]*width="([0-9.]+)%"', svg)]


def test_bars_share_one_scale() -> None:
    svg = phase_bars(
        [{TimedPhase.TOUCH: 5.0, TimedPhase.OPEN: 5.0}, {TimedPhase.TOUCH: 20.0}], "two & one"
    )
    assert widths(svg) == [25.0, 25.0, 100.0]
    assert ET.fromstring(svg).get("aria-label") == "two & one"


@given(st.floats(-1e3, 1e3), st.floats(1e-2, 1e4))
def test_an_axis_has_a_few_round_numbers_within_it(begin: float, span: float) -> None:
    found = ticks((begin, begin + span))
    assert 1 <= len(found) <= 7
    assert all(begin - span * 1e-6 <= tick <= begin + span * (1 + 1e-6) for tick in found)


@given(st.lists(st.floats(0, 10), max_size=6))
def test_no_words_meet_others_in_their_row(times: list[float]) -> None:
    marks = [(time, "approach CCW") for time in sorted(times)]
    rows = rows_of_words(marks, (0.0, 10.0))
    places = [(row, round(time, 6)) for (time, _), row in zip(marks, rows, strict=True)]
    assert len(set(places)) == len(places)
    assert max(rows, default=0) < max(1, len(times))


@pytest.fixture(scope="module")
def passage() -> tuple[Result, Rows]:
    """Through the door from 5 to 6 s; open from 3 to 9 s, swinging over the sensors."""
    samples: list[Sample] = []
    for tick in range(-50, 600):
        time = tick / 50
        angle = max(0.0, min(1.0, time - 3, 9 - time))
        samples += [door(time, angle), handle(time, 12.0 if 2 <= time <= 3 else 0.0)]
        samples += {250: [under(time, Side.CCW)], 270: [under(time, Side.CW)]}.get(tick, [])
        samples += {275: [clear(time, Side.CCW)], 300: [clear(time, Side.CW)]}.get(tick, [])
    return assessment(samples).result(Ending(Outcome.COMPLETED, "as told", START + 10))


def rounded(lane: Lane) -> list[tuple[float, float]]:
    return [(round(begin, 6), round(end, 6)) for begin, end in lane.spans]


def test_lanes_show_what_each_sensor_saw_and_the_occupation(passage: tuple[Result, Rows]) -> None:
    found = passage_figure(*passage, CONDITION)
    assert found is not None
    occupation, opened, *lanes = found.lanes
    assert rounded(occupation) == [(5.0, 6.0)]
    assert rounded(opened) == [(3.04, 8.98)]
    assert len(lanes) == len(PASSAGE_SENSORS)
    seen = {lane.name: rounded(lane) for lane in lanes if lane.spans}
    assert seen == {"ccw_left[1]": [(5.0, 5.5)], "cw_right[1]": [(5.4, 6.0)]}
    assert [words for _, words in found.marks] == ["approach CCW", "leave CW", "stop"]


def test_masked_spans_are_those_of_the_events(passage: tuple[Result, Rows]) -> None:
    result, rows = passage
    found = passage_figure(result, rows, CONDITION)
    assert found is not None
    time, angle = rows.joint_state.time - result.start, rows.joint_state.position
    by_name = {f"{s.strip}[{s.element}]": s for s in PASSAGE_SENSORS}
    for lane in found.lanes[2:]:
        sensor = by_name[lane.name]
        masked = [rows.thresholds.masked(sensor.side, sensor.index, one) for one in angle]
        drawn = np.array([any(a <= t < b for a, b in lane.masked) for t in time])
        np.testing.assert_array_equal(drawn, masked)
    assert any(lane.masked for lane in found.lanes)


def test_the_lanes_are_an_svg_that_fits_into_its_place(passage: tuple[Result, Rows]) -> None:
    found = passage_figure(*passage, CONDITION)
    assert found is not None
    svg = passage_svg(found)
    ET.fromstring(svg)
    for left, width in re.findall(r'<rect x="([0-9.]+)%"[^>]*width="([0-9.]+)%"', svg):
        assert float(left) + float(width) <= 100.2
    assert "occupation: 5.00 to 6.00 s" in found.alternative


def test_a_robot_that_stays_under_the_sensors_is_drawn_to_the_end() -> None:
    samples: list[Sample] = [door(t / 50, 0.0) for t in range(-50, 300)]
    samples.insert(100, under(1.0, Side.CCW))
    result, rows = assessment(samples).result(Ending(Outcome.TIMEOUT, "as told", START + 4))
    found = passage_figure(result, rows, CONDITION)
    assert found is not None
    assert [lane.spans for lane in found.lanes if lane.spans] == [((1.0, math.inf),)]
    assert math.isfinite(found.window[1])
    assert "inf" not in passage_svg(found)


def test_without_anything_under_the_sensors_there_is_no_figure() -> None:
    samples = [door(t / 50, 0.0) for t in range(-50, 300)]
    result, rows = assessment(samples).result(Ending(Outcome.TIMEOUT, "as told", START + 4))
    assert passage_figure(result, rows, CONDITION) is None
