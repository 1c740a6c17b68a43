"""A curve over time, drawn into cells.

Everything here is a pure function of the data and the room. Plots with the same window and gutter
stand exactly under each other, so that one time axis serves them all.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from madrob_console.engine.curves import Curve
from madrob_console.ui.cells.axes import LARGEST, Axis, Window, joined, ruler
from madrob_console.ui.cells.lines import Line, Span, Tone

_BLANK = 0x2800
_DOTS = (0x40, 0x04, 0x02, 0x01), (0x80, 0x20, 0x10, 0x08)
"""Of a braille cell, left and right, from below."""

WIDE, HIGH = 2, 4
"""Dots of a cell."""

TOP, EVENT, _ZONE = "●", "┊", "·"


@dataclass(frozen=True, slots=True)
class Mark:
    """An event: a vertical line with a letter below; `time` in s since the start."""

    time: float
    letter: str


@dataclass(frozen=True, slots=True)
class Extreme:
    """The datum with the largest absolute value; `time` in s since the start."""

    time: float
    value: float


@dataclass(frozen=True, slots=True)
class Plot:
    """One curve and how it is drawn.

    Between two `stretches` nothing is drawn. The y axis spans `least` at least. Values above
    `clip` are drawn at it. The band from -`zone` to `zone` is dotted.
    """

    stretches: tuple[Curve, ...]
    least: float
    absolute: bool = False
    clip: float = LARGEST
    zone: float | None = None

    def drawn(self, value: float) -> float:
        value = abs(value) if self.absolute else value
        return max(-self.clip, min(self.clip, value))

    def extreme(self) -> Extreme | None:
        """The first datum with the largest absolute value, not clipped; None without data."""
        tops = [
            max(zip(stretch.time, stretch.value, strict=True), key=lambda point: abs(point[1]))
            for stretch in self.stretches
        ]
        return Extreme(*max(tops, key=lambda point: abs(point[1]))) if tops else None

    def axis(self, height: int) -> Axis:
        """The y axis in `height` >= 3 rows; it does not depend on the window.

        What stays inside the zone takes no room below 0 or above it.
        """
        ends = [self.drawn(end(stretch.value)) for stretch in self.stretches for end in (min, max)]
        ends = [end for end in ends if abs(end) > (self.zone or 0.0)]
        return Axis.over(min(ends, default=0.0), max(ends, default=0.0), self.least, height)


@dataclass(frozen=True, slots=True)
class Frame:
    """What all plots of a figure share; `width` and `gutter`, for the y axis' labels, in cells."""

    window: Window
    width: int
    gutter: int
    marks: Sequence[Mark] = ()

    @property
    def columns(self) -> int:
        return max(1, self.width - self.gutter - 1)

    def plot(self, plot: Plot, height: int) -> list[Line]:
        columns, axis = self.columns, plot.axis(height)
        cells = [[Span(" ")] * columns for _ in range(height)]
        if plot.zone is not None:
            for y in range(
                self._row(axis, plot.zone, height), self._row(axis, -plot.zone, height) + 1
            ):
                cells[y] = [Span(_ZONE)] * columns  # in the tone of the curve: fewer bytes
        for cell in {self.window.column(mark.time, columns) for mark in self.marks}:
            for row in cells if 0 <= cell < columns else ():
                row[cell] = Span(EVENT, Tone.DIM)
        _draw_curve(cells, plot, axis, self.window)
        top = plot.extreme()
        if top is not None and top.time in self.window and abs(top.value) > (plot.zone or 0.0):
            row = cells[self._row(axis, plot.drawn(top.value), height)]
            row[self.window.column(top.time, columns)] = Span(TOP, Tone.WARN)
        labels = {
            self._row(axis, tick, height): label
            for tick, label in zip(axis.ticks, axis.labels, strict=True)
        }
        return [
            joined([Span(self._border(labels.get(y)), Tone.DIM), *row])
            for y, row in enumerate(cells)
        ]

    def time_axis(self) -> list[Line]:
        """Two rows under the plots: the axis with its ticks and the events' letters, and times."""
        ticks = self.window.ticks(self.columns)
        cells = [Span("─", Tone.DIM)] * self.columns
        for cell, _ in ticks:
            cells[cell] = Span("┴", Tone.DIM)
        for cell, letter in self._letters().items():
            cells[cell] = Span(letter, Tone.STRONG)
        begin = " " * self.gutter
        return [
            joined([Span(f"{begin}└", Tone.DIM), *cells]),
            (Span(f"{begin} {ruler(self.columns, ticks)}", Tone.DIM),),
        ]

    def _row(self, axis: Axis, value: float, height: int) -> int:
        return height - 1 - axis.dot(value, height * HIGH) // HIGH

    def _border(self, label: str | None) -> str:
        return f"{label or '':>{self.gutter}}{'┤' if label else '│'}"

    def _letters(self) -> dict[int, str]:
        letters: dict[int, str] = {}
        for mark in sorted(self.marks, key=lambda mark: mark.time):
            cell = self.window.column(mark.time, self.columns)
            near = range(cell, min(self.columns, cell + 3)) if cell >= 0 else ()
            free = next((at for at in near if at not in letters), None)
            if free is not None:
                letters[free] = mark.letter
        return letters


