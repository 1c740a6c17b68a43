"""Drawings of one run without matplotlib: passage lanes, labels, stretches of curves.

Plain data to SVG, without matplotlib. The names of the lanes stand beside the drawing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from scoring.indicator_table import EventMark, IndicatorName
from scoring.kinematics import Array, Rows
from scoring.protocol import PASSAGE_SENSORS, Condition, EventName, PassageSensor, Side
from scoring.result import Result

# Where the names of events stand above a figure, so that none runs into another one.
#
# Lengths are in points.


Interval = tuple[float, float]
"""From and to, s."""

LABEL_SIZE = 9.5

_LETTER = 0.586 * LABEL_SIZE  # a letter's width on average, and a bit more


@dataclass(frozen=True, slots=True)
class EventLabel:
    """A label above the panels; its line and left end are measured from the axes' left."""

    text: str
    time: float
    line: float
    left: float

    @property
    def right(self) -> float:
        return self.left + _width(self.text)


def labels_of(
    events: Mapping[EventMark, Sequence[float]], window: Interval, width: float, beyond: float
) -> list[EventLabel]:
    """One label for each kind of event in the window: of its first time, or a last closing.

    Times are in s; `beyond` is the room for words to the right of the axes' `width`.
    """
    labels = []
    for mark, times in events.items():
        shown = inside(times, window)
        if not shown:
            continue
        time = shown[-1 if mark is EventMark.CLOSING else 0]
        text = str(mark)
        if len(times) > 1:
            text = f"{mark} {sorted(times).index(time) + 1} of {len(times)}"
        line = width * (time - window[0]) / (window[1] - window[0])
        labels.append(EventLabel(text, time, line, min(line, width + beyond - _width(text) - 2)))
    return labels


def inside(times: Sequence[float], window: Interval) -> list[float]:
    return sorted(time for time in times if window[0] <= time <= window[1])


def rows_of(labels: Sequence[EventLabel]) -> tuple[int, ...]:
    """The row of each label, so that no label or line runs through another one."""

    def cost(rows: tuple[int, ...]) -> tuple[int, int, int]:
        pairs = list(itertools.permutations(zip(labels, rows, strict=True), 2))
        overlaps = sum(r == s and a.left < b.right and b.left < a.right for (a, r), (b, s) in pairs)
        crossings = sum(r > s and b.left < a.line < b.right for (a, r), (b, s) in pairs)
        return overlaps, crossings, sum(rows)

    count = len(labels)
    return min(itertools.product(range(count), repeat=count), key=cost)


def _width(text: str) -> float:
    return _LETTER * len(text)


# Drawings over time as wide as their place, as SVG without matplotlib.
#
# Widths are in percent of the place; letters and heights are in pixels, on a phone and on a wide
# screen alike.


LETTERS = 11
"""Height of letters, px."""

TICK_ROOM = 20
"""Room for a time axis below a drawing, px."""

_LETTER_WIDTH = 0.6 * LETTERS
_NARROWEST = 230.0  # px: on a phone, beside the names of the lanes
_MOST_TICKS = 6
_STEPS = (1, 2, 5, 10)


def across(time: float, window: Interval) -> float:
    """Percent of the width at a time; a time beyond the window stands at its end."""
    part = (time - window[0]) / (window[1] - window[0])
    return round(100 * min(max(part, 0.0), 1.0), 3)


def bars(spans: Iterable[Interval], window: Interval, top: float, height: float) -> str:
    """A bar for each span that touches the window, s; `top` and `height` in px."""
    drawn = []
    for begin, end in spans:
        if begin < window[1] and end > window[0]:
            left = across(begin, window)
            width = max(round(across(end, window) - left, 3), 0.15)  # a short one is seen, too
            drawn.append(
                f'<rect x="{left:g}%" y="{top:g}" width="{width:g}%" height="{height:g}"/>'
            )
    return "".join(drawn)


