"""Small drawings of all indicators: runs beside each other, a row for each team or condition."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from madrob_console.pages.drawings import FAILED, Point, Scale
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import value_text

PLOTS_NOTE = (
    "Circles: completed runs with their expanded uncertainty, the latest one filled; of many the "
    f"latest. {FAILED}: runs that failed; where they lie beyond the scale, at its edge. Before "
    "them: how many completed + failed."
)

_MOST_POINTS = 60  # of all rows of a drawing: more make a large page

_LARGEST = 1e12  # of a value that can be drawn

_LEVELS = Scale(0.0, 6.0)


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
    """A drawing for each indicator that has a value; runs are the oldest first."""
    most = max(1, _MOST_POINTS // max(1, len(named)))
    for name in IndicatorName:
        rows = [_row(words, _points(runs, name), most) for words, runs in named.items()]
        if shown := [point for row in rows for point in row.points]:
            words = [f"{row.name}: {_spoken(row)}" for row in rows]
            scale = _LEVELS if name is IndicatorName.CAPABILITY_LEVEL else Scale.of(shown)
            yield ValuePlot(name, rows, scale, f"{_caption(name)}. {'; '.join(words)}")


def _row(name: str, points: Sequence[Point], most: int) -> PlotRow:
    completed = sum(point.completed for point in points)
    return PlotRow(name, points[-most:], completed, len(points) - completed)


def _spoken(row: PlotRow) -> str:
    values = (value_text(p.value) + ("" if p.completed else " failed") for p in row.points)
    return ", ".join(values) or "no value"


def _points(runs: Iterable[RunSummary], name: IndicatorName) -> list[Point]:
    """Values of valid runs that can be drawn; a failed run has no execution time."""
    return [
        Point(
            value,
            run.outcome is Outcome.COMPLETED,
            uncertainty.expanded if uncertainty and 0 < uncertainty.expanded < _LARGEST else 0.0,
        )
        for run in runs
        if run.valid
        and abs(value := run.values.get(name, _LARGEST)) < _LARGEST
        and not (name is IndicatorName.EXECUTION_TIME and run.outcome is not Outcome.COMPLETED)
        for uncertainty in [run.uncertainties.get(name)]
    ]


def _caption(name: IndicatorName) -> str:
    return f"{name.words}{unit_and_direction(name)}"


def unit_and_direction(name: IndicatorName) -> str:
    return f", {unit_text(name.spec.unit)}; {name.spec.better} is better"
