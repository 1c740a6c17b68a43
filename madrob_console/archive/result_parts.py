"""The measured parts of `result.json`, as they are published: see `result_document`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from madrob_console.archive.result_referee import Part, Ruling
from scoring.protocol import EventName, Signal, Step

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A digest as `sha256sum` prints it."""


class Indicator(Part, frozen=True):
    """One performance indicator: a value, or the reason why there is none (protocol section 6).

    Attributes:
        value: in the unit; null where it cannot be computed.
        unit: of the value.
        reason: why there is no value, in words; null where there is one.
    """

    value: int | float | None
    unit: str
    reason: str | None


class Indicators(Part, frozen=True):
    """The eight performance indicators (protocol section 6).

    Attributes:
        execution_time: from the start to the stop, the manual start included.
        time_to_handle: from the start to the touch of the handle, the manual start included.
        door_occupation_time: from the approach to the arrival on the destination side.
        passage_time: from the touch of the handle to the last closing of the door.
        unsafety_of_door_operation: largest low-passed acceleration of the panel.
        smoothness_of_door_actuation: ten divided by the mean jerk of the open panel.
        roughness_of_door_actuation: largest force on the handle.
        capability_level: how many of the six steps were done, 0 to 6.
    """

    execution_time: Indicator
    time_to_handle: Indicator
    door_occupation_time: Indicator
    passage_time: Indicator
    unsafety_of_door_operation: Indicator
    smoothness_of_door_actuation: Indicator
    roughness_of_door_actuation: Indicator
    capability_level: Indicator


class StepTimes(Part, frozen=True):
    """One of the six steps: what the sensors say, what the referee says, what counts.

    Attributes:
        step: its number, 1 to 6.
        name: in words.
        sensors: time of the automatic finding, s since the epoch; null = not done.
        referee: the referee's latest word on it; null = none.
        final: the time that counts, s since the epoch; null = not done.
        reason: why it is not done, in words; null where it is.
    """

    step: Step
    name: str
    sensors: float | None
    referee: Ruling | None
    final: float | None
    reason: str | None


class Event(Part, frozen=True):
    """Something that happened (protocol section 4).

    Attributes:
        time: s since the epoch.
        since_start: s since the start of the run.
        event: what, as EUROBENCH names it.
    """

    time: float
    since_start: float
    event: EventName


class SignalQuality(Part, frozen=True):
    """How good one signal was over the whole recording.

    Attributes:
        signal: which.
        samples: samples used.
        rate: their mean rate, gaps left out, Hz; null below two samples.
        largest_gap: the longest interval between samples, s; null below two samples.
        gaps: how many intervals were longer than allowed.
        jitter: standard deviation of the other intervals, s; null below two of them.
        dropped: samples with a duplicate, backward or missing stamp.
        shifted: samples whose stamp was shifted back after a step of the publisher's clock.
        no_reading: readings that were NaN, missing or out of range.
        skew: largest difference between stamp and log time, s; null without samples.
        clock_steps: how often the publisher's clock was stepped.
        begins_late, ends_early: how long nothing of it could be used at that end of the
            recording, s; 0 = no longer than an interval may be.
    """

    signal: Signal
    samples: int
    rate: float | None
    largest_gap: float | None
    gaps: int
    jitter: float | None
    dropped: int
    shifted: int
    no_reading: int
    skew: float | None
    clock_steps: int
    begins_late: float
    ends_early: float


class DataQuality(Part, frozen=True):
    """The quality of the data.

    Attributes:
        signals: in numbers.
        remarks: what to know of them, in words; waived checks and faults among them.
    """

    signals: tuple[SignalQuality, ...]
    remarks: tuple[str, ...]


class FileDigest(Part, frozen=True):
    """A file of the run as it was when the result was written.

    Attributes:
        sha256: its digest.
        bytes: its size.
    """

    sha256: Sha256
    bytes: int
