"""What drawings of a run show: curves without gaps, passage lanes.

Plain data without matplotlib.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.indicator_table import IndicatorName
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, Condition, EventName, PassageSensor, Side
from scoring.result import Result
from scoring.rows import Rows

Interval = tuple[float, float]
"""From and to, s."""


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
    rows = _extremes(value, most)
    time, value, stretch = time[rows], value[rows], stretch[rows]
    borders = np.flatnonzero(np.diff(stretch)) + 1
    return list(zip(np.split(time, borders), np.split(value, borders), strict=True))


def _extremes(value: Array, most: int) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each part."""
    if value.size <= most:
        return np.arange(value.size)
    parts = most // 2
    size, longer = divmod(value.size, parts)
    border = longer * (size + 1)  # the first parts have one row more
    extremes = []
    for begin, rows, width in ((0, value[:border], size + 1), (border, value[border:], size)):
        table = rows.reshape(-1, width)
        if table.size:
            first = begin + np.arange(len(table)) * width
            extremes += [first + table.argmin(axis=1), first + table.argmax(axis=1)]
    return np.unique(np.concatenate(extremes))


ORANGE, BLUE, RED, GREY = "#d95f02", "#1f4e9e", "#c00000", "#555555"
"""Position, derived quantities, the data of the indicator, all the rest."""

BAND = "#e0e0e0"

_MARGIN = 1.0

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
    def alternative(self) -> str:
        said = [f"{text} at {time:.2f} s" for time, text in self.marks]
        for lane in self.lanes:
            spans = [f"{a:.2f} to {min(b, self.window[1]):.2f} s" for a, b in lane.spans]
            if (more := len(spans) - _MOST_TOLD) > 0:
                spans[_MOST_TOLD:] = [f"and {more} more"]
            said.append(f"{lane.name}: {', '.join(spans) or 'never'}")
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
    is_timed = result.indicators[IndicatorName.DOOR_OCCUPATION_TIME].value is not None
    whole = ((begin, end),) if is_timed and begin is not None and end is not None else ()
    sides = (condition.starting_side, condition.destination_side)
    sensors = [s for side in sides for s in PASSAGE_SENSORS if s.side is side]
    lanes = [
        Lane(_sensor_name(s), occupied.get(s, ()), tuple(_masked(s, rows, start))) for s in sensors
    ]
    return PassageFigure(
        window, (Lane("occupation", whole), Lane("door open", opened), *lanes), marks
    )


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
