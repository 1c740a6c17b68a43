"""Restart the countdown."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Consequence, RunView, Situation
from madrob_console.referee.questions import Ask, Pick, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import begin_countdown, decide_false_starts


@dataclass(frozen=True, slots=True)
class RestartCountdown(Act):
    """Begin the countdown again after a false start."""

    name = "restart the countdown"
    phases = (Phase.COUNTDOWN,)
    title = "Restart the countdown"
    questions = (
        Pick("Why?", reasons("robot not ready", "person in the way", "testbed not ready")),
    )
    at_once = False
    consequences = Consequence.COUNTDOWN
    reason: str = "false start"

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Act | Ask[Act]:
        """Why, where no false start says so."""
        if view.run.undecided_false_start is not None:
            return cls()
        return Ask(cls.title, cls.questions, cls)

    def apply(self, situation: Situation, at: float) -> Run:
        """A new planned start; earlier false starts count as decided by the restart."""
        return begin_countdown(decide_false_starts(situation.run, "countdown restarted"), at)
