"""Makes the stamps of a topic increase (protocol section 8).

Duplicate and backward stamps are dropped; a step of the publisher's clock is undone.
"""

from __future__ import annotations

from msgspec.structs import replace

from scoring.samples import Sample

LARGEST_JUMP = 0.5
"""A larger jump of stamp minus log time is a step of the publisher's clock, s."""

_AHEAD = 0.1
"""One stamp that jumps further ahead of its reception is wrong, if the next one does not, s."""

_UNSTEADY = 2.0
"""Lost messages explain a jump of stamps of up to so many intervals each."""

KEPT_STEPS = 5
"""Clock steps that are told; the others are counted."""


class StampGuard:
    """Admits the samples of one signal with increasing, step-free stamps.

    A stamp that is missing (zero), repeats or goes back is dropped and counted. Where stamp
    minus log time jumps by more than 0.5 s, later stamps are shifted back by the jump. One stamp
    that is ahead of its neighbours on both sides, by over 0.1 s, is dropped. Messages
    delivered late (log times jump, stamps go on) are not shifted, nor are those after a stamp that
    stood still, or after lost messages that explain the jump. `steps` holds the first clock steps,
    s, `step_count` counts all.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.shifted = 0
        self.steps: list[float] = []
        self.step_count = 0
        self._shift = 0.0
        self._newest: float | None = None
        self._previous: Sample | None = None
        self._newest_sample: Sample | None = None
        self._reference = 0.0
        self._interval = 0.0
        self._ahead = False

    def admit(self, sample: Sample) -> Sample | None:
        """The sample with its stamp corrected; None when it is to be dropped."""
        # one that was never set tells nothing of the publisher's clock
        if sample.time == 0 or self._is_ahead(sample):
            self.dropped += 1
            return None
        self._follow_clock(sample)
        self._previous = sample
        time = sample.time - self._shift
        if self._newest is not None and time <= self._newest:
            self.dropped += 1
            return None
        self._newest, self._newest_sample = time, sample
        if self._shift == 0.0:
            return sample
        self.shifted += 1
        return replace(sample, time=time)

    def _is_ahead(self, sample: Sample) -> bool:
        newest_sample = self._newest_sample
        if newest_sample is None:
            return False
        jump = sample.time - newest_sample.time - (sample.log_time - newest_sample.log_time)
        lost = 0 < newest_sample.sequence < sample.sequence - 1
        self._ahead = _AHEAD < jump <= LARGEST_JUMP and not (lost or self._ahead)
        return self._ahead

    def _follow_clock(self, sample: Sample) -> None:
        offset = sample.time - sample.log_time
        previous = self._previous
        if previous is None:
            self._reference = offset
            return
        stamp_interval = sample.time - previous.time
        lost = max(0, sample.sequence - previous.sequence - 1) if previous.sequence else 0
        if abs(offset - self._reference) <= LARGEST_JUMP:
            if stamp_interval != 0:  # a stamp that stands still is no clock that goes slow
                self._reference = offset
                self._interval = stamp_interval / (lost + 1)
            return
        log_interval = sample.log_time - previous.log_time
        jump = stamp_interval - log_interval
        delivered_late = log_interval > LARGEST_JUMP and 0 < stamp_interval < log_interval
        if 0 < jump <= _UNSTEADY * lost * self._interval:
            self._reference = offset
        elif abs(jump) > LARGEST_JUMP and not delivered_late:
            self._shift += jump
            self._reference = offset
            self.step_count += 1
            if self.step_count <= KEPT_STEPS:
                self.steps.append(jump)
