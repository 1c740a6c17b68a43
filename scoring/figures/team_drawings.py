"""Drawings of many runs: boxes, curves of a day, phases beside each other."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

from scoring.figures.run_drawings import (
    BAND,
    BLUE,
    GREY,
    ORANGE,
    RED,
    TICK_ROOM,
    Interval,
    across,
    axis,
    bars,
    drawing,
    line,
    ticks,
)
from scoring.protocol import Step

# Where the time of a run went: its phases, and runs beside each other as bars.
#
# Plain data to SVG, without matplotlib.


BAR = 26
"""Height of a bar and of what is around it, px."""

_INSET = 4


class TimedPhase(Enum):
    """A part of a run, up to `step`, or to the stop if None."""

    TOUCH = (Step.TOUCH, "start to touch", "#7a8fb0")
    OPEN = (Step.OPEN, "touch to opening", "#d95f02")
    CROSS = (Step.CROSS, "opening to crossed", "#1f4e9e")
    CLOSE = (Step.CLOSE, "crossed to closed", "#2a8a6e")
    LOCK = (Step.LOCK, "closed to locked", "#8a5a9e")
    REST = (None, "no further step", "#bbbbbb")

    def __init__(self, step: Step | None, words: str, colour: str) -> None:
        self.step = step
        self.words = words
        self.colour = colour


PhaseTimes = Mapping[TimedPhase, float]
"""How long each phase was, s; a phase that was not completed is missing."""


def phases_of(
    done: Mapping[Step, float], start: float, stop: float | None
) -> dict[TimedPhase, float]:
    """The phases of a run, in order; times in s. Without a `stop` the last one is not known."""
    found: dict[TimedPhase, float] = {}
    at = start
    for phase in TimedPhase:
        time = stop if phase.step is None else done.get(phase.step)
        if time is None and phase.step is not None:
            continue  # no step counts after one that does not
        if time is not None and (time > at or phase.step not in (None, Step.LOCK)):
            found[phase] = max(0.0, time - at)
            at = max(at, time)
    return found


def median_phases(runs: Iterable[PhaseTimes]) -> dict[TimedPhase, float]:
    """The median of each phase over the runs that completed it."""
    every = list(runs)
    known = {
        phase: [run[phase] for run in every if phase in run]
        for phase in TimedPhase
        if phase.step is not None
    }
    return {phase: statistics.median(times) for phase, times in known.items() if times}


def phase_bars(runs: Sequence[PhaseTimes], alternative: str) -> str:
    """A bar for each run, from above, over one time axis, as an SVG element."""
    longest = max((sum(run.values()) for run in runs), default=0.0)
    window = (0.0, max(longest, 1e-3))
    parts = []
    for row, run in enumerate(runs):
        at = 0.0
        for phase, time in run.items():
            top, height = BAR * row + _INSET, BAR - 2 * _INSET
            piece = bars([(at, at + time)], window, top, height) if time else ""
            parts.append(f'<g style="fill: {phase.colour}">{piece}</g>')
            at += time
    bottom = BAR * len(runs) + 2
    parts.append(f'<g style="fill: {GREY}; stroke: {GREY}">{axis(window, bottom)}</g>')
    return drawing(parts, bottom + TICK_ROOM, alternative)


# The scale of an indicator in drawings of many runs: range and ticks.


FAILED = "\N{MULTIPLICATION SIGN}"

_ROOM = 0.08


def shown_values(leading: Sequence[float], others: Iterable[float] = ()) -> Interval:
    """The range of a drawing: all of `leading`, `others` only where they fit (or lead alone)."""
    values = leading or tuple(others) or (0.0, 1.0)
    low, high = min(values), max(values)
    room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
    return low - room, high + room


def few_ticks(window: Interval, most: int) -> list[float]:
    """Round values within a window, not many more than `most`."""
    found = ticks(window)
    return found[:: max(1, round(len(found) / most))]


ROW = 20
"""Height of a team's row, px."""

FEWEST_FOR_A_BOX = 5
"""Fewer values are drawn as points alone."""


@dataclass(frozen=True, slots=True)
class BoxRow:
    """The values of one team: the box is of `completed` runs; `failed` valid runs are marked."""

    completed: tuple[float, ...]
    failed: tuple[float, ...] = ()


def box_plot(rows: Sequence[BoxRow], alternative: str, *, all_shown: bool = False) -> str:
    """Rows of one indicator, a team each, as SVG.

    A box is the middle half of the values with their median; its line goes from the smallest to the
    largest. Failed runs beyond the scale stand at its edge, unless `all_shown` stretches it.
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


# The values of one indicator over a day: a curve for each condition, a point for each run.


HEIGHT = 84
"""Height of the plot without its axis, px."""

_LEFT, _RIGHT = 17.0, 97.0  # percent of the width: letters stand before
_LEVELS = 4  # round values on the scale


@dataclass(frozen=True, slots=True)
class DayPoint:
    """The value of one run, at its start, s since the epoch.

    Points of one `curve`, the number of its condition, are joined if `completed`. `spread` is the
    expanded uncertainty; 0 = not known.
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
    """One indicator as SVG, as wide as its place; `points` in order of time.

    `marks` are times on the axis, s since the epoch, and their words. Failed runs beyond the scale
    stand at its edge, unless `all_shown` stretches it.
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
