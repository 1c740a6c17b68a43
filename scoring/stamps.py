"""Makes the stamps of a topic increase, and the samples of all topics come by stamp (section 8)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from heapq import heappop, heappush

from msgspec.structs import replace

from scoring.samples import DoorSample, Sample

LARGEST_JUMP = 0.5
"""A larger jump of stamp minus log time is a step of the publisher's clock, s."""

REORDERED = 0.25
"""How long a sample waits for others with an earlier stamp, s of reception."""


class StampGuard:
    """Admits the samples of one signal with increasing, step-free stamps.

    A stamp that is missing (zero), repeats or goes back is dropped and counted. Where stamp minus
    log time jumps by more than 0.5 s, later stamps are shifted back by the jump. Messages that are
    delivered late (log times jump, stamps go on) are not shifted.

    Attributes:
        dropped, shifted: how many samples.
        steps: of the publisher's clock, s.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.shifted = 0
        self.steps: list[float] = []
        self._shift = 0.0
        self._newest = -math.inf
        self._usual = math.nan  # stamp minus log time
        self._previous: Sample | None = None

    def admit(self, sample: Sample) -> Sample | None:
        """The sample with its stamp corrected.

        None when it is to be dropped.
        """
        if sample.time == 0 != sample.log_time:  # it was never set, and tells of no clock
            self.dropped += 1
            return None
        self._follow_clock(sample)
        self._previous = sample
        time = sample.time - self._shift
        if time <= self._newest:
            self.dropped += 1
            return None
        self._newest = time
        if not self._shift:
            return sample
        self.shifted += 1
        return replace(sample, time=time)

    def _follow_clock(self, sample: Sample) -> None:
        offset, previous = sample.time - sample.log_time, self._previous
        if previous is None or abs(offset - self._usual) <= LARGEST_JUMP:
            if (
                previous is None or sample.time != previous.time
            ):  # one that stands still is no clock
                self._usual = offset
            return
        stamps, received = sample.time - previous.time, sample.log_time - previous.log_time
        delivered_late = received > LARGEST_JUMP and 0 < stamps < received
        if abs(stamps - received) > LARGEST_JUMP and not delivered_late:
            self._shift += stamps - received
            self._usual = offset
            self.steps.append(stamps - received)


class ReorderBuffer:
    """Gives samples back by stamp, 0.25 s after their reception; of equal stamps the door first.

    Attributes:
        is_in_order: whether no sample came so late that one with a later stamp was given back.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[float, bool, int, Sample]] = []
        self._count = 0
        self._newest = (-math.inf, False)
        self.is_in_order = True

    def add(self, sample: Sample) -> None:
        self._count += 1
        key = (sample.time, not isinstance(sample, DoorSample), self._count)
        heappush(self._waiting, (*key, sample))

    def release(self, now: float) -> Iterator[Sample]:
        """Samples that have waited long enough at log time `now`, s.

        inf = all.
        """
        waiting = self._waiting
        while waiting and waiting[0][3].log_time + REORDERED <= now:
            time, follows_door, _, sample = heappop(waiting)
            if (time, follows_door) < self._newest:
                self.is_in_order = False
            self._newest = (time, follows_door)
            yield sample
