"""Small drawings of all indicators: runs beside each other, a row for each team or condition.

A drawing is as wide as its place: widths are in percent of it, letters and heights in pixels, on a
phone and on a wide screen alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Self

from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import value_text

FAILED = "\N{MULTIPLICATION SIGN}"

PLOTS_NOTE = (
    "Circles: completed runs with their expanded uncertainty, the latest one filled; of many the "
    f"latest. {FAILED}: runs that failed; where they lie beyond the scale, at its edge. Before "
    "them: how many completed + failed."
)

_MOST_POINTS = 60  # of all rows of a drawing: more make a large page
_LARGEST = 1e12  # of a value that can be drawn
_ROOM = 0.08  # of the range, before and after its values
_MOST_STEPS = 6  # between the ticks of an axis


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
    def of(cls, points: Sequence[Point]) -> Self:
        """Return the range of all completed runs, or else of the others, with their uncertainties.

        At least four of the largest uncertainty: what cannot be told apart does not look far apart.
        """
        shown = [point for point in points if point.completed] or points
        low = min(point.value - point.spread for point in shown)
        high = max(point.value + point.spread for point in shown)
        room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
        room = max(room, 2 * max(point.spread for point in shown) - (high - low) / 2)
        return cls(low - room, high + room)

    def at(self, value: float) -> float:
        """Percent of the range.

        What lies beyond stands at its end.
        """
        part = (value - self.low) / (self.high - self.low)
        return round(100 * min(max(part, 0.0), 1.0), 3)

    def ticks(self) -> list[float]:
        """Round values within the range, 7 at most."""
        least = (self.high - self.low) / _MOST_STEPS
        power = 10.0 ** math.floor(math.log10(least))
        step = next(n * power for n in (1, 2, 5, 10) if n * power >= least * (1 - 1e-9))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [round(n * step, 9) for n in range(first, last + 1)]


class PlotRow(NamedTuple):
    """Some runs: the `points` that are drawn, the latest last, and how many there are."""

    name: str
    points: Sequence[Point]
    completed: int
    failed: int


class ValuePlot(NamedTuple):
    """The values of an indicator."""

    name: IndicatorName
    rows: Sequence[PlotRow]
    scale: Scale
    spoken: str


def value_plots(named: Mapping[str, Sequence[RunSummary]]) -> Iterator[ValuePlot]:
    """A drawing for each indicator that has a value.

    Runs are the oldest first.
    """
    most = max(1, _MOST_POINTS // max(1, len(named)))
    for name in IndicatorName:
        rows = []
        shown: list[Point] = []
        spoken = []
        for words, runs in named.items():
            points = _points(runs, name)
            latest = points[-most:]
            completed = sum(point.completed for point in points)
            rows.append(PlotRow(words, latest, completed, len(points) - completed))
            shown += latest
            spoken.append(f"{words}: {_spoken(latest)}")
        if shown:
            levels = name is IndicatorName.CAPABILITY_LEVEL
            scale = Scale(0.0, 6.0) if levels else Scale.of(shown)
            caption = f"{name.words}{unit_and_direction(name)}"
            yield ValuePlot(name, rows, scale, f"{caption}. {'; '.join(spoken)}")


def unit_and_direction(name: IndicatorName) -> str:
    return f", {unit_text(name.spec.unit)}; {name.spec.better} is better"


def _points(runs: Iterable[RunSummary], name: IndicatorName) -> list[Point]:
    """Values of valid runs that can be drawn.

    A failed run has no execution time.
    """
    points = []
    for run in runs:
        completed = run.outcome is Outcome.COMPLETED
        value = run.values.get(name, _LARGEST)
        if not run.valid or abs(value) >= _LARGEST:
            continue
        if name is IndicatorName.EXECUTION_TIME and not completed:
            continue
        uncertainty = run.uncertainties.get(name)
        if uncertainty is not None and 0 < uncertainty.expanded < _LARGEST:
            points.append(Point(value, completed, uncertainty.expanded))
        else:
            points.append(Point(value, completed))
    return points


def _spoken(points: Iterable[Point]) -> str:
    values = [value_text(p.value) + ("" if p.completed else " failed") for p in points]
    return ", ".join(values) or "no value"
