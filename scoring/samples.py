"""Samples of the testbed's sensors (protocol section 3)."""

from __future__ import annotations

from typing import ClassVar

import msgspec

from scoring.protocol import Signal, Strip


class _Stamped(msgspec.Struct, frozen=True, gc=False, array_like=True):
    """What all samples have.

    `time` is the stamp, `log_time` the steady time of the reception (section 8), both in s since
    the epoch. Samples are no dataclasses: a frozen one takes four to five times as long to make,
    and there are millions. A `sequence` is the publisher's count of its messages, by which losses
    are counted; 0 = unknown.
    """

    time: float
    log_time: float


class DoorSample(_Stamped, frozen=True, gc=False, tag=True, array_like=True):
    """Panel angle in rad, 0 = closed, positive = CCW. NaN = no reading."""

    signal: ClassVar = Signal.DOOR

    angle: float
    sequence: int = 0


class HandleSample(_Stamped, frozen=True, gc=False, tag=True, array_like=True):
    """Force on the handle in N, positive = pushes the panel towards CCW. NaN = no reading."""

    signal: ClassVar = Signal.HANDLE

    force: float
    sequence: int = 0


class PassageSample(_Stamped, frozen=True, gc=False, tag=True, array_like=True):
    """Four distances down from the lintel, m, of one strip, by REP-117.

    +inf = nothing there, -inf = something too close; NaN, outside [range_min, range_max] or
    missing = no reading.
    """

    strip: Strip
    ranges: tuple[float, ...]
    range_min: float
    range_max: float
    sequence: int = 0

    @property
    def signal(self) -> Signal:
        return Signal.of_strip(self.strip)


class LatchSample(_Stamped, frozen=True, gc=False, tag=True, array_like=True):
    """State of the optional latch sensor: True = latch engaged."""

    signal: ClassVar = Signal.LATCH

    engaged: bool
    sequence: int = 0


Sample = DoorSample | HandleSample | PassageSample | LatchSample
