"""What an act is, and the situation that it is checked against."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Flag as FlagEnum
from enum import auto
from functools import cached_property
from typing import ClassVar

import msgspec

from madrob_console.common.names import is_rehearsal
from madrob_console.referee.checks import Check
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.run import Phase, Run, reissued
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.rest import HandleRest
from scoring.result import Indicator


@dataclass(frozen=True)
class Situation:
    """What an act is checked against; sensor values are computed once, and only where needed.

    A run is `scored` when it has its result, on disk or refused by it. It is `hopeless` when the
    computation of the result has failed several times. `rest_force` (N) is the most by which a
    force at rest differs from its zero. `simulated` says what a simulated testbed plays. `refused`
    says why the disk refuses the run's files.
    """

    run: Run
    scored: bool = False
    look: Callable[[], tuple[Check, ...]] = tuple
    measure: Callable[[], HandleRest | None] = lambda: None
    rest_force: float = math.inf
    hopeless: bool = False
    teams: TeamList = NO_TEAMS
    steps: tuple[StepRecord, ...] = ()
    simulated: str | None = None
    indicators: Mapping[IndicatorName, Indicator] = field(default_factory=dict)
    testbed: str = ""
    competition: str = ""
    new_id: Callable[[], str] = str
    refused: str = ""

    @property
    def only_practice(self) -> bool:
        """Whether every run is practice: on a simulated testbed, but in a rehearsal."""
        return self.simulated is not None and not is_rehearsal(self.competition)

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        return self.look()

    @property
    def flags(self) -> tuple[Flag, ...]:
        return flags(self.run, self.steps, indicators=self.indicators)

    @cached_property
    def handle_rest(self) -> HandleRest | None:
        """The handle force in the last second; None = no data."""
        return self.measure()


class Consequence(FlagEnum):
    """Side effects of an act beside the new state of the run; the engine carries them out."""

    NONE = 0
    NEW_RUN = auto()
    """The run before is put away; testbed and robot hear of the set-up."""
    RECORDING = auto()
    """The recording opens; where it cannot, the act is refused."""
    COUNTDOWN = auto()
    """The countdown begins when the act's line is on disk; a line of its own says when."""
    HANDLE_ZERO = auto()
    """The handle zero is kept for the runs to come."""


LONGEST_TEXT = 2000
"""Characters of a text in an act: names, reasons, notes, the words of a team."""

RESULT_IS_WRITTEN = "the result is being written"


class Act(ABC):
    """One act of the referee: plain data that can cross a socket.

    Attributes:
        name: in the journal and on the screens.
        elsewhere: refuses it outside its `phases`; empty = the phase says why.
        missing: refuses it without its reason or text; empty = none is needed.
        done, log: its effect, for the referee and the event log, as formats of the `act`; empty =
            its name.
        urgent: it ends a danger: no other request and no disk delays it.
        at_once: it takes effect before its line is on disk; others need the journal first.
        stands_out: whether its line of the event log is highlighted.
        undoable: whether `TakeBack` takes it back.
    """

    __slots__ = ()
    name: ClassVar[str]
    phases: ClassVar[tuple[Phase, ...]]
    elsewhere: ClassVar[str] = ""
    missing: ClassVar[str] = ""
    done: ClassVar[str] = ""
    log: ClassVar[str] = ""
    urgent: ClassVar[bool] = False
    at_once: ClassVar[bool] = True
    consequences: ClassVar[Consequence] = Consequence.NONE
    stands_out: ClassVar[bool] = False
    undoable: ClassVar[bool] = False

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """Why no such act is possible now, whatever its fields; None when it is."""
        phase = situation.run.phase
        if phase in cls.phases:
            return cls.hindrance(situation)
        return cls.elsewhere or _WHY_NOT[phase]

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """What prevents it in a phase that allows it; None = nothing."""
        return None

    def problem(self, situation: Situation) -> str | None:
        """What is wrong with its fields; None = nothing."""
        return None

    def refusal(self, situation: Situation) -> str | None:
        """Why the act is not possible now; None when it is."""
        refused = self.impossible(situation) or self._too_long or self.problem(situation)
        if not refused and not self.reason_given.strip():
            refused = self.missing
        return refused or self._too_early(situation)

    def _too_early(self, situation: Situation) -> str | None:
        """Only a final result that is on disk is opened again: it is kept beside the next issue."""
        final = situation.run.phase is Phase.FINAL and not self.at_once
        return RESULT_IS_WRITTEN if final and not situation.scored else None

    @property
    def _too_long(self) -> str | None:
        if _longest(msgspec.to_builtins(self)) <= LONGEST_TEXT:
            return None
        return f"a text has at most {LONGEST_TEXT} characters: write the rest beside it"

    def settled(self, situation: Situation) -> Act:
        """The act as it is carried out and journalled, with the fields that the engine sets."""
        return self

    @abstractmethod
    def apply(self, situation: Situation, at: float) -> Run:
        """The state after the act, done at time `at` (s since the epoch)."""

    def opened_again(self, run: Run, at: float) -> Run:
        """Opens a final result again, for a re-issue by this act; `at` in s since the epoch."""
        if run.phase is not Phase.FINAL:
            return run
        return reissued(run, at, self.name, self.reason_given, self.signature or run.referee)

    @property
    def reason_given(self) -> str:
        return str(getattr(self, "reason", getattr(self, "note", "")))

    @property
    def signature(self) -> str:
        """The name that the referee signed with; empty where nothing is signed."""
        return str(getattr(self, "referee", ""))

    @property
    def done_text(self) -> str:
        """Its effect, for the referee; the reason is appended."""
        return (self.done or self.name).format(act=self)

    @property
    def logged(self) -> str:
        """Its effect, for the event log; the reason is appended."""
        return (self.log or self.name).format(act=self)


_WHY_NOT = {
    Phase.IDLE: "no run is set up yet",
    Phase.READY: "the run has not started",
    Phase.COUNTDOWN: "the countdown is running",
    Phase.RUNNING: "a run is going on",
    Phase.STOPPED: "the run has stopped",
    Phase.FINAL: "the result is final",
}


def _longest(field: object) -> int:
    match field:
        case str():
            return len(field)
        case dict():
            return max(map(_longest, field.values()), default=0)
        case list() | tuple():
            return max(map(_longest, field), default=0)
    return 0
