"""The values of one indicator over a day: a curve for each condition, a point for each run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from scoring.figures.colours import BAND, BLUE, GREY, RED
from scoring.figures.event_labels import Interval
from scoring.figures.fluid import TICK_ROOM, drawing
from scoring.figures.value_scale import FAILED, few_ticks, shown_values

HEIGHT = 84
"""Of the plot without its axis, px."""

_LEFT, _RIGHT = 17.0, 97.0  # percent of the width: letters stand before
_LEVELS = 4  # round values on the scale


@dataclass(frozen=True, slots=True)
class DayPoint:
    """The value of one run.

    Attributes:
        time: of its start, s since the epoch.
        value: of the indicator.
        curve: the number of its condition: points of one are joined.
        completed: else it is marked as failed, and in no curve.
        spread: the expanded uncertainty; 0 = not known.
    """

    time: float
    value: float
    curve: int
    completed: bool
    spread: float = 0.0


def day_curve(
    points: Sequence[DayPoint],
    marks: Sequence[tuple[float, str]],
    day: Interval,
    alternative: str,
    *,
    all_shown: bool = False,
) -> str:
    """One indicator as SVG, as wide as its place.

    Args:
        points: at least one, by time.
        marks: times on the axis and what stands there.
        day: the time that is shown, s since the epoch.
        alternative: what it shows, for those who cannot see it.
        all_shown: what failed stretches the scale, too; else it stands at its edge.
    """
    window = shown_values(
        [point.value for point in points if point.completed or all_shown],
        [point.value for point in points],
    )

    def left(time: float) -> float:
        part = (time - day[0]) / ((day[1] - day[0]) or 1.0)
        return round(_LEFT + (_RIGHT - _LEFT) * min(max(part, 0.0), 1.0), 3)

    def top(value: float) -> float:
        part = (value - window[0]) / (window[1] - window[0])
        return round(HEIGHT * (1 - min(max(part, 0.0), 1.0)), 2) + 6

    grid = [
        f'<line x1="{_LEFT:g}%" x2="100%" y1="{top(tick):g}" y2="{top(tick):g}" '
        f'style="stroke: {BAND}"/>'
        f'<text x="{_LEFT - 1:g}%" y="{top(tick) + 4:g}" text-anchor="end">{tick:g}</text>'
        for tick in few_ticks(window, _LEVELS)
    ]
    bottom = HEIGHT + 12
    scale = [f'<line x1="{_LEFT:g}%" x2="100%" y1="{bottom}" y2="{bottom}"/>']
    for time, words in marks:
        place = left(time)
        anchor = "end" if place > _RIGHT - 4 else "middle"
        scale.append(
            f'<line x1="{place:g}%" x2="{place:g}%" y1="{bottom}" y2="{bottom + 4}"/>'
            f'<text stroke="none" x="{place:g}%" y="{bottom + 16}" text-anchor="{anchor}">'
            f"{words}</text>"
        )
    named = {point.curve: point for point in points}  # the last one of each
    curves: dict[int, list[DayPoint]] = defaultdict(list)
    drawn = []
    for point in points:
        x, y = left(point.time), top(point.value)
        if point.completed:
            curves[point.curve].append(point)
            drawn.append(f'<circle cx="{x:g}%" cy="{y:g}" r="3.5" style="fill: {BLUE}"/>')
        else:
            drawn.append(
                f'<text x="{x:g}%" y="{y + 4:g}" text-anchor="middle" '
                f'style="color: {RED}; font-weight: bold">{FAILED}</text>'
            )
        if len(named) > 1 and named[point.curve] is point:
            anchor, aside = ("end", -6) if x > _RIGHT - 4 else ("start", 5)
            drawn.append(
                f'<text x="{x:g}%" dx="{aside}" y="{y - 4:g}" text-anchor="{anchor}">'
                f"{point.curve}</text>"
            )
    joined = [
        f'<line x1="{left(a.time):g}%" y1="{top(a.value):g}" '
        f'x2="{left(b.time):g}%" y2="{top(b.value):g}"/>'
        for curve in curves.values()
        for a, b in pairwise(curve)
    ]
    spreads = [
        f'<line x1="{left(point.time):g}%" x2="{left(point.time):g}%" '
        f'y1="{top(point.value - point.spread):g}" y2="{top(point.value + point.spread):g}"/>'
        for curve in curves.values()
        for point in curve
        if point.spread
    ]
    parts = [
        f'<g style="fill: {GREY}">{"".join(grid)}</g>',
        f'<g style="fill: {GREY}; stroke: {GREY}">{"".join(scale)}</g>',
        f'<g style="stroke: {BLUE}; stroke-width: 1">{"".join((*joined, *spreads))}</g>',
        *drawn,
    ]
    return drawing(parts, bottom + TICK_ROOM, alternative)
