"""What a screen may ask of the engine: one class a request.

It says what it carries, the type of its answer, how long it may take and whether it needs the
right to act. Socket and thread pass it on unread; `engine/runtime/engine_thread.py` carries it out.
"""

from __future__ import annotations

import os
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, Self, TypeVar

import msgspec

from madrob_console.engine.curves import Curves
from madrob_console.referee.acts import act_details, is_urgent
from madrob_console.referee.competition_plan import PlanProgress

if TYPE_CHECKING:
    from madrob_console.referee.acts import Act


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
