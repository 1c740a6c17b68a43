"""Two-valued signals, the edges by which events are found, and what these decide (section 4)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import Signal


class Edge(NamedTuple):  # the cheapest frozen type: a strip that flickers makes 500 a second
    """A two-valued signal became `value` at `time`, s since the epoch."""

    time: float
    value: bool


class EdgeKind(Enum):
    """What an edge decides: its words, and the indicators that depend on it (section 11)."""

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

    @property
    def under_sensors(self) -> bool:
        """Whether passage sensors saw it, of which the panel masks some."""
        return self in (EdgeKind.ARRIVAL, EdgeKind.DEPARTURE)


class DecidingEdge(NamedTuple):
    """An edge on which indicators depend; `time` in s since the epoch."""

    kind: EdgeKind
    signal: Signal
    time: float


def edges_until(edges: Sequence[Edge], time: float) -> int:
    """Return how many edges of one signal, in order, lie up to `time`."""
    return bisect_right(edges, time, key=lambda edge: edge.time)


class BinarySignal:
    """A two-valued signal whose edges count from the start of the run.

    Before the start only its state is kept (None = not known yet); if it is up at the start, it
    rises there.
    """

    __slots__ = ("begun", "edges", "state")

    def __init__(self) -> None:
        self.state: bool | None = None
        self.edges: list[Edge] = []
        self.begun = False

    def update(self, time: float, value: bool, start: float) -> bool:
        """Take a reading and return whether it changes anything."""
        value = bool(value)  # one of NumPy is no True
        if value is self.state and (self.begun or time < start):
            return False
        if time >= start:
            self.begin_run(start)
        if value is self.state:
            return True
        if self.begun and (value or self.state is not None):
            self.edges.append(Edge(time, value))
        self.state = value
        return True

    def begin_run(self, start: float) -> None:
        """The run has started: a signal that was up rises now. Later calls do nothing."""
        if not self.begun:
            self.begun = True
            if self.state:
                self.edges.append(Edge(start, True))

    def at(self, time: float) -> bool:
        count = edges_until(self.edges, time)
        return count > 0 and self.edges[count - 1].value
