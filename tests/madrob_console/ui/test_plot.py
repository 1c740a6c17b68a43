from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.engine.shown.curves import Curve
from madrob_console.ui.cells.axes import Axis, Window
from madrob_console.ui.cells.lines import Line
from madrob_console.ui.cells.plot import ASCII, BRAILLE, Extreme, Frame, Ink, Mark, Plot

TEN_SECONDS = Window(0.0, 10.0)
INKS = pytest.mark.parametrize("ink", [BRAILLE, ASCII])
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


def texts(lines: list[Line]) -> list[str]:
    return ["".join(span.text for span in line) for line in lines]


def curve(*points: tuple[float, float]) -> Curve:
    return Curve(tuple(time for time, _ in points), tuple(value for _, value in points))


def sine(count: int = 500, height: float = 1.0) -> Curve:
    return curve(*((10 * i / count, height * math.sin(i / count * 20)) for i in range(count)))


def drawn(
    plot: Plot,
    *marks: Mark,
    ink: Ink = ASCII,
    window: Window = TEN_SECONDS,
    width: int = 46,
    height: int = 9,
) -> list[str]:
    """The rows right of the y axis."""
    rows = texts(Frame(window, width, 5, marks, ink).plot(plot, height))
    return [row[6:] for row in rows]


POINTS = st.lists(
    st.tuples(st.floats(-5, 20), NUMBERS), min_size=1, max_size=30, unique_by=lambda point: point[0]
)
PLOTS = st.builds(
    Plot,
    st.lists(POINTS, max_size=4).map(lambda parts: tuple(curve(*sorted(part)) for part in parts)),
    st.just(0.1),
    st.booleans(),
    st.sampled_from([2.0, 1e15]),
    st.sampled_from([None, 0.03]),
)
FRAMES = st.builds(
    Frame,
    st.builds(
        lambda start, width: Window(start, start + width), st.floats(-5, 15), st.floats(0.2, 20)
    ),
    st.integers(20, 150),
    st.just(0),
    st.lists(st.builds(Mark, st.floats(-10, 30), st.sampled_from("toxc")), max_size=8),
    st.sampled_from([BRAILLE, ASCII]),
)


@given(PLOTS, FRAMES, st.integers(3, 40))
@settings(max_examples=150, deadline=None)
def test_any_data_fill_exactly_the_cells_that_there_are(
    plot: Plot, frame: Frame, height: int
) -> None:
    assert plot.axis(height).gutter <= 10
    frame = replace(frame, gutter=plot.axis(height).gutter)
    rows = texts(frame.plot(plot, height))
    assert len(rows) == height
    axis = texts(frame.time_axis())
    assert len(axis) == 2
    assert {cell_len(row) for row in rows + axis} == {frame.width}
    if frame.ink is ASCII:
        assert all(row.isascii() for row in rows + axis)


@given(NUMBERS, NUMBERS, st.floats(0.01, 10), st.integers(3, 60))
def test_the_y_axis_has_three_round_labels_or_more_and_holds_the_data(
    one: float, other: float, least: float, height: int
) -> None:
    low, high = sorted((one, other))
    axis = Axis.over(low, high, least, height)
    assert len(axis.ticks) >= 3
    low, high = max(-1e15, min(0.0, low)), min(1e15, max(0.0, high))
    invisible = (axis.ticks[-1] - axis.ticks[0]) * 1e-8
    assert axis.ticks[0] <= low + invisible
    assert axis.ticks[-1] >= high - invisible
    assert len(set(axis.labels)) == len(axis.labels)
    for dots in (height * BRAILLE.high, height * ASCII.high):
        rows = [axis.dot(tick, dots) * height // dots for tick in axis.ticks]
        assert len(set(rows)) == len(rows)
        assert rows[0] == 0
        assert rows[-1] == height - 1


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (0.0, 1.05, ("0.0", "0.5", "1.0", "1.5")),
        (-3.1, 7.2, ("-5", "0", "5", "10")),
        (0.0, 0.0, ("0.00", "0.05", "0.10")),
        (-0.6, 0.7, ("-1", "0", "1")),
        (0.0, 2e6, ("0", "1e+06", "2e+06")),
    ],
)
def test_labels_are_numbers_that_people_choose(
    low: float, high: float, labels: tuple[str, ...]
) -> None:
    assert Axis.over(low, high, 0.1, 5).labels == labels


@INKS
def test_the_largest_absolute_value_is_marked_where_it_is(ink: Ink) -> None:
    rows = drawn(Plot((curve((0, 0), (5, -3), (7.5, 2), (10, 0)),), 1.0), ink=ink)
    ((y, x),) = [(y, row.index(ink.top)) for y, row in enumerate(rows) if ink.top in row]
    assert x == 20
    assert y > len(rows) // 2


def test_the_largest_value_is_told_even_where_it_is_clipped_or_out_of_sight() -> None:
    plot = Plot((curve((0, 0.5), (2, -30.0)), curve((4, 1.0), (9, 1.5))), 2.0, True, clip=2.0)
    assert plot.extreme() == Extreme(2.0, -30.0)
    assert plot.axis(9).ticks[-1] == 2.0
    rows = drawn(plot)
    assert rows[0][8] == ASCII.top
    assert not any(ASCII.top in row for row in drawn(plot, window=Window(3.0, 10.0)))


