"""The curves behind a result, as plain data that can cross a socket.

NumPy is not imported here: screens import these types, and only `curves_of` works on arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from scoring.figure_table import Quantity
from scoring.protocol import Outcome

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scoring.result import Result
    from scoring.rows import Rows

    Array = NDArray[np.float64]


MOST_CURVE_POINTS = 20_000
"""Most points of one quantity, over all its stretches."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One stretch of a quantity without gaps; as many times as values, all finite.

    Times are s since the run's start, increasing; values have the quantity's unit.
    """

    time: tuple[float, ...]
    value: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Curves:
    """Data for the figures of a run (protocol section 6).

    A quantity is a series of stretches with data gaps between them. Times may reach beyond the
    run: the settle time, or the whole recording, as the ruleset has it. All quantities are empty
    for an aborted run and for one without data.

    Attributes:
        duration: from the start to the stop, or to the last datum of a run without a stop, s.
        events: s since the start, and the event's name as in the event file.
    """

    duration: float
    stretches: Mapping[Quantity, tuple[Curve, ...]] = field(default_factory=dict)
    events: tuple[tuple[float, str], ...] = ()

    def curves_of(self, quantity: Quantity) -> tuple[Curve, ...]:
        return self.stretches.get(quantity, ())

    @property
    def empty(self) -> bool:
        return not any(self.stretches.values())

    @property
    def extent(self) -> tuple[float, float]:
        """First and last time that a figure must show, s since the start."""
        drawn = [stretch for stretches in self.stretches.values() for stretch in stretches]
        first = min((stretch.time[0] for stretch in drawn), default=0.0)
        last = max((stretch.time[-1] for stretch in drawn), default=0.0)
        return min(0.0, first), max(self.duration, last)


def curves_of(result: Result, rows: Rows) -> Curves:
    """The curves of a scored run, thinned to `MOST_CURVE_POINTS` each without losing extremes."""
    start, stop = result.start, result.stop
    events = tuple((event.since_start, str(event.event)) for event in result.events)
    ran = 0.0 if stop is None else max(0.0, stop - start)
    if result.outcome is Outcome.ABORTED:
        return Curves(ran, events=events)
    by_quantity = {quantity: _curve(*rows.series(quantity), start, rows) for quantity in Quantity}
    curves = Curves(
        ran, {quantity: curve for quantity, curve in by_quantity.items() if curve}, events
    )
    return curves if stop is not None else replace(curves, duration=curves.extent[1])


def _curve(time: Array, value: Array, start: float, rows: Rows) -> tuple[Curve, ...]:
    """The finite values; one that is not, or a gap, ends a stretch."""
    import numpy as np

    finite = np.flatnonzero(np.isfinite(time) & np.isfinite(value))
    time = time[finite] - start
    value = value[finite]
    broken = (np.diff(time) > rows.thresholds.largest_gap) | (np.diff(finite) > 1)
    kept = _extremes(value)
    borders = np.searchsorted(kept, np.flatnonzero(broken) + 1)
    parts = zip(np.split(time[kept], borders), np.split(value[kept], borders), strict=True)
    return tuple(Curve(tuple(t.tolist()), tuple(v.tolist())) for t, v in parts if t.size)


def _extremes(value: Array) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each part."""
    import numpy as np

    if value.size <= MOST_CURVE_POINTS:
        return np.arange(value.size)
    width = -(-value.size // (MOST_CURVE_POINTS // 2))
    padded = np.pad(value, (0, -value.size % width), mode="edge")
    parts = padded.reshape(-1, width)
    first = np.arange(len(parts)) * width
    return np.union1d(first + parts.argmin(axis=1), first + parts.argmax(axis=1))
