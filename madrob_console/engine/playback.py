"""How a replay is controlled, and its state: plain data that crosses the socket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from madrob_console.common.recorded_clock import TICK
from madrob_console.engine.requests import Command

NO_REPLAY = "this is no replay"

SPEEDS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""The speeds that the keys choose from; any other can be given at the start."""

SAMPLE_STEP = TICK
"""The short step: one door sample at 50 Hz, s."""

LONG_STEP = 1.0
"""In s."""


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
    """Set the speed, times real time; 0 = as fast as possible."""

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
        speed: times real time; 0 = as fast as possible.
        comparison: how the result compares with the stored one, in words; empty before the end.
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
    if speed == 0:
        return speed
    return next((each for each in SPEEDS if each > speed), speed)


def slower(speed: float) -> float:
    if speed == 0:
        return SPEEDS[-1]
    return next((each for each in reversed(SPEEDS) if each < speed), speed)