def line(time: float, window: Interval, top: float, bottom: float) -> str:
    """An upright line, from `top` to `bottom` in px."""
    left = across(time, window)
    return f'<line x1="{left:g}%" x2="{left:g}%" y1="{top:g}" y2="{bottom:g}"/>'


def text_at(time: float, window: Interval, baseline: float, text: str) -> str:
    """Words at a time that stay within the drawing and hide lines, on a baseline in px."""
    left = across(time, window)
    anchor, aside = ("start", 2) if left <= 50 else ("end", -2)
    return (
        f'<text x="{left:g}%" dx="{aside}" y="{baseline:g}" text-anchor="{anchor}" '
        'style="stroke: #ffffff; stroke-width: 3; paint-order: stroke">'
        f"{escape(text)}</text>"
    )


def rows_of_words(marks: Sequence[tuple[float, str]], window: Interval) -> list[int]:
    """The row of each text, by time in s, so that none meets another one on a phone either."""
    ends: list[list[Interval]] = []
    rows = []
    for time, text in marks:
        left, width = across(time, window) / 100 * _NARROWEST, _LETTER_WIDTH * len(text) + 4
        begin = left if left <= _NARROWEST / 2 else left - width
        taken = (begin, begin + width)
        free = (
            row
            for row, others in enumerate(ends)
            if all(taken[1] <= a or b <= taken[0] for a, b in others)
        )
        row = next(free, len(ends))
        if row == len(ends):
            ends.append([])
        ends[row].append(taken)
        rows.append(row)
    return rows


def ticks(window: Interval) -> list[float]:
    span = (window[1] - window[0]) / _MOST_TICKS
    power = 10.0 ** math.floor(math.log10(span))
    step = next(n * power for n in _STEPS if n * power >= span * (1 - 1e-9))
    first, last = math.ceil(window[0] / step - 1e-9), math.floor(window[1] / step + 1e-9)
    return [round(n * step, 9) + 0.0 for n in range(first, last + 1)]


def axis(window: Interval, top: float) -> str:
    """A time axis with its numbers, s; `top` in px."""
    drawn = [f'<line x1="0" x2="100%" y1="{top:g}" y2="{top:g}"/>']
    for tick in ticks(window):
        left = across(tick, window)
        anchor = "start" if left < 4 else "end" if left > 96 else "middle"
        drawn.append(
            f'<line x1="{left:g}%" x2="{left:g}%" y1="{top:g}" y2="{top + 4:g}"/>'
            f'<text stroke="none" x="{left:g}%" y="{top + 16:g}" text-anchor="{anchor}">'
            f"{tick:g}</text>"
        )
    return "".join(drawn)


def drawing(parts: Iterable[str], height: float, alternative: str) -> str:
    """The parts, from behind to the front, as one SVG element; `height` in px."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="100%" height="{height:g}" role="img" '
        f'aria-label={quoteattr(alternative)} style="font: {LETTERS}px sans-serif">'
        f"{''.join(parts)}</svg>"
    )


# Curves as stretches without gaps, thinned for drawing.


def stretches(
    time: Array, value: Array, largest_gap: float, most: int
) -> list[tuple[Array, Array]]:
    """The finite values, thinned to `most` points without losing an extreme.

    A value that is not finite, or an interval above `largest_gap` s, ends a stretch.
    """
    finite = np.flatnonzero(np.isfinite(time) & np.isfinite(value))
    if not finite.size:
        return []
    time, value = time[finite], value[finite]
    broken = (np.diff(time) > largest_gap) | (np.diff(finite) > 1)
    stretch = np.concatenate(([0], np.cumsum(broken)))
    kept = _extremes(value, most)
    time, value, stretch = time[kept], value[kept], stretch[kept]
    borders = np.flatnonzero(np.diff(stretch)) + 1
    return list(zip(np.split(time, borders), np.split(value, borders), strict=True))


def _extremes(value: Array, most: int) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each part."""
    if value.size <= most:
        return np.arange(value.size)
    parts = most // 2
    size, longer = divmod(value.size, parts)
    border = longer * (size + 1)  # the first parts have one row more
    kept = []
    for begin, rows, width in ((0, value[:border], size + 1), (border, value[border:], size)):
        table = rows.reshape(-1, width)
        if table.size:
            first = begin + np.arange(len(table)) * width
            kept += [first + table.argmin(axis=1), first + table.argmax(axis=1)]
    return np.unique(np.concatenate(kept))


