"""What a screen may ask of the engine: each request is one class, and nothing else tells of it.

It says what it carries, the type of its answer, how long it may take and whether it needs the right
to act. Socket and thread pass it on unread; it is carried out in `engine/process/local.py`. What
moves a replay stands in `playback.py`.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, Generic, Self, TypeVar

import msgspec

from madrob_console.engine.shown.curves import Curves
from madrob_console.referee.acts import act_details

if TYPE_CHECKING:
    from madrob_console.referee.acts import Act

T = TypeVar("T")
"""Of an answer."""

NO_ANSWER = "the engine does not answer: look at the disk"


class Role(StrEnum):
    """What a screen is there for."""

    REFEREE = "referee"
    WATCH = "watch"


class Request(msgspec.Struct, Generic[T], frozen=True, tag=True):
    """Something that a screen asks; `T` is the type of the answer.

    Attributes:
        timeout: a screen waits this long for the answer, s; what has not begun by then is not
            carried out any more.
    """

    timeout: ClassVar[float] = 5.0


class Command(Request[str | None], frozen=True):
    """Something is to be done; for that a screen needs the right to act.

    The answer says in words why it is refused; None: it is done, or on its way.
    """


class Perform(Command, frozen=True):
    """Do an act of the referee: its name, and its fields as a journal line has them."""

    name: str
    details: dict[str, object]

    @classmethod
    def of(cls, act: Act) -> Self:
        """The request for an act."""
        return cls(act.name, act_details(act))


class NextRunNumber(Request[int], frozen=True):
    """Which run number was never used for this subject and condition?"""

    subject: int
    condition: int


class OpenRun(Command, frozen=True):
    """Show an earlier run; takes as long as reading its bag.

    Attributes:
        folder: its name in the results folder.
        invalid: a run that was cut off does not count; else it is interrupted.
    """

    name: ClassVar[str] = "open the run"
    timeout: ClassVar[float] = 120.0
    folder: str
    invalid: bool = False


class ExportTeam(Command, frozen=True):
    """Pack the runs of a team into a zip, in the background; `Snapshot.export` tells the rest."""

    name: ClassVar[str] = "export the team's runs"
    subject: int


class GiveCurves(Request[Curves | None], frozen=True):
    """What do the figures show of the run with a result? None without one."""


class TakeOver(Command, frozen=True):
    """Give this screen the right to act."""

    name: ClassVar[str] = "take over"


class StopEngine(Command, frozen=True):
    """End the engine; `force` also while a run goes on, which is cut off and kept."""

    force: bool = False
