"""The values of one indicator of several teams beside each other: boxes and points."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from scoring.figures.colours import BAND, BLUE, GREY, ORANGE, RED
from scoring.figures.fluid import TICK_ROOM, across, axis, bars, drawing, line
from scoring.figures.value_scale import FAILED, shown_values

ROW = 20
"""Height of a team's row, px."""

FEWEST_FOR_A_BOX = 5
"""Of fewer values there are points alone."""

_INSET = 4  # px between a box and the edge of its row


@dataclass(frozen=True, slots=True)
class BoxRow:
    """The values of one team.

    Attributes:
        completed: of runs that were completed: of these is the box.
        failed: of valid runs that were not: marked, and in no box.
    """

    completed: tuple[float, ...]
    failed: tuple[float, ...] = ()


def box_plot(rows: Sequence[BoxRow], alternative: str, *, all_shown: bool = False) -> str:
    """Rows of one indicator as SVG, as wide as its place.

    A box is the middle half of the values with their median, its line goes from the smallest to the
    largest. What failed does not stretch the scale: beyond it, it stands at the edge.

    Args:
        rows: one a team, from the top.
        alternative: what it shows, for those who cannot see it.
        all_shown: what failed stretches the scale after all.
    """
    failed = [value for row in rows for value in row.failed]
    completed = [value for row in rows for value in row.completed]
    window = shown_values(completed + failed * all_shown, failed)
    parts = []
    for number, row in enumerate(rows):
        top, middle = ROW * number + _INSET, ROW * number + ROW / 2
        if len(row.completed) >= FEWEST_FOR_A_BOX:
            first, median, third = statistics.quantiles(row.completed, n=4, method="inclusive")
            ends = [across(end, window) for end in (min(row.completed), max(row.completed))]
            whisker = f'<line x1="{ends[0]:g}%" x2="{ends[1]:g}%" y1="{middle:g}" y2="{middle:g}"/>'
            box = bars([(first, third)], window, top, ROW - 2 * _INSET)
            stroke = line(median, window, top, top + ROW - 2 * _INSET)
            parts += [
                f'<g style="stroke: {GREY}">{whisker}</g>',
                f'<g style="fill: {BAND}; stroke: {GREY}">{box}</g>',
                f'<g style="stroke: {ORANGE}; stroke-width: 3">{stroke}</g>',
            ]
        points = "".join(
            f'<circle cx="{across(value, window):g}%" cy="{middle:g}" r="3"/>'
            for value in row.completed
        )
        crosses = "".join(
            f'<text x="{across(value, window):g}%" y="{middle + 4:g}" text-anchor="middle">'
            f"{FAILED}</text>"
            for value in row.failed
        )
        parts.append(f'<g style="fill: none; stroke: {BLUE}; stroke-width: 1.5">{points}</g>')
        parts.append(f'<g style="color: {RED}; font-weight: bold">{crosses}</g>')
    bottom = ROW * len(rows) + 2
    parts.append(f'<g style="fill: {GREY}; stroke: {GREY}">{axis(window, bottom)}</g>')
    return drawing(parts, bottom + TICK_ROOM, alternative)
