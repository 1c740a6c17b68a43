"""Declare the timeout: the robot gave up."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.questions import Sure, meanwhile
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import time_out


@dataclass(frozen=True, slots=True)
class DeclareTimeout(Act):
    """The robot gave up: a valid timeout at this instant (section 8)."""

    name = "declare timeout"
    phases = (Phase.RUNNING,)
    title = "DECLARE TIMEOUT: the run ends now and stays valid"
    questions = (
        meanwhile("the team gives up", "robot stuck", "robot stopped by itself"),
        Sure("Timeout now?"),
    )
    urgent = True
    reason: str = ""

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Only once."""
        if situation.run.timeout_at is None:
            return None
        return "the timeout is already there; a settle time is being waited for"

    def apply(self, situation: Situation, at: float) -> Run:
        """The timeout is there; a settle time that is running may still complete the run."""
        return time_out(situation.run, at, self.reason or "declared by the referee")