# The colours of the figures, the protocol document's; a page may put others in their place.


ORANGE, BLUE, RED, GREY = "#d95f02", "#1f4e9e", "#c00000", "#555555"
"""Position, derived quantities, the data of the indicator, all the rest."""

BAND = "#e0e0e0"


LANE = 21
"""Height of a lane, px."""

_STATES = 2

_MARGIN = 1.0

_WORDS = 14  # height of a row of words, px
_MOST_TOLD = 4  # of a lane, in words
_MOST_SPANS = 500  # of a lane: of a loose contact that is enough


@dataclass(frozen=True, slots=True)
class Lane:
    """One sensor, or a state that follows from sensors; times in s since the start."""

    name: str
    spans: tuple[Interval, ...]
    masked: tuple[Interval, ...] = ()


@dataclass(frozen=True, slots=True)
class PassageFigure:
    """What the passage sensors saw of a run; times in s since the start.

    `lanes` are, from above, the occupation, the open door, then the sensors.
    """

    window: Interval
    lanes: tuple[Lane, ...]
    marks: tuple[tuple[float, str], ...]

    @property
    def head(self) -> float:
        """Height of the words above the lanes, px."""
        return _WORDS * (max(rows_of_words(self.marks, self.window), default=-1) + 1) + 4.0

    @property
    def alternative(self) -> str:
        said = [f"{text} at {time:.2f} s" for time, text in self.marks]
        for lane in self.lanes:
            told = [f"{a:.2f} to {min(b, self.window[1]):.2f} s" for a, b in lane.spans]
            if (more := len(told) - _MOST_TOLD) > 0:
                told[_MOST_TOLD:] = [f"and {more} more"]
            said.append(f"{lane.name}: {', '.join(told) or 'never'}")
        return "Passage sensors. " + "; ".join(said)


def passage_figure(result: Result, rows: Rows, condition: Condition) -> PassageFigure | None:
    """None where no passage sensor saw anything."""
    start = result.start
    occupied = {
        sensor: tuple((a - start, b - start) for a, b in spans[:_MOST_SPANS])
        for sensor, spans in rows.occupied.items()
    }
    if not any(occupied.values()):
        return None
    times = {e.event: e.since_start for e in result.events}
    marks = tuple(_marks(times))
    opened = tuple(_opened(result))
    inner = [t for spans in (*occupied.values(), opened) for span in spans for t in span]
    inner += [time for time, _ in marks]
    finite = [time for time in inner if np.isfinite(time)]
    window = (max(0.0, min(finite) - _MARGIN), max(finite) + _MARGIN)
    begin = times.get(EventName.approaches(condition.starting_side))
    end = times.get(EventName.moves_to(condition.destination_side))
    known = result.indicators[IndicatorName.DOOR_OCCUPATION_TIME].value is not None
    whole = ((begin, end),) if known and begin is not None and end is not None else ()
    sides = (condition.starting_side, condition.destination_side)
    sensors = [s for side in sides for s in PASSAGE_SENSORS if s.side is side]
    lanes = [
        Lane(_sensor_name(s), occupied.get(s, ()), tuple(_masked(s, rows, start))) for s in sensors
    ]
    return PassageFigure(
        window, (Lane("occupation", whole), Lane("door open", opened), *lanes), marks
    )


