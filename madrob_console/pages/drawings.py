"""What `templates/drawings.html` draws: scales, boxes of teams, curves over a day.

A drawing is as wide as its place: widths are in percent of it, letters and heights in pixels, on a
phone and on a wide screen alike.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from scoring.figures.run_drawings import Interval

FAILED = "\N{MULTIPLICATION SIGN}"

FEWEST_FOR_A_BOX = 5
"""Fewer values are drawn as points alone."""

MOST_POINTS = 20
"""Of one team: more values are drawn as a box alone."""

MOST_TEAMS = 20
"""On one page with all that is told of them; of more teams a box has no points."""

_ROOM = 0.08
_NARROWEST = 230.0  # px: on a phone, beside the names of the lanes
_LETTER_WIDTH = 6.6  # px
_MOST_TICKS = 6
_STEPS = (1, 2, 5, 10)


class Scale(NamedTuple):
    """The range of an axis."""

    low: float
    high: float

    @classmethod
    def of(cls, leading: Sequence[float], others: Iterable[float] = ()) -> Self:
        """All of `leading`, `others` only where they fit (or lead alone)."""
        values = leading or tuple(others) or (0.0, 1.0)
        low, high = min(values), max(values)
        room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
        return cls(low - room, high + room)

    def at(self, value: float) -> float:
        """Percent of the range; what lies beyond stands at its end."""
        part = (value - self.low) / ((self.high - self.low) or 1.0)
        return round(100 * min(max(part, 0.0), 1.0), 3)

    def bars(self, spans: Iterable[Interval]) -> Iterator[Interval]:
        """Left end and width of what is within the range, percent; a short one is seen, too."""
        for begin, end in spans:
            if begin < self.high and end > self.low:
                left = self.at(begin)
                yield left, max(round(self.at(end) - left, 3), 0.15)

    def ticks(self, most: int = _MOST_TICKS) -> list[float]:
        """Round values within the range, not many more than `most`."""
        span = (self.high - self.low) / _MOST_TICKS
        power = 10.0 ** math.floor(math.log10(span))
        step = next(n * power for n in _STEPS if n * power >= span * (1 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        found = [round(n * step, 9) + 0.0 for n in range(first, last + 1)]
        return found[:: max(1, round(len(found) / most))]


def rows_of_words(marks: Iterable[tuple[float, str]], scale: Scale) -> list[int]:
    """The row of each text, so that none meets another one on a phone either."""
    rows: list[list[Interval]] = []
    found = []
    for place, text in marks:
        left, width = scale.at(place) / 100 * _NARROWEST, _LETTER_WIDTH * len(text) + 4
        begin = left if left <= _NARROWEST / 2 else left - width
        free = (
            number
            for number, taken in enumerate(rows)
            if all(begin + width <= a or b <= begin for a, b in taken)
        )
        row = next(free, len(rows))
        if row == len(rows):
            rows.append([])
        rows[row].append((begin, begin + width))
        found.append(row)
    return found


class BoxRow(NamedTuple):
    """The values of one team: the box is of `completed` runs; `failed` valid runs are marked."""

    who: str
    completed: tuple[float, ...]
    failed: tuple[float, ...] = ()

    @property
    def box(self) -> tuple[float, ...]:
        """Smallest, first quartile, median, third quartile, largest; empty for few values."""
        if len(self.completed) < FEWEST_FOR_A_BOX:
            return ()
        quartiles = statistics.quantiles(self.completed, n=4, method="inclusive")
        return min(self.completed), *quartiles, max(self.completed)

    @property
    def points(self) -> tuple[float, ...]:
        return self.completed if len(self.completed) <= MOST_POINTS else ()


def box_scale(rows: Sequence[BoxRow], *, all_shown: bool = False) -> Scale:
    """Failed runs beyond it stand at its edge, unless `all_shown` stretches it."""
    failed = [value for row in rows for value in row.failed]
    completed = [value for row in rows for value in row.completed]
    return Scale.of(completed + failed * all_shown, failed)


class DayPoint(NamedTuple):
    """The value of one run, at its start, s since the epoch.

    Points of one `curve`, the number of its condition, are joined if `completed`. `spread` is the
    expanded uncertainty; 0 = not known.
    """

    time: float
    value: float
    curve: int
    completed: bool
    spread: float = 0.0


class DayCurve(NamedTuple):
    """One indicator over a day; `points` in order of time, `marks` with words on the time axis."""

    points: Sequence[DayPoint]
    marks: Sequence[tuple[float, str]]
    day: Scale
    scale: Scale
    spoken: str

    @property
    def joined(self) -> Iterator[tuple[DayPoint, DayPoint]]:
        by_curve = sorted((p for p in self.points if p.completed), key=attrgetter("curve"))
        for _, points in groupby(by_curve, attrgetter("curve")):
            yield from pairwise(points)

    @property
    def last(self) -> list[DayPoint]:
        """The last point of each curve, where there are several curves."""
        found = {point.curve: point for point in self.points}
        return list(found.values()) if len(found) > 1 else []

    def across(self, time: float) -> float:
        """Percent of the width; the letters of the scale stand before."""
        return round(17 + 0.8 * self.day.at(time), 3)

    def down(self, value: float) -> float:
        """Pixels from above."""
        return round(90 - 0.84 * self.scale.at(value), 2)
