"""Small drawings of all indicators: the runs of teams beside each other, and over a day."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from madrob_console.pages.drawings import FAILED, FEWEST_JOINED, DayCurve, Point, Scale
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import value_text

_FAILED_NOTE = f"{FAILED}: runs that failed; where they lie beyond the scale, at its edge."

ROWS_NOTE = (
    "Circles: completed runs with their expanded uncertainty, of many the latest. "
    f"{_FAILED_NOTE} Before them: how many completed + failed."
)
CURVES_NOTE = (
    "Points: completed runs with their expanded uncertainty; the number of their condition stands "
    f"at the last one. From {FEWEST_JOINED} in a condition on they are joined. {_FAILED_NOTE}"
)

_MOST_POINTS = 60  # of all teams in one drawing: more make a large page

_LARGEST = 1e12  # of a value that can be drawn

_LEVELS = Scale(0.0, 6.0)

_MOST_MARKS = 5  # times on an axis
_STEPS = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400)


class TeamRow(NamedTuple):
    """The runs of one team: the `points` that are drawn, and how many there are."""

    who: str
    points: Sequence[Point]
    completed: int
    failed: int


class TeamPlot(NamedTuple):
    """The values of an indicator, a row for each team."""

    name: IndicatorName
    rows: Sequence[TeamRow]
    scale: Scale
    spoken: str


def team_plots(teams: Mapping[str, Sequence[RunSummary]]) -> Iterator[TeamPlot]:
    """A drawing for each indicator that has a value; all runs of one condition, oldest first."""
    most = max(1, _MOST_POINTS // max(1, len(teams)))
    for name in IndicatorName:
        rows = [_row(who, _points(runs, name), most) for who, runs in teams.items()]
        if shown := [point for row in rows for point in row.points]:
            words = [f"{row.who}: {_spoken(row)}" for row in rows]
            yield TeamPlot(name, rows, _scale(name, shown), f"{_caption(name)}. {'; '.join(words)}")


def _row(who: str, points: Sequence[Point], most: int) -> TeamRow:
    completed = sum(point.completed for point in points)
    return TeamRow(who, points[-most:], completed, len(points) - completed)


def _spoken(row: TeamRow) -> str:
    told = (value_text(p.value) + ("" if p.completed else " failed") for p in row.points)
    return ", ".join(told) or "no value"


def _points(runs: Iterable[RunSummary], name: IndicatorName) -> list[Point]:
    """Values of valid runs that can be drawn; a failed run has no execution time."""
    return [
        Point(
            run.started,
            value,
            run.condition,
            run.outcome is Outcome.COMPLETED,
            known.expanded if known and 0 < known.expanded < _LARGEST else 0.0,
        )
        for run in runs
        if run.valid
        and abs(value := run.values.get(name, _LARGEST)) < _LARGEST
        and not (name is IndicatorName.EXECUTION_TIME and run.outcome is not Outcome.COMPLETED)
        for known in [run.uncertainties.get(name)]
    ]


def _scale(name: IndicatorName, points: Sequence[Point]) -> Scale:
    return _LEVELS if name is IndicatorName.CAPABILITY_LEVEL else Scale.of(points)


def curves(runs: Sequence[RunSummary]) -> Iterator[tuple[IndicatorName, DayCurve]]:
    """A curve over the day for each indicator that has a value; at least one run, oldest first."""
    day = runs[0].started, runs[-1].started
    marks = clock_marks(*day)
    for name in IndicatorName:
        if points := _points(runs, name)[-_MOST_POINTS:]:
            spoken = f"{_caption(name)}. The tables above have its values."
            yield name, DayCurve(points, marks, Scale(*day), _scale(name, points), spoken)


def clock_marks(begin: float, end: float) -> list[tuple[float, str]]:
    """Round local times of day from the first to the last run, with their labels."""
    span = max(end - begin, 1.0)
    step = next((one for one in _STEPS if span / one <= _MOST_MARKS), None)
    if step is None:  # over days
        step = _STEPS[-1] * -(-int(span) // (_STEPS[-1] * _MOST_MARKS))
    east = time.localtime(begin).tm_gmtoff
    first = -(-int(begin + east) // step) * step - east
    times = range(first, int(end) + 1, step) or [int(begin)]
    form = "%d %b" if step >= _STEPS[-1] else "%a %H:%M" if span > _STEPS[-1] else "%H:%M"
    return [(float(at), time.strftime(form, time.localtime(at))) for at in times]


def _caption(name: IndicatorName) -> str:
    return f"{name.words}{unit_and_direction(name)}"


def unit_and_direction(name: IndicatorName) -> str:
    return f", {unit_text(name.spec.unit)}; {name.spec.better} is better"
