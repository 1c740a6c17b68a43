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
    from numpy.typing import ArrayLike, NDArray

REST_TIME = 0.5
"""How long the handle is looked at, before the start and at the end of the recording, s."""
FEWEST_SAMPLES = 10
"""Fewer samples tell no standard deviation."""
STEADY_FORCE = 0.1
"""A standard deviation up to this is steady on any testbed, N."""
STEADY_FACTOR = 3.0
"""A deviation up to this many times that of the quiet handle is steady, too."""
LOOK_BACK = 30.0
"""How long before the start a quiet stretch may begin, s."""
_STEP = 0.1
"""Distance between two stretches tried one after the other, s."""


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
        before: the last quiet half second before the start; null where there is none.
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

    def drifted(self, touch_force: float) -> bool:
        """Whether the drift exceeds half the touch threshold (N): the zero does not hold."""
        return self.drift is not None and moved(self.drift, touch_force)


def moved(difference: float, touch_force: float) -> bool:
    """Whether the rest force differs by more than half the touch threshold, N (section 4)."""
    return abs(difference) > touch_force / 2


def rest_of(times: Sequence[float], forces: Sequence[float]) -> HandleRest | None:
    """Statistics of a handle at rest; None if no handle bears such forces.

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
    time: ArrayLike,
    force: ArrayLike,
    start: float,
    *,
    zero: float = 0.0,
    end: float | None = None,
    thresholds: Thresholds | None = None,
) -> RestForce:
    """The rest force of a recording's handle before the run and after it.

    A half second counts if it has at least ten samples and no gap (an interval above `largest_gap`,
    also at its ends).

    - **before**: the last half second of the 30 s before the start that is *quiet*: its standard
      deviation is at most three times that of the quietest one there, or 0.1 N where that is
      larger, and at most half the touch threshold. Half seconds within the touch threshold of the
      zero come first: an even press on the handle in the countdown moves no rest force.
    - **after**: the last half second of the recording, after the start, if the handle is *free*:
      its standard deviation is at most three times that of `before`, or 0.1 N where that is larger
      or there is no `before`. A force without any change is no rest where there was noise before.

    A hand that presses as evenly as the load cell's noise is not detected.

    Times are in s since the epoch, forces in N without the zero subtracted, both of shape (n,).
    `end` is the newest stamp of any signal; None = the handle's last sample.
    """
    import numpy as np

    limits = thresholds or Thresholds()
    times, forces = np.asarray(time, np.float64), np.asarray(force, np.float64)
    before = _before(times, forces, start, zero, limits)
    no_before = None if before else "the handle was not quiet for half a second before the start"
    last = float(times[-1]) if times.size else start
    silent = end is not None and end - last > limits.largest_gap + limits.largest_skew
    last_rest = None if silent else _stretch(times, forces, last, limits)
    no_after = _not_free(last_rest, before, start)
    after = None if no_after else last_rest
    drift = None if after is None else after.mean - zero
    return RestForce(before, after, drift, no_before, no_after)


def _before(
    times: NDArray[np.float64],
    forces: NDArray[np.float64],
    start: float,
    zero: float,
    limits: Thresholds,
) -> HandleRest | None:
    tried = (start - _STEP * back for back in range(round((LOOK_BACK - REST_TIME) / _STEP) + 1))
    until = times.searchsorted(start)  # a sample at the start belongs to the run
    stretches = (_stretch(times[:until], forces[:until], end, limits) for end in tried)
    rests = [each for each in stretches if each is not None]
    if not rests:
        return None
    steady = _steady(min(each.deviation for each in rests))
    largest = min(steady, limits.touch_force / 2)
    quiet = [each for each in rests if each.deviation <= largest]
    near = [each for each in quiet if abs(each.mean - zero) <= limits.touch_force]
    return next(iter(near or quiet), None)


def _not_free(last_rest: HandleRest | None, before: HandleRest | None, start: float) -> str | None:
    if last_rest is None:
        return "too few samples, or a gap, in the last half second of the recording"
    if last_rest.begin < start:
        return "the recording ends within half a second of the start"
    if last_rest.deviation > _steady(0.0 if before is None else before.deviation):
        return "the handle was not free at the end of the recording"
    if last_rest.span == 0 and before is not None and before.span > 0:
        return "the force does not change any more at the end of the recording"
    return None


def _steady(deviation: float) -> float:
    """The largest steady standard deviation beside that of a quiet handle, N."""
    return max(STEADY_FACTOR * deviation, STEADY_FORCE)


def _stretch(
    times: NDArray[np.float64], forces: NDArray[np.float64], end: float, limits: Thresholds
) -> HandleRest | None:
    """The samples in (end - half a second, end]; None if they do not suffice."""
    import numpy as np

    first, last = times.searchsorted([end - REST_TIME, end], side="right")
    if last - first < FEWEST_SAMPLES:
        return None
    within = times[first:last]
    gaps = np.diff(within, prepend=end - REST_TIME, append=end)
    if gaps.max() > limits.largest_gap:
        return None
    return rest_of(within.tolist(), forces[first:last].tolist())
