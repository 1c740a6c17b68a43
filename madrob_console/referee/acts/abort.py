"""Abort: the run is interrupted."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import LONGEST_TEXT, Act, Situation
from madrob_console.referee.acts.void import Void
from madrob_console.referee.questions import Sure, meanwhile
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import stop
from scoring.protocol import Outcome


@dataclass(frozen=True, slots=True)
class Abort(Act):
    """Interrupt the run: it is invalid (section 2). Wins over everything."""

    name = "abort"
    phases = (Phase.COUNTDOWN, Phase.RUNNING)
    title = "ABORT the run: it becomes invalid and stays on record"
    questions = (
        meanwhile("robot unsafe", "testbed fault", "referee's mistake", "the team asks for it"),
        Sure("Abort now?"),
    )
    urgent = True
    reason: str = ""

    def __post_init__(self) -> None:
        """A reason that is too long is cut: nothing refuses an abort."""
        object.__setattr__(self, "reason", self.reason[:LONGEST_TEXT])

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """A run that is over can be voided instead, if it counts."""
        refused = super(Abort, cls).impossible(situation)
        if refused is not None and Void.impossible(situation) is None:
            return f"{refused}: void it instead"
        return refused

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped, invalid."""
        return stop(situation.run, Outcome.ABORTED, at, self.reason or "aborted by the referee")
