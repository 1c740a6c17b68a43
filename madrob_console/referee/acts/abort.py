"""Abort: the run is interrupted."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Situation
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
    at_once = True
    reason: str = ""

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped, invalid."""
        return stop(situation.run, Outcome.ABORTED, at, self.reason or "aborted by the referee")
