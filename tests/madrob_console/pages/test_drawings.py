"""Drawings of pages: each is an SVG element as wide as its place, with its words."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.pages.drawings import (
    FAILED,
    FEWEST_FOR_A_BOX,
    MOST_POINTS,
    MOST_TEAMS,
    BoxRow,
    DayCurve,
    DayPoint,
    Scale,
    box_scale,
    rows_of_words,
)
from madrob_console.pages.templates import TEMPLATES
from scoring.figures.run_drawings import Lane, PassageFigure

DRAWINGS = TEMPLATES.get_template("drawings.html").module

FIVE = (3.0, 3.5, 4.0, 4.5, 5.0)


def drawn(name: str, *of: object) -> str:
    svg = str(getattr(DRAWINGS, name)(*of))
    ET.fromstring(svg)
    return svg


def boxes(*rows: BoxRow, all_shown: bool = False) -> str:
    return drawn("box_plot", rows, box_scale(rows, all_shown=all_shown), "")


@given(st.floats(-1e3, 1e3), st.floats(1e-2, 1e4))
def test_an_axis_has_a_few_round_numbers_within_it(begin: float, span: float) -> None:
    found = Scale(begin, begin + span).ticks()
    assert 1 <= len(found) <= 7
    assert all(begin - span * 1e-6 <= tick <= begin + span * (1 + 1e-6) for tick in found)


@given(st.lists(st.floats(0, 10), max_size=6))
def test_no_words_meet_others_in_their_row(times: list[float]) -> None:
    marks = [(time, "approach CCW") for time in sorted(times)]
    rows = rows_of_words(marks, Scale(0.0, 10.0))
    places = [(row, round(time, 6)) for (time, _), row in zip(marks, rows, strict=True)]
    assert len(set(places)) == len(places)
    assert max(rows, default=0) < max(1, len(times))


def test_bars_lie_within_their_place_to_one_scale() -> None:
    scale = Scale(0.0, 20.0)
    assert [*scale.bars([(0, 5), (5, 10), (0, 20)])] == [(0, 25), (25, 25), (0, 100)]
    assert [*scale.bars([(-5, 5), (15, math.inf), (30, 40)])] == [(0, 25), (75, 25)]
    assert [*scale.bars([(10, 10.001)])] == [(50, 0.15)]  # a short one is seen, too


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


def test_a_value_of_a_failed_run_does_not_stretch_the_scale_and_stands_at_its_edge() -> None:
    edge = boxes(BoxRow("", FIVE, (539.5,)))
    assert f'<text x="100.0%" y="14" text-anchor="middle">{FAILED}' in edge
    ticks = [float(found) for found in re.findall(r">([0-9.]+)</text>", edge)]
    assert max(ticks) <= 6
    assert ">400<" in boxes(BoxRow("", FIVE, (539.5,)), all_shown=True)


@pytest.mark.parametrize(
    ("values", "points", "boxes_drawn"),
    [
        (FIVE[: FEWEST_FOR_A_BOX - 1], 4, 0),
        (FIVE, 5, 1),
        (tuple(map(float, range(MOST_POINTS + 1))), 0, 1),
    ],
)
def test_few_values_are_points_and_many_a_box(
    values: tuple[float, ...], points: int, boxes_drawn: int
) -> None:
    svg = boxes(BoxRow("", values))
    assert (svg.count("<circle"), svg.count("<rect")) == (points, boxes_drawn)
    if boxes_drawn:
        assert 'x1="50.0%" x2="50.0%"' in svg  # the median
    many = boxes(*[BoxRow("", values)] * (MOST_TEAMS + 1))
    assert many.count("<circle") == (0 if boxes_drawn else points * (MOST_TEAMS + 1))


def test_where_nobody_completed_the_failed_ones_make_the_scale() -> None:
    assert Scale.of([], [1.0, 2.0]) == Scale.of([1.0, 2.0])
    assert Scale.of([7.0]).low < 7.0 < Scale.of([7.0]).high


def test_runs_are_joined_within_a_condition_and_failed_ones_never() -> None:
    points = [
        DayPoint(0.0, 1.0, 7, completed=True),
        DayPoint(1.0, 2.0, 7, completed=True),
        DayPoint(2.0, 1.5, 12, completed=True),
        DayPoint(3.0, 99.0, 7, completed=False),
    ]
    of = DayCurve(points, [(0.0, "08:00")], Scale(0.0, 3.0), Scale.of([1.0, 2.0]), "all of it")
    assert [(a.value, b.value) for a, b in of.joined] == [(1.0, 2.0)]
    svg = drawn("day_curve", of)
    joined = svg.partition('stroke-width: 1">')[2].partition("</g>")[0]
    assert joined.count("<line") == 1
    assert (svg.count("<circle"), svg.count(FAILED)) == (3, 1)
    assert 'aria-label="all of it"' in svg
    assert ">08:00<" in svg
