"""Joins passage samples with the door angle at their stamps, whichever comes first (section 4)."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable
from operator import attrgetter

from scoring.samples import DoorSample, PassageSample

LONGEST_WAIT = 0.25
"""A passage sample waits so long for the door sample after it, s of arrival."""

_KEPT = 4096
"""Door samples that are kept at least: over a minute at 50 Hz."""

_stamp = attrgetter("time")


class PanelAngles:
    """Hands on each passage sample with the door angle at its stamp.

    The angle is linear between the two door samples around the stamp. A sample that has waited
    `LONGEST_WAIT` for the later one gets the last angle before it: a guess. Before any door sample
    the door counts as closed.

    Args:
        join: takes a passage sample and the door angle at its stamp, rad.

    Attributes:
        guesses: stamp, s since the epoch, and angle, rad, of each sample that got a guess.
    """

    def __init__(self, join: Callable[[PassageSample, float], None]) -> None:
        self.guesses = array("d")
        self._join = join
        self._waiting: list[PassageSample] = []
        self._times: list[float] = []
        self._angles: list[float] = []

    def add_door(self, sample: DoorSample) -> None:
        """Take the next door angle that is a reading, and hand on what waited for it."""
        if len(self._times) >= 2 * _KEPT:
            del self._times[:_KEPT], self._angles[:_KEPT]
        self._times.append(sample.time)
        self._angles.append(sample.angle)
        if self._waiting:
            known = [each for each in self._waiting if each.time <= sample.time]
            self._waiting = [each for each in self._waiting if each.time > sample.time]
            self._hand_on(known)

    def add_passage(self, sample: PassageSample) -> None:
        """Take the next passage sample; it waits where the door angle at its stamp is not known."""
        if self._times and sample.time <= self._times[-1]:
            self._join(sample, self._at(sample.time))
        else:
            self._waiting.append(sample)

    def end_waits(self, now: float) -> None:
        """Hand on what has waited too long at a log time, s since the epoch; inf = all of it."""
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
