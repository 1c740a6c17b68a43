"""The handle's force at rest (protocol section 11).

NumPy is imported where it is needed, so that screens can hold these types without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scoring.protocol import Thresholds

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

REST_TIME = 0.5
"""How long the handle is looked at, before the start and at the end of the recording, s."""
FEWEST_SAMPLES = 10
"""Fewer samples tell no standard deviation."""
_STEADY_FORCE = 0.1
"""A standard deviation up to this is steady on any testbed, N."""
_STEADY_FACTOR = 3.0
"""A deviation up to this many times that of the quiet handle is steady, too."""


@dataclass(frozen=True, slots=True)
class HandleRest:
    """Samples of the handle force over a stretch in which nobody was to touch it.

    Attributes:
        number: of samples.
        mean: of them, N.
        deviation: their standard deviation (of a sample, n - 1), N.
        span: largest less smallest, N.
        begin: time of the first, s since the epoch.
        end: time of the last, s since the epoch.
    """

    number: int
    mean: float
    deviation: float
    span: float
    begin: float
    end: float

    @property
    def scatter(self) -> str:
        return (
            f"standard deviation {self.deviation:.3f} N, span {self.span:.3f} N "
            f"({self.number} samples in {self.end - self.begin:.2f} s)"
        )


@dataclass(frozen=True, slots=True)
class RestForce:
    """The handle's rest force before and after a run (protocol section 11).

    Attributes:
        before: the last half second before the start; null where the handle was not quiet.
        after: the last half second of the recording; null where the handle was not free in it.
        drift: mean of `after` less the handle zero of the run, N; null without `after`.
        no_before: why there is no `before`, in words; null where there is.
        no_after: why there is no `after`, in words; null where there is.
    """

    before: HandleRest | None = None
    after: HandleRest | None = None
    drift: float | None = None
    no_before: str | None = None
    no_after: str | None = None

    @property
    def words(self) -> str:
        before = self.no_before if self.before is None else f"{self.before.mean:.3f} N before"
        after = self.no_after if self.after is None else f"{self.after.mean:.3f} N after"
        drift = "" if self.drift is None else f", drift {self.drift:+.3f} N"
        return f"{before}; {after}{drift}"

    @property
    def largest(self) -> float:
        """The larger rest force of before and after, N.

        0 where neither is known.
        """
        rests = [rest.mean for rest in (self.before, self.after) if rest is not None]
        return max(rests, key=abs, default=0.0)

    def drifted(self, touch_force: float) -> bool:
        """Return whether the drift exceeds half the touch threshold (N): the zero does not hold."""
        return self.drift is not None and moved(self.drift, touch_force)


def moved(difference: float, touch_force: float) -> bool:
    """Return whether a rest force differs by more than half the touch threshold, N."""
    return abs(difference) > touch_force / 2


def rest_of(times: Sequence[float], forces: Sequence[float]) -> HandleRest | None:
    """Statistics of a handle at rest.

    None if no handle bears such forces.

    Sums are exact, so that the numbers depend on no library.
    """
    number = len(forces)
    try:
        mean = math.fsum(forces) / number
        squares = math.fsum((force - mean) ** 2 for force in forces)
    except OverflowError:
        return None
    return HandleRest(
        number=number,
        mean=mean,
        deviation=math.sqrt(squares / (number - 1)) if number > 1 else 0.0,
        span=max(forces) - min(forces),
        begin=times[0],
        end=times[-1],
    )


def rest_force(
    time: Array, force: Array, start: float, *, zero: float, end: float, thresholds: Thresholds
) -> RestForce:
    """The rest force of a recording's handle before the run and after it.

    A half second counts if it has at least ten samples and no interval above `largest_gap`.

    - **before**: the half second before the start, if its standard deviation is at most half the
      touch threshold.
    - **after**: the last half second of the recording, after the start, if the handle is *free*:
      its standard deviation is at most three times that of `before`, or 0.1 N where that is larger
      or there is no `before`. A force without any change is no rest where there was noise before.

    A hand that presses as evenly as the load cell's noise is not detected.

    Times are in s since the epoch, forces in N without the zero subtracted, both of shape (n,).
    `end` is the newest stamp of any signal.
    """
    before = _stretch(time, force, start, thresholds)
    no_before = None
    if before is None or before.deviation > thresholds.touch_force / 2:
        before = None
        no_before = "the handle was not quiet for half a second before the start"
    after = _stretch(time, force, float(time[-1]), thresholds) if time.size else None
    if after is not None and end - after.end > thresholds.largest_gap + thresholds.largest_skew:
        after = None
    no_after = _not_free(after, before, start)
    if no_after is not None or after is None:
        return RestForce(before, None, None, no_before, no_after)
    return RestForce(before, after, after.mean - zero, no_before)


def _not_free(after: HandleRest | None, before: HandleRest | None, start: float) -> str | None:
    if after is None:
        return "too few samples, or a gap, in the last half second of the recording"
    if after.begin < start:
        return "the recording ends within half a second of the start"
    usual = 0.0 if before is None else before.deviation
    if after.deviation > max(_STEADY_FACTOR * usual, _STEADY_FORCE):
        return "the handle was not free at the end of the recording"
    if after.span == 0 and before is not None and before.span > 0:
        return "the force does not change any more at the end of the recording"
    return None


def _stretch(time: Array, force: Array, end: float, thresholds: Thresholds) -> HandleRest | None:
    """The samples in (end - half a second, end].

    None if they do not suffice.
    """
    import numpy as np

    first, last = np.searchsorted(time, [end - REST_TIME, end], side="right")
    if last - first < FEWEST_SAMPLES:
        return None
    within = time[first:last]
    if np.diff(within, prepend=end - REST_TIME, append=end).max() > thresholds.largest_gap:
        return None
    return rest_of(within.tolist(), force[first:last].tolist())
