"""What a screen may ask of the engine: each request is one class, and nothing else tells of it.

It says what it carries, the type of its answer, how long it may take and whether it needs the right
to act. Socket and thread pass it on unread; it is carried out in `engine/process/local.py`. What
moves a replay stands in `playback.py`.
"""

from __future__ import annotations

import os
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, Self, TypeVar

import msgspec

from madrob_console.engine.shown.curves import Curves
from madrob_console.referee.acts import act_details, is_urgent
from madrob_console.referee.competition_plan import PlanProgress

if TYPE_CHECKING:
    from madrob_console.referee.acts import Act

T = TypeVar("T")
"""Of an answer."""

NO_ANSWER = "the engine does not answer: nothing was done; look at the disk"
"""Of a request that was given up before it began: it never takes effect."""

UNSURE = "the engine does not answer: what is shown when it is back tells whether it was done"
"""Of one that may have begun."""


class Role(StrEnum):
    """What a screen is there for."""

    REFEREE = "referee"
    WATCH = "watch"


class Request(msgspec.Struct, Generic[T], frozen=True, tag=True):
    """Something that a screen asks; `T` is the type of the answer.

    Attributes:
        timeout: a screen waits this long for the answer, s.
        effect_time: of the timeout, what there must still be when it begins, s; what begins
            later is not carried out any more.
    """

    timeout: ClassVar[float] = 5.0
    effect_time: ClassVar[float] = 0.0

    @property
    def latest_begin(self) -> float:
        """After so long it is not begun any more, s."""
        return self.timeout - self.effect_time

    @property
    def urgent(self) -> bool:
        """Whether it goes past all requests that are not."""
        return False


class Command(Request[str | None], frozen=True):
    """Something is to be done; for that a screen needs the right to act.

    The answer says in words why it is refused; None: it is done, or on its way.
    """

    effect_time: ClassVar[float] = 2.5


class Perform(Command, frozen=True):
    """Do an act of the referee.

    Attributes:
        name: of the act.
        details: its fields, as a journal line has them.
        id: made by the screen; what is asked again under the same one is done only once.
    """

    name: str
    details: dict[str, object]
    id: Annotated[str, msgspec.Meta(max_length=64)] = ""

    @classmethod
    def of(cls, act: Act) -> Self:
        """The request for an act, under an id of its own."""
        return cls(act.name, act_details(act), os.urandom(16).hex())

    @property
    def urgent(self) -> bool:
        """What ends a run is."""
        return is_urgent(self.name)


class NextRunNumber(Request[int], frozen=True):
    """Which run number was never used for this subject and condition, official or practice?"""

    subject: int
    condition: int
    practice: bool = False


class OpenRun(Command, frozen=True):
    """Show an earlier run; takes as long as reading its bag.

    Attributes:
        folder: as seen from the results folder.
        invalid: a run that was cut off does not count; else it is interrupted.
    """

    name: ClassVar[str] = "open the run"
    timeout: ClassVar[float] = 120.0
    folder: str
    invalid: bool = False


class ExportTeam(Command, frozen=True):
    """Pack the official, or the practice runs of a team into a zip, in the background.

    A team is competition and subject; without one it is of the only competition that there is.
    `Snapshot.export` tells the rest.
    """

    name: ClassVar[str] = "export the team's runs"
    subject: int
    practice: bool = False
    competition: str | None = None


class ExportDossier(Command, frozen=True):
    """Pack all about one run into a zip, in the background.

    `Snapshot.export` tells the rest.

    Attributes:
        folder: of the run, as seen from the results folder.
    """

    name: ClassVar[str] = "export the dossier of the run"
    folder: str


class GiveCurves(Request[Curves | None], frozen=True):
    """What do the figures show of the run with a result? None without one."""


class GiveFrames(Request[str], frozen=True):
    """What did the cameras see at the instant that a replay shows? The folder of the files."""

    name: ClassVar[str] = "the cameras' frames"
    timeout: ClassVar[float] = 60.0


class GivePlan(Request[PlanProgress], frozen=True):
    """How much of the competition's plan is done? As the results folder says now."""

    timeout: ClassVar[float] = 30.0


class TakeOver(Command, frozen=True):
    """Give this screen the right to act."""

    name: ClassVar[str] = "take over"

    @property
    def urgent(self) -> bool:
        """Who takes over may want to abort."""
        return True
