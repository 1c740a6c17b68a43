"""What a screen may ask of the engine: one class a request; playback and curves in it.

It says what it carries, the type of its answer, how long it may take and whether it needs the
right to act. Socket and thread pass it on unread; `engine/runtime/engine_thread.py` carries it out.
What moves a replay stands below.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, Self, TypeVar

import msgspec

from madrob_console.common.recorded_clock import TICK
from madrob_console.referee.acts import act_details, is_urgent
from madrob_console.referee.competition_plan import PlanProgress
from scoring.figure_table import Quantity
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.referee.acts import Act

# The curves behind a result, as plain data that can cross a socket.
#
# NumPy is not imported here: screens import these types, and only `curves_of` works on arrays.


if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scoring.result import Result
    from scoring.rows import Rows

    Array = NDArray[np.float64]

MOST_CURVE_POINTS = 20_000
"""Most points of one quantity, over all its stretches."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One stretch of a quantity without gaps; as many times as values, all finite.

    Times are s since the run's start, increasing; values have the quantity's unit.
    """

    time: tuple[float, ...]
    value: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Curves:
    """Data for the figures of a run (protocol section 6).

    A quantity is a series of stretches with data gaps between them. Times may reach beyond the
    run: the settle time, or the whole recording, as the ruleset has it. All quantities are empty
    for an aborted run and for one without data.

    Attributes:
        duration: from the start to the stop, or to the last datum of a run without a stop, s.
        events: s since the start, and the event's name as in the event file.
    """

    duration: float
    stretches: Mapping[Quantity, tuple[Curve, ...]] = field(default_factory=dict)
    events: tuple[tuple[float, str], ...] = ()

    def curves_of(self, quantity: Quantity) -> tuple[Curve, ...]:
        return self.stretches.get(quantity, ())

    @property
    def empty(self) -> bool:
        return not any(self.stretches.values())

    @property
    def extent(self) -> tuple[float, float]:
        """First and last time that a figure must show, s since the start."""
        drawn = [stretch for stretches in self.stretches.values() for stretch in stretches]
        first = min((stretch.time[0] for stretch in drawn), default=0.0)
        last = max((stretch.time[-1] for stretch in drawn), default=0.0)
        return min(0.0, first), max(self.duration, last)


def curves_of(result: Result, rows: Rows) -> Curves:
    """The curves of a scored run, thinned to `MOST_CURVE_POINTS` each without losing extremes."""
    start, stop = result.start, result.stop
    events = tuple((event.since_start, str(event.event)) for event in result.events)
    ran = 0.0 if stop is None else max(0.0, stop - start)
    if result.outcome is Outcome.ABORTED:
        return Curves(ran, events=events)
    by_quantity = {quantity: _curve(*rows.series(quantity), start, rows) for quantity in Quantity}
    curves = Curves(
        ran, {quantity: curve for quantity, curve in by_quantity.items() if curve}, events
    )
    return curves if stop is not None else replace(curves, duration=curves.extent[1])


def _curve(time: Array, value: Array, start: float, rows: Rows) -> tuple[Curve, ...]:
    from scoring.figures.run_drawings import stretches

    parts = stretches(time - start, value, rows.thresholds.largest_gap, MOST_CURVE_POINTS)
    return tuple(Curve(tuple(t.tolist()), tuple(v.tolist())) for t, v in parts)


T = TypeVar("T")

NO_ANSWER = "the engine did not answer: the disk or the processor is too busy. Nothing was done"

UNSURE = "the engine does not answer: what is shown when it is back tells whether it was done"


class Role(StrEnum):
    """What a screen is for."""

    REFEREE = "referee"
    WATCH = "watch"


class Request(msgspec.Struct, Generic[T], frozen=True, tag=True):
    """A request of a screen; `T` is the type of the answer.

    Attributes:
        timeout: the screen waits this long for the answer, s.
        effect_time: part of the timeout that must be left when the request begins, s; what
            would begin later is not carried out.
    """

    timeout: ClassVar[float] = 5.0
    effect_time: ClassVar[float] = 0.0

    @property
    def latest_begin(self) -> float:
        """It is not begun later than this after it was asked, s."""
        return self.timeout - self.effect_time

    @property
    def urgent(self) -> bool:
        return False


class Command(Request[str | None], frozen=True):
    """Something to be done; for that a screen needs the right to act.

    The answer says in words why it is refused; None: it is done, or on its way.
    """

    effect_time: ClassVar[float] = 2.5


class Perform(Command, frozen=True):
    """Do an act of the referee, with the fields of its journal line.

    The screen makes the `id`; a retry under the same id is done only once.
    """

    name: str
    details: dict[str, object]
    id: Annotated[str, msgspec.Meta(max_length=64)] = ""

    @classmethod
    def of(cls, act: Act) -> Self:
        return cls(act.name, act_details(act), os.urandom(16).hex())

    @property
    def urgent(self) -> bool:
        return is_urgent(self.name)


class NextRunNumber(Request[int], frozen=True):
    """Next run number never used for this subject and condition, official or practice."""

    subject: int
    condition: int
    practice: bool = False


class OpenRun(Command, frozen=True):
    """Show an earlier run; takes as long as reading its bag.

    With `invalid` a run that was cut off does not count; else it is interrupted.
    """

    name: ClassVar[str] = "open the run"
    timeout: ClassVar[float] = 120.0
    folder: str
    invalid: bool = False


class ExportTeam(Command, frozen=True):
    """Pack the runs of a team into a zip, in the background; see `Snapshot.export`.

    A team is competition and subject; without a competition, that of the only one there is.
    """

    name: ClassVar[str] = "export the team's runs"
    subject: int
    practice: bool = False
    competition: str | None = None


class ExportDossier(Command, frozen=True):
    """Pack everything about one run into a zip, in the background; see `Snapshot.export`."""

    name: ClassVar[str] = "export the dossier of the run"
    folder: str


class GiveCurves(Request[Curves | None], frozen=True):
    """Curves of the run with a result; None without one."""


class GiveFrames(Request[str], frozen=True):
    """What the cameras saw at the replayed instant; the folder of the files."""

    name: ClassVar[str] = "the cameras' frames"
    timeout: ClassVar[float] = 60.0


class GivePlan(Request[PlanProgress], frozen=True):
    """How much of the competition's plan is done."""

    timeout: ClassVar[float] = 30.0


class TakeOver(Command, frozen=True):
    """Give this screen the right to act."""

    name: ClassVar[str] = "take over"

    @property
    def urgent(self) -> bool:
        """A referee who takes over may want to abort."""
        return True


# How a replay is controlled, and its state: plain data that crosses the socket.


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
