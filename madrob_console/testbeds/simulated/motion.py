"""Piecewise smooth functions of time, and where they cross a level."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import pairwise


class Profile(Enum):
    """How a value gets from one rest to the next; both are monotone."""

    MINIMUM_JERK = auto()
    FALL = auto()
    """Ever faster until it hits: a slam."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A way from `origin` at `start` to `target` at `end` (s)."""

    start: float
    end: float
    origin: float
    target: float
    profile: Profile = Profile.MINIMUM_JERK

    def at(self, time: float) -> float:
        """The value at a time within the segment."""
        part = (time - self.start) / (self.end - self.start)
        if part >= 1:
            return self.target
        if self.profile is Profile.FALL:
            done = part * part
        else:
            done = part * part * part * (10 - part * (15 - 6 * part))
        return self.origin + (self.target - self.origin) * done

    @property
    def fastest(self) -> float:
        """The largest speed on the way, per s."""
        factor = 2.0 if self.profile is Profile.FALL else 1.875
        return factor * abs(self.target - self.origin) / (self.end - self.start)


@dataclass(frozen=True, slots=True)
class Motion:
    """A value over all time: at rest before, between and after its segments."""

    initial: float
    segments: tuple[Segment, ...] = ()
    _starts: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_starts", tuple(s.start for s in self.segments))

    def at(self, time: float) -> float:
        """The value at `time` (s)."""
        index = bisect_right(self._starts, time)
        return self.segments[index - 1].at(time) if index else self.initial

    @property
    def end(self) -> float:
        """When it comes to rest for good, s."""
        return self.segments[-1].end if self.segments else 0.0

    @property
    def knots(self) -> list[float]:
        """The instants between which it is monotone, s, in order."""
        return sorted({t for segment in self.segments for t in (segment.start, segment.end)})


class Track:
    """Writes a `Motion` down, move by move."""

    def __init__(self, initial: float) -> None:
        self._initial = initial
        self._segments: list[Segment] = []

    @property
    def value(self) -> float:
        """Where the last move ends."""
        return self._segments[-1].target if self._segments else self._initial

    def move(
        self, start: float, target: float, duration: float, profile: Profile = Profile.MINIMUM_JERK
    ) -> float:
        """Add a move from the last value to `target`; returns when it ends, s."""
        if target == self.value:
            return start + duration
        if self._segments:
            start = max(start, self._segments[-1].end)
        self._segments.append(Segment(start, start + duration, self.value, target, profile))
        return start + duration

    def motion(self) -> Motion:
        """What has been written."""
        return Motion(self._initial, tuple(self._segments))


@dataclass(frozen=True, slots=True)
class Tremor:
    """A shake of the hand on the panel, rad; it dies out towards the closed door.

    Attributes:
        amplitude: rad.
        frequency: Hz.
        start, end: between which the hand is on the handle, s.
        still: below this angle the frame holds the panel still, rad.
        full: from this angle on the shake is full, rad.
    """

    amplitude: float
    frequency: float
    start: float
    end: float
    still: float = 0.1
    full: float = 0.2

    def at(self, time: float, angle: float) -> float:
        """What it adds to a panel that would be at `angle` (rad, abs value)."""
        if not self.start < time < self.end or angle <= self.still:
            return 0.0
        grip = min(1.0, (time - self.start) / 0.2, (self.end - time) / 0.2)
        hold = min(1.0, (angle - self.still) / (self.full - self.still))
        swing = math.sin(math.tau * self.frequency * (time - self.start))
        return self.amplitude * grip * hold * swing

    @property
    def knots(self) -> Iterator[float]:
        """Instants so dense that the sum with a slower motion is monotone between them, s."""
        step = 1 / (32 * self.frequency)
        count = math.ceil((self.end - self.start) / step)
        return (min(self.end, self.start + i * step) for i in range(count + 1))


class Levels:
    """Finds when a function crosses a level.

    Args:
        function: of time (s).
        knots: sorted instants between which it is monotone; before and after it is at rest.
    """

    def __init__(self, function: Callable[[float], float], knots: Iterable[float]) -> None:
        self._function = function
        self._points = [(knot, function(knot)) for knot in knots]

    def crossings(self, *levels: float) -> list[float]:
        """Every instant, s, at which it has just crossed one of `levels`, to a microsecond."""
        return sorted(
            self._root(level, start, end, rising=a < level)
            for level in levels
            for (start, a), (end, b) in pairwise(self._points)
            if (a < level) != (b < level)
        )

    def _root(self, level: float, start: float, end: float, *, rising: bool) -> float:
        while end - start > 1e-6:
            middle = (start + end) / 2
            if (self._function(middle) < level) == rising:
                start = middle
            else:
                end = middle
        return end
