"""How a camera's clock stands beside the testbed's, by stamps and reception.

Both reach the same machine, whose log times are steady. A message is never logged before it was
stamped but by a clock that is off, and seldom much later: the lowest of its delays, log time minus
stamp, is the clock's offset and the shortest time on the way. The two lowest delays apart are the
two clocks apart. How long messages are on their way at least nobody can tell from this: a camera
whose pictures all come 0.1 s late looks like one whose clock is 0.1 s behind.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import NamedTuple

FEWEST = 5
"""Fewer messages tell nothing of a clock."""

STEP = 0.5
"""A delay that changes by more than this, and stays so, is a clock that was stepped, s."""

LEAST_DRIFT = 0.002
"""A change over the whole recording below this is not told, s."""

_LOW, _HIGH = 0.05, 0.2
_WINDOWS = 8
_NEIGHBOURS = 5  # median of so many: one wrong stamp is no step
_NORMAL = 1.4826  # from the median deviation to the standard deviation
_RESOLUTION = 0.0001  # s


class Arrival(NamedTuple):
    """When a message was stamped, and when it was logged, s since the epoch."""

    stamp: float
    log: float


@dataclass(frozen=True, slots=True)
class _Piece:
    """A time within which the clock was not stepped; its lowest delay is `low` at `at`."""

    begin: float
    at: float
    low: float
    slope: float
    spread: float


class LowestDelay:
    """The lowest delay of a stream of messages, as it changes with time.

    Args:
        arrivals: of its messages, in any order, at least `FEWEST`.

    Attributes:
        steps: how often its clock was stepped.
        drift: by how much the delay grows, s/s; 0 = by nothing that could be told from jitter.

    Raises:
        ValueError: there are fewer.
    """

    def __init__(self, arrivals: Iterable[Arrival]) -> None:
        found = sorted(arrivals, key=lambda one: one.log)
        if len(found) < FEWEST:
            raise ValueError(f"{len(found)} messages tell nothing of a clock")
        pieces = [_piece(part) for part in _unstepped(found)]
        self._pieces = pieces
        self._begins = [piece.begin for piece in pieces]
        self.steps = len(pieces) - 1
        self.drift = max((piece.slope for piece in pieces), key=abs)

    def at(self, log: float) -> float:
        """Log time minus stamp of a message that came without hold-up, s."""
        piece = self._piece_at(log)
        return piece.low + piece.slope * (log - piece.at)

    def spread(self, log: float) -> float:
        """How far `at` may be off for what varies, s."""
        return self._piece_at(log).spread

    def _piece_at(self, log: float) -> _Piece:
        return self._pieces[max(0, bisect_right(self._begins, log) - 1)]


@dataclass(frozen=True, slots=True)
class CameraClock:
    """A camera's clock beside the testbed's.

    Attributes:
        camera: the delays of its frames.
        testbed: those of the testbed's messages.
    """

    camera: LowestDelay
    testbed: LowestDelay

    def offset(self, log: float) -> float:
        """How far the camera's clock is ahead of the testbed's at a log time, s."""
        return self.testbed.at(log) - self.camera.at(log)

    def spread(self, log: float) -> float:
        """How far `offset` may be off for what varies, s; a constant delay is not in it."""
        return math.hypot(self.camera.spread(log), self.testbed.spread(log))

    @property
    def drift(self) -> float:
        """By how much the camera's clock gains on the testbed's, s/s."""
        return self.testbed.drift - self.camera.drift

    def words(self, log: float) -> str:
        """`camera clock +0.132 s +- 0.008 s against the testbed's`, drift and steps behind it."""
        apart = f"{self.offset(log):+.3f} s +- {self.spread(log):.3f} s"
        told = [f"camera clock {apart} against the testbed's"]
        if self.drift:
            told.append(f"gains {1000 * 60 * self.drift:+.1f} ms a minute")
        if self.camera.steps:
            times = "once" if self.camera.steps == 1 else f"{self.camera.steps} times"
            told.append(f"stepped {times} during the recording")
        return ", ".join(told)


def _unstepped(arrivals: Sequence[Arrival]) -> list[Sequence[Arrival]]:
    """Cut where the clock was stepped; no part is too short for a clock."""
    delays = [one.log - one.stamp for one in arrivals]
    cuts = [0]
    for place in range(FEWEST, len(delays) - FEWEST + 1):
        if abs(delays[place] - delays[place - 1]) <= STEP or place - cuts[-1] < FEWEST:
            continue
        before = median(delays[max(cuts[-1], place - _NEIGHBOURS) : place])
        if abs(median(delays[place : place + _NEIGHBOURS]) - before) > STEP:
            cuts.append(place)
    return [arrivals[a:b] for a, b in pairwise([*cuts, len(arrivals)])]


def _piece(arrivals: Sequence[Arrival]) -> _Piece:
    delays = [one.log - one.stamp for one in arrivals]
    middle = (arrivals[0].log + arrivals[-1].log) / 2
    slope = _slope(arrivals, delays)
    level = sorted(
        delay - slope * (one.log - middle) for one, delay in zip(arrivals, delays, strict=True)
    )
    low = _quantile(level, _LOW)
    spread = max(_RESOLUTION, _quantile(level, _HIGH) - low)
    return _Piece(arrivals[0].log, middle, low, slope, spread)


def _slope(arrivals: Sequence[Arrival], delays: Sequence[float]) -> float:
    """The drift, by the lowest delays of parts of the time; 0 where jitter explains it."""
    size = len(arrivals) // _WINDOWS
    if size < FEWEST:
        return 0.0
    lows = []
    for number in range(_WINDOWS):
        part = slice(number * size, (number + 1) * size)
        times = [one.log for one in arrivals[part]]
        lows.append((median(times), min(_trimmed(delays[part]))))
    slopes = [
        (b[1] - a[1]) / (b[0] - a[0])
        for number, a in enumerate(lows)
        for b in lows[number + 1 :]
        if b[0] > a[0]
    ]
    if not slopes:
        return 0.0
    slope = median(slopes)
    level = median(low - slope * at for at, low in lows)
    noise = _NORMAL * median(abs(low - slope * at - level) for at, low in lows)
    change = abs(slope) * (lows[-1][0] - lows[0][0])
    return slope if change > max(LEAST_DRIFT, 4 * noise) else 0.0


def _trimmed(delays: Sequence[float]) -> Sequence[float]:
    """Without the lowest tenth: a wrong stamp now and then is no clock."""
    return sorted(delays)[len(delays) // 10 :]


def _quantile(level: Sequence[float], part: float) -> float:
    return level[int(part * (len(level) - 1))]
