"""The curves behind a result, as plain data that can cross a socket.

Nothing here loads the numbers' machinery: screens import the shapes, and only `curves_of` works
on arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from scoring.protocol import Outcome

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scoring.result import Result
    from scoring.rows import Rows

    Array = NDArray[np.float64]

MOST_POINTS = 20_000
"""Points that all stretches of one quantity may have together."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One stretch of a quantity without gaps; as many times as values, all finite.

    Attributes:
        time: s since the run's start, increasing.
        value: in the quantity's unit.
    """

    time: tuple[float, ...]
    value: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Curves:
    """What the figures of a run show (protocol section 6).

    A quantity is a series of stretches; between two of them there is a gap in the data. The
    times may reach beyond the run: the settle time, or all of the recording, as the ruleset has
    it. All quantities are empty for an aborted run and for one without data.

    Attributes:
        duration: from the start to the stop, or to the last datum of a run without a stop, s.
        position: panel angle, rad.
        acceleration: low-passed acceleration of the panel, rad/s^2.
        jerk: jerk of the open panel, rad/s^3.
        force: on the handle, no zero subtracted, N.
        events: s since the start, and the event's name as in the event file.
    """

    duration: float
    position: tuple[Curve, ...] = ()
    acceleration: tuple[Curve, ...] = ()
    jerk: tuple[Curve, ...] = ()
    force: tuple[Curve, ...] = ()
    events: tuple[tuple[float, str], ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not (self.position or self.acceleration or self.jerk or self.force)

    @property
    def extent(self) -> tuple[float, float]:
        """The first and the last instant that a figure must show, s since the start."""
        stretches = (*self.position, *self.acceleration, *self.jerk, *self.force)
        first = min((stretch.time[0] for stretch in stretches), default=0.0)
        last = max((stretch.time[-1] for stretch in stretches), default=0.0)
        return min(0.0, first), max(self.duration, last)


def curves_of(result: Result, rows: Rows) -> Curves:
    """The curves of a scored run, thinned to `MOST_POINTS` each so that no extreme is lost.

    Args:
        result: of the run.
        rows: its pre-processed data.
    """
    start, stop = result.start, result.ending.stop
    events = tuple((event.time - start, str(event.name)) for event in result.events)
    ran = 0.0 if stop is None else max(0.0, stop - start)
    if result.ending.outcome is Outcome.ABORTED:
        return Curves(ran, events=events)
    joint, largest_gap = rows.joint_state, rows.thresholds.largest_gap
    curves = Curves(
        ran,
        _stretches(joint.time - start, joint.position, largest_gap),
        _stretches(joint.time - start, rows.low_passed, largest_gap),
        _stretches(rows.jerk_time - start, rows.jerk, largest_gap),
        _stretches(rows.force_time - start, rows.force, largest_gap),
        events,
    )
    return curves if stop is not None else replace(curves, duration=curves.extent[1])


def _stretches(time: Array, value: Array, largest_gap: float) -> tuple[Curve, ...]:
    """The stretches of finite values without gaps."""
    import numpy as np

    finite = np.isfinite(time) & np.isfinite(value)
    rows = np.flatnonzero(finite)
    if not rows.size:
        return ()
    time, value = time[rows], value[rows]
    broken = (np.diff(time) > largest_gap) | (np.diff(rows) > 1)
    stretch = np.concatenate(([0], np.cumsum(broken)))
    kept = _extremes(value)
    time, value, stretch = time[kept], value[kept], stretch[kept]
    borders = np.flatnonzero(np.diff(stretch)) + 1
    return tuple(
        Curve(tuple(times.tolist()), tuple(values.tolist()))
        for times, values in zip(np.split(time, borders), np.split(value, borders), strict=True)
    )


def _extremes(value: Array) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each bin."""
    import numpy as np

    if value.size <= MOST_POINTS:
        return np.arange(value.size)
    size = -(-value.size // (MOST_POINTS // 2))
    bins = -(-value.size // size)
    padded = np.pad(value, (0, bins * size - value.size), mode="edge").reshape(bins, size)
    first = np.arange(bins) * size
    rows = np.concatenate((first + padded.argmin(axis=1), first + padded.argmax(axis=1)))
    return np.unique(np.minimum(rows, value.size - 1))
