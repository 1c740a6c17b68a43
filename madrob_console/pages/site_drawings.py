"""Small drawings of all indicators: boxes of teams, curves over a day."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

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
)
from madrob_console.pages.site_content import drawable
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import value_text

BOXES_NOTE = (
    f"Circles: completed runs, of a team with up to {MOST_POINTS}; of more than {MOST_TEAMS} teams "
    "only where there is no box. "
    f"From {FEWEST_FOR_A_BOX} of them on a box has their middle half, its "
    "thick line is the median, the thin one goes from the smallest to the largest. "
    f"{FAILED}: runs that failed, in no box and, where they lie beyond the scale, at its edge. "
    "Before them: how many completed + failed."
)
CURVES_NOTE = (
    "Points: completed runs with their expanded uncertainty, joined within a condition, whose "
    f"number stands at the last one. {FAILED}: runs that failed, in no curve and, where they lie "
    "beyond the scale, at its edge."
)

_MOST_MARKS = 5  # times on an axis
_STEPS = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400)


class Box(NamedTuple):
    """A box plot of an indicator, a row a team."""

    name: IndicatorName
    rows: Sequence[BoxRow]
    scale: Scale
    spoken: str


def boxes(runs: Mapping[int, Sequence[RunSummary]], who: Callable[[int], str]) -> Iterator[Box]:
    """A box plot for each indicator that has a value; all runs of one condition."""
    for name in IndicatorName:
        rows = [_box_row(who(subject), found, name) for subject, found in runs.items()]
        if any(row.completed or row.failed for row in rows):
            words = [f"{row.who}: {_spoken(row)}" for row in rows]
            spoken = f"{_caption(name)}. {'; '.join(words)}"
            yield Box(name, rows, box_scale(rows, all_shown=name.spec.counts), spoken)


def _box_row(who: str, runs: Sequence[RunSummary], name: IndicatorName) -> BoxRow:
    values = [(run.outcome, value) for run in runs if (value := drawable(run, name)) is not None]
    return BoxRow(
        who,
        tuple(value for outcome, value in values if outcome is Outcome.COMPLETED),
        tuple(value for outcome, value in values if outcome is not Outcome.COMPLETED),
    )


def _spoken(row: BoxRow) -> str:
    told = [_values(row.completed, "completed"), _values(row.failed, "failed")]
    return ", ".join(filter(None, told)) or "no value"


def _values(values: Sequence[float], word: str) -> str:
    if not values:
        return ""
    return f"{len(values)} {word} from {value_text(min(values))} to {value_text(max(values))}"


def curves(runs: Sequence[RunSummary]) -> Iterator[tuple[IndicatorName, DayCurve]]:
    """A curve over the day for each indicator that has a value; at least one run, oldest first."""
    day = runs[0].started, runs[-1].started
    marks = clock_marks(*day)
    for name in IndicatorName:
        points = [
            DayPoint(
                run.started,
                value,
                run.condition,
                run.outcome is Outcome.COMPLETED,
                known.expanded if (known := run.uncertainties.get(name)) else 0.0,
            )
            for run in runs
            if (value := drawable(run, name)) is not None
        ]
        if points:
            spoken = f"{_caption(name)}. The tables above have its values."
            leading = [one.value for one in points if one.completed or name.spec.counts]
            scale = Scale.of(leading, [one.value for one in points])
            yield name, DayCurve(points, marks, Scale(*day), scale, spoken)


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
