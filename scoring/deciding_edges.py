"""The edges on which indicators depend, and how certain each is (protocol section 11)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import PassageSensor, Side, Signal, Strip
from scoring.signals import BinarySignal, edges_until

_LOOKED_AT = 0.2
"""Time after an edge in which the passage sensors are looked at, s."""

_UNDER_SENSORS = (*map(Signal.of_strip, Strip), Signal.DOOR)
"""The panel masks passage sensors."""


class EdgeKind(Enum):
    """What an edge decides: its words, the signals that decide it, the indicators that use it."""

    TOUCH = (
        "the touch of the handle",
        (Signal.HANDLE,),
        (Name.TIME_TO_HANDLE, Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL),
    )
    OPENING = (
        "the opening of the door",
        (Signal.DOOR,),
        (Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL),
    )
    CLOSING = (
        "the last closing of the door",
        (Signal.DOOR,),
        (Name.EXECUTION_TIME, Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL),
    )
    ARRIVAL = (
        "the arrival under the passage sensors",
        _UNDER_SENSORS,
        (Name.DOOR_OCCUPATION_TIME,),
    )
    DEPARTURE = (
        "the leaving of the passage sensors",
        _UNDER_SENSORS,
        (
            Name.EXECUTION_TIME,
            Name.DOOR_OCCUPATION_TIME,
            Name.PASSAGE_TIME,
            Name.CAPABILITY_LEVEL,
        ),
    )
    LOCKING = ("the locking", (Signal.LATCH,), (Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL))

    def __init__(
        self, words: str, signals: tuple[Signal, ...], indicators: tuple[Name, ...]
    ) -> None:
        self.words = words
        self.signals = signals
        self.indicators = indicators


@dataclass(frozen=True, slots=True)
class DecidingEdge:
    """An edge on which indicators depend.

    Attributes:
        time, since: of the edge and of the reading before, s since the epoch; None = no reading's.
        readings: consecutive ones before or after the edge, whichever are fewer.
        alone: how long the edge rests on one strip of passage sensors only, s; None = not so.
        also: indicators that use it under the run's rules, besides those of its kind.
    """

    kind: EdgeKind
    signal: Signal
    time: float
    since: float | None
    readings: int
    alone: float | None = None
    also: tuple[Name, ...] = ()

    @property
    def indicators(self) -> tuple[Name, ...]:
        return (*self.kind.indicators, *self.also)


def first_rise(
    kind: EdgeKind, signal: Signal, level: BinarySignal, end: float
) -> DecidingEdge | None:
    """The first rise of a signal, if it lies before `end`, s since the epoch."""
    if not level.edges or level.edges[0].time > end:
        return None
    edge = level.edges[0]  # the first edge of a level is a rise
    return DecidingEdge(kind, signal, edge.time, edge.since, level.held(0).readings)


def door_edges(door: BinarySignal, touch: BinarySignal, end: float) -> Iterator[DecidingEdge]:
    """The opening after the touch, and the last closing up to `end`."""
    touched = touch.edges[0].time if touch.edges else door.edges[0].time if door.edges else end
    count = edges_until(door.edges, touched)
    for index in range(max(0, count - 1), min(count + 2, len(door.edges))):
        edge = door.edges[index]
        if edge.value and (edge.time >= touched or index == count - 1):
            held = door.held(index)
            yield DecidingEdge(EdgeKind.OPENING, Signal.DOOR, edge.time, edge.since, held.readings)
            break
    last = edges_until(door.edges, end) - 1
    if last > 0 and not door.edges[last].value:
        edge = door.edges[last]
        readings = min(door.held(last - 1).readings, door.held(last).readings)
        yield DecidingEdge(EdgeKind.CLOSING, Signal.DOOR, edge.time, edge.since, readings)


@dataclass(frozen=True, slots=True)
class _Presence:
    sensor: PassageSensor
    rise: float
    fall: float
    readings: int


def passage_edge(
    kind: EdgeKind,
    levels: Mapping[PassageSensor, BinarySignal],
    sensor: PassageSensor,
    time: float,
) -> DecidingEdge:
    """The arrival or the leaving at `time`, s since the epoch, by all sensors of the side."""
    level = levels[sensor]
    index = edges_until(level.edges, time) - 1
    edge = level.edges[index]
    arrives = kind is EdgeKind.ARRIVAL
    low, high = (time, time + _LOOKED_AT) if arrives else (time - _LOOKED_AT, time)
    side = ((s, v) for s, v in levels.items() if s.side is sensor.side)
    near = [presence for s, v in side for presence in _presences(s, v, low, high)]
    seconds, parts = _unbroken(near, time, forth=arrives)
    readings = max(part.readings for part in parts)
    alone = None
    if len({part.sensor.strip for part in parts}) == 1:
        alone = seconds
    if len({part.sensor for part in parts}) > 1:
        longest = max(parts, key=lambda part: part.readings)
        interval = (longest.fall - longest.rise) / longest.readings
        readings = max(readings, round(seconds / interval) if interval > 0 else 0)
    if not arrives:
        readings = min(readings, level.held(index).readings)
    return DecidingEdge(kind, Signal.of_strip(sensor.strip), edge.time, edge.since, readings, alone)


def departure(
    levels: Mapping[PassageSensor, BinarySignal], time: float, side: Side
) -> DecidingEdge | None:
    """The leaving on a side at `time`, s since the epoch: a last fall, or the stop.

    At the stop, the edge also rests on what is seen of the robot later.
    """
    here = {sensor: level for sensor, level in levels.items() if sensor.side is side}
    for sensor, level in (*here.items(), *levels.items()):  # the other side's may end the run
        count = edges_until(level.edges, time)
        if count and level.edges[count - 1].time == time and not level.edges[count - 1].value:
            return passage_edge(EdgeKind.DEPARTURE, levels, sensor, time)
    there = [
        (level.held(edges_until(level.edges, time) - 1), sensor)
        for sensor, level in here.items()
        if level.at(time)
    ]
    if not there:
        return None
    held, sensor = max(there, key=lambda presence: presence[0].readings)
    alone = held.seconds if len({each.strip for _, each in there}) == 1 else None
    signal = Signal.of_strip(sensor.strip)
    return DecidingEdge(EdgeKind.DEPARTURE, signal, time, None, held.readings, alone)


def _presences(
    sensor: PassageSensor, level: BinarySignal, low: float, high: float
) -> Iterator[_Presence]:
    first = max(0, edges_until(level.edges, low) - 2)
    for index in range(first, edges_until(level.edges, high)):
        edge = level.edges[index]
        if edge.value:
            held = level.held(index)
            yield _Presence(sensor, edge.time, edge.time + held.seconds, held.readings)


def _unbroken(near: list[_Presence], time: float, *, forth: bool) -> tuple[float, list[_Presence]]:
    """How long something was there without a break from `time` on, or up to it, and where."""
    reached, parts = time, list[_Presence]()
    for part in sorted(near, key=lambda p: p.rise if forth else -p.fall):
        meets = part.rise <= reached <= part.fall
        if meets and part not in parts:
            parts.append(part)
            reached = max(reached, part.fall) if forth else min(reached, part.rise)
    return abs(reached - time), parts
