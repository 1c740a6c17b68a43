"""What `templates/drawings.html` draws: scales, bars, values of runs.

A drawing is as wide as its place: widths are in percent of it, letters and heights in pixels, on a
phone and on a wide screen alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from scoring.run_drawings import Interval

FAILED = "\N{MULTIPLICATION SIGN}"

_ROOM = 0.08
_NARROWEST = 230.0  # px: on a phone, beside the names of the lanes
_LETTER_WIDTH = 6.6  # px
_MOST_TICKS = 6
_STEPS = (1, 2, 5, 10)


class Point(NamedTuple):
    """The value of one run; `spread` is its expanded uncertainty, 0 = not known."""

    value: float
    completed: bool
    spread: float = 0.0


class Scale(NamedTuple):
    """The range of an axis."""

    low: float
    high: float

    @classmethod
    def of(cls, points: Iterable[Point]) -> Self:
        """Of all completed runs, or where there are none of the others, with their uncertainties.

        At least four of the largest uncertainty: what cannot be told apart does not look far apart.
        """
        every = list(points)
        shown = [point for point in every if point.completed] or every
        low = min(point.value - point.spread for point in shown)
        high = max(point.value + point.spread for point in shown)
        room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
        room = max(room, 2 * max(point.spread for point in shown) - (high - low) / 2)
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

    def ticks(self) -> list[float]:
        """Round values within the range, not many more than `_MOST_TICKS`."""
        span = (self.high - self.low) / _MOST_TICKS
        power = 10.0 ** math.floor(math.log10(span))
        step = next(n * power for n in _STEPS if n * power >= span * (1 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        ticks = [round(n * step, 9) + 0.0 for n in range(first, last + 1)]
        return ticks[:: max(1, round(len(ticks) / _MOST_TICKS))]


def rows_of_words(marks: Iterable[tuple[float, str]], scale: Scale) -> list[int]:
    """The row of each text, so that none meets another one on a phone either."""
    rows: list[list[Interval]] = []
    row_of_mark = []
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
        row_of_mark.append(row)
    return row_of_mark
