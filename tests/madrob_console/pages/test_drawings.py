"""Drawings of pages: each is an SVG element as wide as its place, with its words."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.pages.drawings import FAILED, Point, Scale, rows_of_words
from madrob_console.pages.phases import TimedPhase, median_phases, phases_of
from madrob_console.pages.site_drawings import value_plots
from madrob_console.pages.templates import TEMPLATES
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step
from scoring.result import Uncertainty
from scoring.run_drawings import Lane, PassageFigure
from tests.madrob_console.run_folders import summary

DRAWINGS = TEMPLATES.get_template("drawings.html").module

TIME, LEVEL = IndicatorName.EXECUTION_TIME, IndicatorName.CAPABILITY_LEVEL


def drawn(name: str, *of: object) -> str:
    svg = str(getattr(DRAWINGS, name)(*of))
    ET.fromstring(svg)
    return svg


@given(st.lists(st.floats(0, 10), max_size=6))
def test_no_words_meet_others_in_their_row(times: list[float]) -> None:
    marks = [(time, "approach CCW") for time in sorted(times)]
    rows = rows_of_words(marks, Scale(0.0, 10.0))
    places = [(row, round(time, 6)) for (time, _), row in zip(marks, rows, strict=True)]
    assert len(set(places)) == len(places)
    assert max(rows, default=0) < max(1, len(times))


def test_lanes_of_a_sensor_that_stays_occupied_end_with_the_drawing() -> None:
    lanes = (
        Lane("occupation", ((5.0, 6.0),)),
        Lane("door open", ()),
        Lane("cw_left[1]", ((1.0, math.inf),), ((2.0, 3.0),)),
        Lane("ccw_left[1]", ()),
    )
    found = PassageFigure((0.0, 10.0), lanes, ((1.0, "approach CW"), (9.0, "a & b")))
    scale = Scale(*found.window)
    svg = drawn("passage_lanes", found, scale, rows_of_words(found.marks, scale), 18)
    assert "inf" not in svg
    bars = re.findall(r'<rect x="([0-9.]+)%"[^>]*width="([0-9.]+)%"', svg)
    assert [tuple(map(float, bar)) for bar in bars] == [(50, 10), (20, 10), (10, 90)]
    assert "cw_left[1]: 1.00 to 10.00 s" in svg
    assert "a &amp; b</text>" in svg


ALL_DONE = {step: float(step) for step in Step}
EACH = dict.fromkeys(TimedPhase, 1.0) | {TimedPhase.OPEN: 2.0}  # unlocking is no phase


@pytest.mark.parametrize(
    ("steps", "stop", "phases"),
    [
        (ALL_DONE, 7.0, EACH),
        (  # a door without a latch
            ALL_DONE | {Step.LOCK: ALL_DONE[Step.CLOSE]},
            5.0,
            EACH | {TimedPhase.LOCK: 0.0, TimedPhase.REST: 0.0},
        ),
        ({Step.TOUCH: 3.0}, 300.0, {TimedPhase.TOUCH: 3.0, TimedPhase.REST: 297.0}),
        ({Step.TOUCH: 3.0}, None, {TimedPhase.TOUCH: 3.0}),
    ],
)
def test_phases_are_the_times_between_the_steps(
    steps: dict[Step, float], stop: float | None, phases: dict[TimedPhase, float]
) -> None:
    assert phases_of(steps, stop) == phases


def test_the_median_is_of_those_runs_that_ended_a_phase() -> None:
    whole = {TimedPhase.TOUCH: 1.0, TimedPhase.OPEN: 4.0}
    stuck = {TimedPhase.TOUCH: 3.0}
    assert median_phases([whole, stuck]) == {TimedPhase.TOUCH: 2.0, TimedPhase.OPEN: 4.0}


FORCE = IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION


def valued(name: IndicatorName, *values: float, **fields: object) -> list[RunSummary]:
    return [
        summary(1, 7, n, hour=n, values={name: value}, **fields) for n, value in enumerate(values)
    ]


def plotted(found: list[RunSummary]) -> str:
    (plot,) = value_plots({"1 Delft": found})
    return drawn("rows_of_values", plot.rows, plot.scale, plot.spoken)


def ticks_of(svg: str) -> list[float]:
    return [float(tick) for tick in re.findall(r">([0-9.]+)</text>", svg)]


def test_a_value_of_a_failed_run_does_not_stretch_the_scale_and_stands_at_its_edge() -> None:
    failed = valued(FORCE, 539.5, outcome=Outcome.TIMEOUT)
    edge = plotted([*valued(FORCE, 3.0, 3.5, 4.0, 4.5, 5.0), *failed])
    assert f'<text x="100.0%" y="14" text-anchor="middle">{FAILED}' in edge
    assert max(ticks_of(edge)) <= 6
    assert min(ticks_of(plotted(failed))) > 400  # alone it leads


@given(
    st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=5),
    st.floats(1e-6, 1e6) | st.none(),
)
def test_a_scale_has_all_values_with_their_uncertainties_and_is_four_of_them_wide(
    values: list[float], expanded: float | None
) -> None:
    known = {} if expanded is None else {FORCE: Uncertainty(expanded / 2, expanded)}
    found = valued(FORCE, *values, uncertainties=known)
    spread = expanded or 0.0
    for scale in (plot.scale for plot in value_plots({"1": found})):
        slack = 1e-9 * max(map(abs, (scale.low, scale.high)))
        assert scale.low - slack <= min(values) - spread
        assert scale.high + slack >= max(values) + spread
        assert scale.high - scale.low >= 4 * spread - slack


def test_levels_are_drawn_from_0_to_6_whatever_they_are() -> None:
    for levels in ((6,), (1, 2), (0, 6)):
        found = valued(LEVEL, *levels)
        assert ticks_of(plotted(found)) == [0, 1, 2, 3, 4, 5, 6]


def test_of_very_many_runs_the_latest_are_drawn_and_all_are_counted() -> None:
    many = valued(TIME, *range(1, 500))
    (plot,) = value_plots({"1": many})
    assert plot.rows[0].completed == 499
    assert plot.rows[0].points[-1].value == 499
    assert len(plot.rows[0].points) < 200


def test_a_point_beyond_the_scale_is_drawn_at_its_edge() -> None:
    assert Scale.of([Point(5.0, completed=True)]).at(1e9) == 100
