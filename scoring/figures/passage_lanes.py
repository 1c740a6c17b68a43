"""What the passage sensors saw, one lane a sensor, so that the door occupation can be checked.

Plain data to SVG, without matplotlib. The names of the lanes stand beside the drawing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.figures.colours import BLUE, GREY, ORANGE, RED
from scoring.figures.event_labels import Interval
from scoring.figures.fluid import TICK_ROOM, axis, bars, drawing, line, rows_of_words, words
from scoring.indicator_table import IndicatorName
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, Condition, EventName, PassageSensor, Side
from scoring.result import Result
from scoring.rows import Rows

LANE = 21
"""Height of a lane, px."""

_STATES = 2
"""Lanes above those of the sensors: what follows from sensors."""

_MARGIN = 1.0
"""What is shown before the first of it and after the last, s."""

_WORDS = 14  # height of a row of words, px
_MOST_TOLD = 4  # of a lane, in words
_MOST_SPANS = 500  # of a lane: of a loose contact that is enough


@dataclass(frozen=True, slots=True)
class Lane:
    """One sensor, or a state that follows from sensors.

    Attributes:
        name: in words.
        spans: from when to when there was something, s since the start.
        masked: from when to when the panel passed under it, s since the start.
    """

    name: str
    spans: tuple[Interval, ...]
    masked: tuple[Interval, ...] = ()


@dataclass(frozen=True, slots=True)
class PassageFigure:
    """What the passage sensors saw of a run.

    Attributes:
        window: the time that is shown, s since the start.
        lanes: from above: the occupation, the open door, then the sensors.
        marks: approach, leaving and stop, by time, s since the start, in words.
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
        """What it shows, in words and numbers."""
        said = [f"{text} at {time:.2f} s" for time, text in self.marks]
        for lane in self.lanes:
            told = [f"{a:.2f} to {min(b, self.window[1]):.2f} s" for a, b in lane.spans]
            if (more := len(told) - _MOST_TOLD) > 0:
                told[_MOST_TOLD:] = [f"and {more} more"]
            said.append(f"{lane.name}: {', '.join(told) or 'never'}")
        return "Passage sensors. " + "; ".join(said)


def passage_figure(result: Result, rows: Rows, condition: Condition) -> PassageFigure | None:
    """What there is to draw of a run; None where no passage sensor saw anything.

    Args:
        result: of the run.
        rows: its pre-processed data.
        condition: tells which approach and leaving are meant.
    """
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
            words(time, window, _WORDS * row + 12, text)
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
    """From when to when the door was open."""
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
    """From when to when the panel passed under a sensor."""
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
