"""The edges on which indicators hang, and on how much each of them rests (protocol section 11)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import PassageSensor, Side, Signal
from scoring.signals import BinarySignal, edges_until

_LOOKED_AT = 0.2
"""So much of what is under the sensors is looked at, from the edge on, s."""


class EdgeKind(Enum):
    """What an edge decides: its words, and the indicators that use it."""

    TOUCH = (
        "the touch of the handle",
        (Name.TIME_TO_HANDLE, Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL),
    )
    OPENING = ("the opening of the door", (Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL))
    CLOSING = (
        "the last closing of the door",
        (Name.EXECUTION_TIME, Name.PASSAGE_TIME, Name.CAPABILITY_LEVEL),
    )
    ARRIVAL = ("the arrival under the passage sensors", (Name.DOOR_OCCUPATION_TIME,))
    DEPARTURE = (
        "the leaving of the passage sensors",
        (
            Name.EXECUTION_TIME,
            Name.DOOR_OCCUPATION_TIME,
            Name.PASSAGE_TIME,
            Name.CAPABILITY_LEVEL,
        ),
    )
    LOCKING = ("the locking", (Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL))

    def __init__(self, words: str, indicators: tuple[Name, ...]) -> None:
        self.words = words
        self.indicators = indicators


@dataclass(frozen=True, slots=True)
class DecidingEdge:
    """An edge on which indicators hang.

    Attributes:
        kind: which indicators, and its words.
        signal: on which it was seen.
        time: of it, s since the epoch.
        since: time of the reading before, s since the epoch; None where it is no reading's.
        readings: on so many consecutive ones it rests, before or after it, whichever is less.
        alone: it rests on one passage sensor only, for so long, s; None = on more, or on others.
        also: indicators that use it besides those of its kind, by the rules of the run.
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
        """All that use it."""
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
    known = edges_until(door.edges, touched)
    for index in range(max(0, known - 1), min(known + 2, len(door.edges))):
        edge = door.edges[index]
        if edge.value and (edge.time >= touched or index == known - 1):
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
    """Something is under one sensor, from `rise` to `fall`, for so many readings."""

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
    """The arrival, or the leaving, that one sensor saw at `time`, s since the epoch.

    It rests on what the sensors of its side saw from it on, or up to it.

    Args:
        kind: arrival or leaving.
        levels: all used sensors.
        sensor: which of them has an edge then.
        time: of the edge.
    """
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
    if len({part.sensor for part in parts}) == 1:
        alone = seconds
    else:
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

    At the stop something is still there: it rests on what is seen of that until then and later.
    """
    here = {sensor: level for sensor, level in levels.items() if sensor.side is side}
    for sensor, level in here.items():
        known = edges_until(level.edges, time)
        if known and level.edges[known - 1].time == time and not level.edges[known - 1].value:
            return passage_edge(EdgeKind.DEPARTURE, levels, sensor, time)
    there = [
        (level.held(edges_until(level.edges, time) - 1), sensor)
        for sensor, level in here.items()
        if level.at(time)
    ]
    if not there:
        return None
    held, sensor = max(there, key=lambda one: one[0].readings)
    alone = held.seconds if len(there) == 1 else None
    signal = Signal.of_strip(sensor.strip)
    return DecidingEdge(EdgeKind.DEPARTURE, signal, time, None, held.readings, alone)


def _presences(
    sensor: PassageSensor, level: BinarySignal, low: float, high: float
) -> Iterator[_Presence]:
    """When something was under a sensor, of what touches [low, high]."""
    first = max(0, edges_until(level.edges, low) - 2)
    for index in range(first, edges_until(level.edges, high)):
        edge = level.edges[index]
        if edge.value:
            held = level.held(index)
            yield _Presence(sensor, edge.time, edge.time + held.seconds, held.readings)


def _unbroken(near: list[_Presence], time: float, *, forth: bool) -> tuple[float, list[_Presence]]:
    """How long something was there without a break from `time` on, or up to it, and by whom."""
    reached, parts = time, list[_Presence]()
    for part in sorted(near, key=lambda p: p.rise if forth else -p.fall):
        meets = part.rise <= reached <= part.fall
        if meets and part not in parts:
            parts.append(part)
            reached = max(reached, part.fall) if forth else min(reached, part.rise)
    return abs(reached - time), parts
