"""Axes with round numbers, and scales with marks, made of cells."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby

from madrob_console.ui.cells.lines import Line, Span, Tone


def scale(track: str, marks: Iterable[tuple[int, str, Tone]]) -> Line:
    """A track with marks put on it, as (cell, character, tone); later marks win."""
    cells = [Span(char, Tone.DIM) for char in track]
    for cell, char, tone in marks:
        if 0 <= cell < len(cells):
            cells[cell] = Span(char, tone)
    return joined(cells)


def joined(cells: Iterable[Span]) -> Line:
    """Joins neighbours of one tone into one span."""
    parts = groupby(cells, lambda cell: cell.tone)
    return tuple(Span("".join([cell.text for cell in part]), tone) for tone, part in parts)


def ruler(width: int, labels: Iterable[tuple[int, str]]) -> str:
    """Labels centred under their cells; one that would touch its neighbour is left out."""
    text = [" "] * width
    end = -1
    for cell, label in sorted(labels):
        begin = min(max(0, cell - len(label) // 2), max(0, width - len(label)))
        if begin > end:
            text[begin : begin + len(label)] = label
            end = begin + len(label)
    return "".join(text[:width])


LARGEST = 1e15
"""Values beyond this are drawn here: no reading is, and differences stay exact enough."""

_FACTORS = (1.0, 2.0, 2.5, 5.0)
_LABEL_ROOM = 9


@dataclass(frozen=True, slots=True)
class Window:
    """The time that is shown, s since the run's start; `end` lies after `start`."""

    start: float
    end: float

    @property
    def width(self) -> float:
        return self.end - self.start

    @property
    def middle(self) -> float:
        return self.start + self.width / 2

    def __contains__(self, time: float) -> bool:
        return self.start <= time <= self.end

    def column(self, time: float, columns: int) -> int:
        if time == self.end:
            return columns - 1
        return math.floor((time - self.start) / self.width * columns)

    def ticks(self, columns: int) -> list[tuple[int, str]]:
        """Round times with their columns, as many as their labels leave room for."""
        step, first, last = _steps(self.start, self.end, max(3, columns // _LABEL_ROOM))
        times = [number * step for number in range(first, last + 1)]
        return [
            (self.column(time, columns), f"{text} s")
            for time, text in zip(times, _labels(times, step), strict=True)
            if time in self
        ]


@dataclass(frozen=True, slots=True)
class Axis:
    """A y axis with round numbers at both ends and between; `ticks` from below."""

    ticks: tuple[float, ...]
    labels: tuple[str, ...]

    @classmethod
    def over(cls, low: float, high: float, least: float, height: int) -> Axis:
        """An axis of `height` >= 3 rows around [low, high] and 0.

        It spans `least` at least, so that noise does not look like motion. At most two of three
        rows get a label, and at least three in all.
        """
        low, high = max(-LARGEST, min(0.0, low)), min(LARGEST, max(0.0, high))
        if high - low < least:
            low, high = (low, low + least) if high >= -low else (high - least, high)
        step, first, last = _steps(low, high, max(3, (2 * height + 2) // 3))
        ticks = tuple(number * step for number in range(first, last + 1))
        return cls(ticks, _labels(ticks, step))

    @property
    def gutter(self) -> int:
        """Width of the labels, cells."""
        return max(map(len, self.labels))

    def dot(self, value: float, dots: int) -> int:
        """Which of `dots`, from below, shows a value; the nearest for one outside."""
        low, high = self.ticks[0], self.ticks[-1]
        top = (dots - 1) // 2 * 2  # even: a 0 in the middle lies on a dot, not between two
        return min(top, max(0, round((value - low) / (high - low) * top)))


def _steps(low: float, high: float, most: int) -> tuple[float, int, int]:
    """The smallest round step with at most `most` ticks around [low, high]; the ticks in steps."""
    power = 10.0 ** (math.floor(math.log10((high - low) / most)) - 1)
    # a limit such as 3 * 0.1 must not need another tick for its last digit
    slack = (high - low) * 1e-9
    while True:
        for factor in _FACTORS:
            step = factor * power
            first, last = math.floor((low + slack) / step), math.ceil((high - slack) / step)
            if last - first < most:
                return step, first, last
        power *= 10


def _labels(ticks: Iterable[float], step: float) -> tuple[str, ...]:
    if not 1e-4 <= step < 1e5:
        return tuple(f"{tick:.3g}" for tick in ticks)
    decimals = next(n for n in range(6) if abs(step * 10**n - round(step * 10**n)) < 1e-6)
    return tuple(f"{tick:.{decimals}f}" for tick in ticks)