def passage_svg(figure: PassageFigure) -> str:
    """The lanes as an SVG element, without their names."""
    window, top = figure.window, figure.head
    count = len(figure.lanes)
    bottom = top + LANE * count
    sensors = [(top + LANE * n, lane) for n, lane in enumerate(figure.lanes)][_STATES:]
    upper = zip((RED, ORANGE), figure.lanes, (top, top + LANE), strict=False)
    rulers = "".join(
        f'<line x1="0" x2="100%" y1="{top + LANE * n:g}" y2="{top + LANE * n:g}"/>'
        for n in (0, 1, *range(_STATES, count + 1, (count - _STATES) // 2))
    )
    rows = rows_of_words(figure.marks, window)
    hatches = (
        '<defs><pattern id="masked" width="5" height="5" patternUnits="userSpaceOnUse">'
        f'<path d="M-1 6L6 -1" style="stroke: {GREY}"/></pattern></defs>'
    )
    parts = (
        hatches,
        '<g style="fill: url(#masked)">',
        *(bars(lane.masked, window, y, LANE) for y, lane in sensors),
        f'</g><g style="fill: {BLUE}">',
        *(bars(lane.spans, window, y + 3, LANE - 6) for y, lane in sensors),
        "</g>",
        *(
            f'<g style="fill: {colour}">{bars(lane.spans, window, y + 3, LANE - 6)}</g>'
            for colour, lane, y in upper
        ),
        f'<g style="stroke: {GREY}; stroke-width: 0.5">{rulers}</g>',
        f'<g style="stroke: {GREY}; stroke-dasharray: 3 2">',
        *(
            line(time, window, _WORDS * row + 3, bottom)
            for (time, _), row in zip(figure.marks, rows, strict=True)
        ),
        f'</g><g style="fill: {GREY}">',
        *(
            text_at(time, window, _WORDS * row + 12, text)
            for (time, text), row in zip(figure.marks, rows, strict=True)
        ),
        f'</g><g style="fill: {GREY}; stroke: {GREY}">{axis(window, bottom)}</g>',
    )
    return drawing(parts, bottom + TICK_ROOM, figure.alternative)


def _marks(times: dict[EventName, float]) -> Iterator[tuple[float, str]]:
    for side in Side:
        if (time := times.get(EventName.approaches(side))) is not None:
            yield time, f"approach {side.upper()}"
    for side in Side:
        if (time := times.get(EventName.moves_to(side))) is not None:
            yield time, f"leave {side.upper()}"
    if (time := times.get(EventName.BENCHMARK_STOP)) is not None:
        yield time, "stop"


def _opened(result: Result) -> Iterator[Interval]:
    since: float | None = None
    last = 0.0
    for event in result.events[: 2 * _MOST_SPANS]:
        last = event.since_start
        if event.event is EventName.DOOR_OPENS:
            since = last if since is None else since
        elif event.event is EventName.DOOR_CLOSES and since is not None:
            yield since, last
            since = None
    if since is not None:
        yield since, last


def _masked(sensor: PassageSensor, rows: Rows, start: float) -> Iterator[Interval]:
    low, high = rows.thresholds.mask(sensor.side, sensor.index)
    angle = rows.joint_state.position * sensor.side.sign
    inside = (angle > low) & (angle < high)
    yield from _runs(rows.joint_state.time - start, inside)


def _runs(time: Array, true: NDArray[np.bool_]) -> Iterator[Interval]:
    """The stretches in which something is true; each lasts until the next sample."""
    change = np.flatnonzero(np.diff(np.concatenate(([False], true, [False])).astype(np.int8)))
    for first, after in list(zip(change[::2], change[1::2], strict=True))[:_MOST_SPANS]:
        yield float(time[first]), float(time[min(after, time.size - 1)])


def _sensor_name(sensor: PassageSensor) -> str:
    """`cw_right[3]`, as the protocol numbers them."""
    return f"{sensor.strip}[{sensor.element}]"
