"""Two-valued signals: their states, and the edges by which events are found (section 4)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

_STAMP = 1e-6
"""Stamps are known to 238 ns, as numbers of seconds since the epoch."""


class Edge(NamedTuple):  # the cheapest frozen type: a strip that flickers makes 500 a second
    """A two-valued signal became `value`.

    Attributes:
        time: at which its first reading says so, s since the epoch.
        value: what it became.
        since: time of the reading before, which did not say so yet, s since the epoch; None =
            there was none, or the edge is no reading's (a signal that is up at the start).
        reading: number of its first reading, counted from 1; of an edge at the start the first
            one that said so, before it.
    """

    time: float
    value: bool
    since: float | None = None
    reading: int = 0


def edges_until(edges: Sequence[Edge], time: float) -> int:
    """How many of the edges of one signal, which alternate and are in order, are up to `time`."""
    return bisect_right(edges, time, key=lambda edge: edge.time)


@dataclass(frozen=True, slots=True)
class Held:
    """How long a state was held.

    Attributes:
        readings: that said so one after the other.
        seconds: from the first of them to the first that said otherwise, or to the last.
    """

    readings: int
    seconds: float


class BinarySignal:
    """A two-valued signal whose edges count from the start of the run.

    Before the start only its state is kept. If it is up at the start it rises at the start.

    Args:
        hold: a state counts when it has been held for so long, s; its edge is at the first reading
            of it. 0 = at once.

    Attributes:
        state: what it is now; None = not known yet.
        edges: since the start.
        begun: whether the run has started.
        readings: so many were taken.
        newest: time of the last one, s since the epoch; None before any.
    """

    __slots__ = ("_began", "_hold", "_pending", "begun", "edges", "newest", "readings", "state")

    def __init__(self, hold: float = 0.0) -> None:
        self.state: bool | None = None
        self.edges: list[Edge] = []
        self.begun = False
        self.readings = 0
        self.newest: float | None = None
        self._hold = hold
        self._pending: Edge | None = None
        self._began = 0  # number of the first reading of this state

    def update(self, time: float, value: bool, start: float) -> bool:
        """The signal is `value` at `time`; `start` is the start of the run.

        Returns:
            Whether that is anything new.
        """
        since, self.newest = self.newest, time
        self.readings += 1
        if value is self.state:
            self._pending = None
            if self.begun or time < start:
                return False
        if time >= start and not self.begun:
            self.begin(start)
        if value is self.state:
            return True
        first = Edge(time, value, since, self.readings)
        if self._hold and self.state is not None:
            first = self._pending = self._pending or first
            if time - first.time < self._hold - _STAMP:
                return False
            self._pending = None
        if self.begun and not (self.state is None and not value):
            self._note(first, start)
        self.state, self._began = value, first.reading
        return True

    def _note(self, edge: Edge, start: float) -> None:
        if edge.time >= start:
            self.edges.append(edge)
        elif self.edges:  # held since before the start: then it was not up at the start
            self.edges.pop()
        else:
            self.edges.append(Edge(start, edge.value, None, edge.reading))

    def begin(self, start: float) -> None:
        """The run has started: a signal that was up rises now. Later calls do nothing."""
        if not self.begun:
            self.begun = True
            if self.state:
                self.edges.append(Edge(start, True, None, self._began))

    def at(self, time: float) -> bool:
        """Whether it was up at `time`, by its edges."""
        known = edges_until(self.edges, time)
        return known > 0 and self.edges[known - 1].value

    def held(self, index: int) -> Held:
        """How long the state was held that began with the edge number `index`."""
        edge = self.edges[index]
        if index + 1 < len(self.edges):
            after = self.edges[index + 1]
            return Held(after.reading - edge.reading, after.time - edge.time)
        newest = edge.time if self.newest is None else self.newest
        return Held(self.readings - edge.reading + 1, newest - edge.time)