def test_without_data_there_are_axes_and_no_curve() -> None:
    assert Plot((), 1.0).extreme() is None
    assert not "".join(drawn(Plot((), 1.0))).strip()


@INKS
def test_nothing_is_drawn_over_a_gap(ink: Ink) -> None:
    plot = Plot((curve((0, 1), (2.9, 1)), curve((7.1, 1), (10, 1))), 1.0)
    columns = list(zip(*drawn(plot, ink=ink), strict=True))
    assert all(char == " " for column in columns[12:28] for char in column)
    assert all(any(char != " " for char in column) for column in columns[:12] + columns[28:])


@INKS
@pytest.mark.parametrize("window", [TEN_SECONDS, Window(4.0, 5.0), Window(4.001, 4.2)])
def test_a_stretch_is_drawn_without_holes_however_far_one_zooms_in(
    ink: Ink, window: Window
) -> None:
    rows = drawn(Plot((sine(60),), 0.1), ink=ink, window=window)
    columns = list(zip(*rows, strict=True))
    assert all(any(char != " " for char in column) for column in columns[:39])


def test_steep_flanks_join_what_lies_below_and_above() -> None:
    rows = drawn(Plot((curve((0, 0), (5.0, 0), (5.02, 10), (10, 10)),), 1.0))
    assert all(row[20] != " " for row in rows)


def test_one_peak_among_thousands_of_rows_is_seen() -> None:
    points = [(i / 600, 0.0) for i in range(6000)]
    points[3333] = (points[3333][0], 7.0)
    rows = drawn(Plot((curve(*points),), 1.0), ink=BRAILLE)
    top = next(row for row in rows if row.strip())
    assert top.index(BRAILLE.top) == int(3333 / 6000 * 40)


@INKS
def test_events_are_vertical_lines_with_a_letter_each(ink: Ink) -> None:
    marks = [Mark(2.5, "t"), Mark(7.5, "o"), Mark(11.0, "c")]
    rows = drawn(Plot((), 1.0), *marks, ink=ink)
    assert {tuple(i for i, c in enumerate(row) if c == ink.event) for row in rows} == {(10, 30)}
    letters = texts(Frame(TEN_SECONDS, 46, 5, marks, ink).time_axis())[0][6:]
    assert (letters[10], letters[30]) == ("t", "o")
    assert "c" not in letters


def test_letters_of_events_at_the_same_instant_stand_side_by_side() -> None:
    marks = [Mark(9.9, "c"), Mark(2.5, "t"), Mark(2.51, "o"), Mark(10.0, "x")]
    letters = texts(Frame(TEN_SECONDS, 46, 5, marks, ASCII).time_axis())[0][6:]
    assert letters[10:12] == "to"
    assert letters[39] == "c"


def test_the_closed_zone_is_dotted_behind_the_curve() -> None:
    plot = Plot((curve((0, 0), (5, 0), (5.02, 1), (10, 1)),), 0.1, zone=0.03)
    bottom = drawn(plot)[-1]
    assert bottom[22:] == "." * 18
    assert "." not in bottom[:20]


def test_times_are_round_and_their_labels_apart() -> None:
    for window in (TEN_SECONDS, Window(0.0, 14.85), Window(11.5, 11.9), Window(-2.0, 301.0)):
        ticks = window.ticks(72)
        assert len(ticks) >= 3
        for (cell, label), (following, _) in pairwise(ticks):
            assert cell + len(label) < following
    assert [label for _, label in TEN_SECONDS.ticks(72)] == [f"{t} s" for t in (0, 2, 4, 6, 8, 10)]


@pytest.mark.parametrize(
    ("ink", "picture"),
    [
        (
            BRAILLE,
            [
                " 1┤ ⣠⠖⢲⡀        ⡴⠒⢦        ⢀⡴⠲⣄        ⣠",
                "  │⢰⠃  ⠹⡄      ⡼⠁ ⠈⢧      ⢠⠏  ⠘⣆      ⣰⠃",
                " 0┤⠏    ⢹⡀    ⣸⠁   ⠈⢧    ⢀⡞    ⠸⡄    ⢰⠃ ",
                "  │      ⢳⡀  ⣰⠃     ⠘⣆   ⡼      ⠹⡄  ⢠⠏  ",
                "-1┤       ⠳⣄⡴⠃       ⠘⢦⣠⠞⠁       ⠹●⣠⠏   ",
            ],
        ),
        (
            ASCII,
            [
                " 1+ _--_       _|'|_       _--_        _",
                "  ||'  -_      |   |_     _-  '|      |'",
                " 0+-    |_    |'    |    _|    -_    _- ",
                "  |      |_  |'     '|  _|      -_  _-  ",
                "-1+       -_|'       '|_|        -*_-   ",
            ],
        ),
    ],
)
def test_a_curve_looks_like_itself(ink: Ink, picture: list[str]) -> None:
    frame = Frame(TEN_SECONDS, 40, 2, (), ink)
    assert texts(frame.plot(Plot((sine(),), 0.1), 5)) == picture
