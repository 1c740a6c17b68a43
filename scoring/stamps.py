"""Stamps that always increase (protocol section 8: duplicate or backward stamps, stepped clock)."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from scoring.samples import Sample

LARGEST_JUMP = 0.5
"""A jump of stamp minus log time above this is a step of the publisher's clock, s."""

KEPT_STEPS = 5
"""Steps that are kept by their times; of a clock that jumps all the time the others are counted."""


@dataclass(frozen=True, slots=True)
class ClockStep:
    """The publisher's clock was stepped by `jump` s at steady time `log_time`."""

    log_time: float
    jump: float


class StampGuard:
    """Admits the samples of one signal with increasing, step-free stamps.

    A stamp that is missing (zero), repeats or goes back is dropped and counted. Where stamp
    minus log time jumps by more than 0.5 s, later stamps are shifted back by the jump. Messages
    that are merely delivered late (a stalled link: log times jump, stamps go on) are not shifted,
    nor are those that follow a stamp that stood still.

    Attributes:
        dropped, shifted: so many samples.
        steps: the first steps of the publisher's clock.
        step_count: how many there were.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.shifted = 0
        self.steps: list[ClockStep] = []
        self.step_count = 0
        self._shift = 0.0
        self._newest: float | None = None
        self._previous: Sample | None = None
        self._reference = 0.0

    def admit(self, sample: Sample) -> Sample | None:
        """The sample with its stamp corrected; None when it has to be dropped."""
        if sample.time == 0:  # never set: it tells nothing of the publisher's clock
            self.dropped += 1
            return None
        self._follow_clock(sample)
        self._previous = sample
        time = sample.time - self._shift
        if self._newest is not None and time <= self._newest:
            self.dropped += 1
            return None
        self._newest = time
        if self._shift == 0.0:
            return sample
        self.shifted += 1
        return replace(sample, time=time)

    def _follow_clock(self, sample: Sample) -> None:
        offset = sample.time - sample.log_time
        previous = self._previous
        if previous is None:
            self._reference = offset
            return
        stamp_interval = sample.time - previous.time
        if abs(offset - self._reference) <= LARGEST_JUMP:
            if stamp_interval != 0:  # a stamp that stands still is no clock that goes slow
                self._reference = offset
            return
        log_interval = sample.log_time - previous.log_time
        jump = stamp_interval - log_interval
        delivered_late = log_interval > LARGEST_JUMP and 0 < stamp_interval < log_interval
        if abs(jump) > LARGEST_JUMP and not delivered_late:
            self._shift += jump
            self._reference = offset
            self.step_count += 1
            if self.step_count <= KEPT_STEPS:
                self.steps.append(ClockStep(sample.log_time, jump))