def _draw_curve(cells: Sequence[list[Span]], plot: Plot, axis: Axis, window: Window) -> None:
    columns, dots = len(cells[0]) * WIDE, len(cells) * HIGH
    drawn: dict[tuple[int, int], int] = defaultdict(int)
    for column, reach in enumerate(_reaches(plot, window, columns)):
        if reach is None:
            continue
        low, high = (axis.dot(value, dots) for value in reach)
        for level in range(low // HIGH, high // HIGH + 1):
            first, last = max(0, low - level * HIGH), min(HIGH - 1, high - level * HIGH)
            drawn[level, column // WIDE] |= sum(_DOTS[column % WIDE][first : last + 1])
    for (level, cell), bits in drawn.items():
        cells[-1 - level][cell] = Span(chr(_BLANK | bits))


def put_dot(cells: Sequence[list[Span]], x: int, y: int, tone: Tone) -> None:
    """Adds one dot to what is drawn; `x` and `y` count dots from the upper left corner."""
    row, cell = cells[y // HIGH], x // WIDE
    before = ord(row[cell].text)
    bits = before & 0xFF if _BLANK <= before <= _BLANK | 0xFF else 0
    row[cell] = Span(chr(_BLANK | bits | _DOTS[x % WIDE][HIGH - 1 - y % HIGH]), tone)


def _reaches(plot: Plot, window: Window, columns: int) -> list[tuple[float, float] | None]:
    """For each column the lowest and the highest value drawn; None where there is no data."""
    low, high = [math.inf] * columns, [-math.inf] * columns
    for stretch in plot.stretches:
        begin = max(0, bisect_left(stretch.time, window.start) - 1)
        end = bisect_right(stretch.time, window.end) + 1
        scale, start = columns / window.width, window.start
        points = [
            ((time - start) * scale, plot.drawn(value))
            for time, value in zip(stretch.time[begin:end], stretch.value[begin:end], strict=True)
        ]
        for x, y in points:
            if 0 <= x <= columns:
                column = min(columns - 1, int(x))
                low[column], high[column] = min(low[column], y), max(high[column], y)
        for before, after in pairwise(points):
            if math.floor(before[0]) == math.floor(after[0]):
                continue
            for column, bottom, top in _crossed(before, after, columns):
                low[column] = min(low[column], bottom)
                high[column] = max(high[column], top)
    return [None if bottom > top else (bottom, top) for bottom, top in zip(low, high, strict=True)]


def _crossed(
    before: tuple[float, float], after: tuple[float, float], columns: int
) -> Iterable[tuple[int, float, float]]:
    (x, y), (next_x, next_y) = before, after
    for column in range(max(0, math.floor(x)), min(columns, math.floor(next_x) + 1)):
        shares = ((at - x) / (next_x - x) for at in (max(x, column), min(next_x, column + 1)))
        bottom, top = sorted(y + share * (next_y - y) for share in shares)
        yield column, bottom, top
