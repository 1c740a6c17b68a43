"""Drawings of pages: each is an SVG element as wide as its place, with its words."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from madrob_console.pages.drawings import (
    FAILED,
    BoxRow,
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


def test_a_value_of_a_failed_run_does_not_stretch_the_scale_and_stands_at_its_edge() -> None:
    edge = boxes(BoxRow("", FIVE, (539.5,)))
    assert f'<text x="100.0%" y="14" text-anchor="middle">{FAILED}' in edge
    ticks = [float(found) for found in re.findall(r">([0-9.]+)</text>", edge)]
    assert max(ticks) <= 6
    assert ">400<" in boxes(BoxRow("", FIVE, (539.5,)), all_shown=True)
