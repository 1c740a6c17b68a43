"""The door angle at the stamp of each passage sample, whichever arrives first (section 4)."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable
from operator import attrgetter

from scoring.samples import DoorSample, PassageSample

LONGEST_WAIT = 0.25
"""How long a passage sample waits for the door sample after it, s of arrival."""

_KEPT = 4096
"""Door samples that are kept at least: over a minute at 50 Hz."""

_stamp = attrgetter("time")


class PanelAngles:
    """Passes each passage sample to `join` with the door angle at its stamp, rad.

    The angle is linear between the door samples around the stamp. After `LONGEST_WAIT` without a
    later one it is a guess, the last before it; before any door sample the door is closed.
    `guesses` holds stamp (s since the epoch) and angle of each guess.
    """

    def __init__(self, join: Callable[[PassageSample, float], None]) -> None:
        self.guesses = array("d")
        self._join = join
        self._waiting: list[PassageSample] = []
        self._times: list[float] = []
        self._angles: list[float] = []

    def add_door(self, sample: DoorSample) -> None:
        """Take the next door angle that is a reading; pass on what waited for it."""
        if len(self._times) >= 2 * _KEPT:
            del self._times[:_KEPT], self._angles[:_KEPT]
        self._times.append(sample.time)
        self._angles.append(sample.angle)
        if self._waiting:
            ready = [each for each in self._waiting if each.time <= sample.time]
            self._waiting = [each for each in self._waiting if each.time > sample.time]
            self._hand_on(ready)

    def add_passage(self, sample: PassageSample) -> None:
        if self._times and sample.time <= self._times[-1]:
            self._join(sample, self._at(sample.time))
        else:
            self._waiting.append(sample)

    def end_waits(self, now: float) -> None:
        """Pass on samples that waited too long at log time `now`, s since the epoch; inf = all."""
        if self._waiting and self._waiting[0].log_time + LONGEST_WAIT < now:
            late = [each for each in self._waiting if each.log_time + LONGEST_WAIT < now]
            self._waiting = self._waiting[len(late) :]
            for sample in late:
                self.guesses.extend((sample.time, self._at(sample.time)))
            self._hand_on(late)

    def _hand_on(self, samples: list[PassageSample]) -> None:
        for sample in sorted(samples, key=_stamp):
            self._join(sample, self._at(sample.time))

    def _at(self, time: float) -> float:
        times, angles = self._times, self._angles
        after = bisect_left(times, time)
        if after == len(times):
            return angles[-1] if angles else 0.0
        if after == 0:
            return angles[0]
        since, until = times[after - 1], times[after]
        before = angles[after - 1]
        return before + (angles[after] - before) * (time - since) / (until - since)
