"""How a replay is controlled and what it says of itself: plain data that crosses the socket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from madrob_console.engine.shown.requests import Command
from madrob_console.testbeds.recorded_clock import TICK

NO_REPLAY = "this is no replay"

SPEEDS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""The speeds that the keys choose from; any other can be given at the start."""

SAMPLE_STEP = TICK
"""The short step: one door sample at 50 Hz, s."""

LONG_STEP = 1.0
"""The long step, s."""


class PlaybackCommand(Command, frozen=True):
    """Pause, step or move a replay."""

    name: ClassVar[str] = "control the replay"


class PlayOrPause(PlaybackCommand, frozen=True):
    """Pause, or go on."""


class Faster(PlaybackCommand, frozen=True):
    """The next higher speed."""


class Slower(PlaybackCommand, frozen=True):
    """The next lower speed."""


class SetSpeed(PlaybackCommand, frozen=True):
    """So many times as fast as it was; 0 = as fast as possible."""

    speed: float


class Skip(PlaybackCommand, frozen=True):
    """Pause so many seconds later; earlier if negative."""

    duration: float


class JumpTo(PlaybackCommand, frozen=True):
    """Go on at this time, s from the start of the run; negative in the countdown."""

    time: float


@dataclass(frozen=True, slots=True)
class PlaybackView:
    """Where a replay stands. Times are s from the start of the run, negative before it.

    Attributes:
        position: now.
        begin, end: of the recording.
        speed: times as fast as it was; 0 = as fast as possible.
        paused: whether it stands still.
        ended: whether it has come to the end of the recording.
        jumping_to: where a jump goes to; None when none goes on.
        comparison: what the result is beside the stored one, in words; empty before the end.
        agrees: whether it equals the stored one, but for the last digits.
    """

    position: float
    begin: float
    end: float
    speed: float
    paused: bool
    ended: bool
    jumping_to: float | None = None
    comparison: str = ""
    agrees: bool = False


def faster(speed: float) -> float:
    """The next higher of the speeds; the highest stays, and as fast as possible too."""
    if speed == 0:
        return speed
    return next((one for one in SPEEDS if one > speed), speed)


def slower(speed: float) -> float:
    """The next lower of the speeds; the lowest stays."""
    if speed == 0:
        return SPEEDS[-1]
    return next((one for one in reversed(SPEEDS) if one < speed), speed)
