"""What the testbed's sensors say, one sample at a time (protocol section 3).

`time` is the sample's stamp and `log_time` the steady time at which it was received
(section 8); both in s since the epoch. They are no dataclasses because there are so many: a
frozen one takes four to five times as long to make.
"""

from __future__ import annotations

import msgspec

from scoring.protocol import Signal, Strip


class DoorSample(msgspec.Struct, frozen=True, gc=False, tag=True, array_like=True):
    """Panel angle in rad, 0 = closed, positive = CCW. NaN = no reading."""

    time: float
    log_time: float
    angle: float

    @property
    def signal(self) -> Signal:
        """The signal to which the sample belongs."""
        return Signal.DOOR


class HandleSample(msgspec.Struct, frozen=True, gc=False, tag=True, array_like=True):
    """Force on the handle in N, positive = pushes the panel towards CCW. NaN = no reading."""

    time: float
    log_time: float
    force: float

    @property
    def signal(self) -> Signal:
        """The signal to which the sample belongs."""
        return Signal.HANDLE


class PassageSample(msgspec.Struct, frozen=True, gc=False, tag=True, array_like=True):
    """Four distances down from the lintel, m, of one strip.

    Ranges follow REP-117: +inf = nothing there, -inf = something too close, NaN or outside
    [range_min, range_max] = no reading. `ranges` may be shorter than four: what is missing
    is no reading.
    """

    time: float
    log_time: float
    strip: Strip
    ranges: tuple[float, ...]
    range_min: float
    range_max: float

    @property
    def signal(self) -> Signal:
        """The signal to which the sample belongs."""
        return Signal.of_strip(self.strip)


class LatchSample(msgspec.Struct, frozen=True, gc=False, tag=True, array_like=True):
    """State of the optional latch sensor: True = latch engaged."""

    time: float
    log_time: float
    engaged: bool

    @property
    def signal(self) -> Signal:
        """The signal to which the sample belongs."""
        return Signal.LATCH


Sample = DoorSample | HandleSample | PassageSample | LatchSample
