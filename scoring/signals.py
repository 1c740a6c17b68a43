"""Two-valued signals, with the edges by which events are found (section 4)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple


class Edge(NamedTuple):  # the cheapest frozen type: a strip that flickers makes 500 a second
    """A two-valued signal became `value`.

    Attributes:
        time: of the first reading of the new value, s since the epoch.
        since: time of the reading before; None = there was none, or the signal was up at the start.
        reading: number of the first reading, from 1; may lie before an edge at the start.
    """

    time: float
    value: bool
    since: float | None = None
    reading: int = 0


def edges_until(edges: Sequence[Edge], time: float) -> int:
    """How many edges of one signal, in order, lie up to `time`."""
    return bisect_right(edges, time, key=lambda edge: edge.time)


@dataclass(frozen=True, slots=True)
class Held:
    """How long a state was held: consecutive readings, and s to the next other one or the last."""

    readings: int
    seconds: float


class BinarySignal:
    """A two-valued signal whose edges count from the start of the run.

    Before the start only its state is kept (None = not known yet); if it is up at the start, it
    rises there.
    """

    __slots__ = ("_began", "begun", "edges", "newest", "readings", "state")

    def __init__(self) -> None:
        self.state: bool | None = None
        self.edges: list[Edge] = []
        self.begun = False
        self.readings = 0
        self.newest: float | None = None
        self._began = 0  # number of the first reading of this state

    def update(self, time: float, value: bool, start: float) -> bool:
        """Take a reading; return whether it changes anything."""
        value = bool(value)  # one of NumPy is no True
        since, self.newest = self.newest, time
        self.readings += 1
        if value is self.state and (self.begun or time < start):
            return False
        if time >= start:
            self.begin_run(start)
        if value is self.state:
            return True
        if self.begun and not (self.state is None and not value):
            self.edges.append(Edge(time, value, since, self.readings))
        self.state, self._began = value, self.readings
        return True

    def begin_run(self, start: float) -> None:
        """The run has started: a signal that was up rises now. Later calls do nothing."""
        if not self.begun:
            self.begun = True
            if self.state:
                self.edges.append(Edge(start, True, None, self._began))

    def at(self, time: float) -> bool:
        count = edges_until(self.edges, time)
        return count > 0 and self.edges[count - 1].value

    def held(self, index: int) -> Held:
        edge = self.edges[index]
        if index + 1 < len(self.edges):
            after = self.edges[index + 1]
            return Held(after.reading - edge.reading, after.time - edge.time)
        newest = edge.time if self.newest is None else self.newest
        return Held(self.readings - edge.reading + 1, newest - edge.time)
