"""Accept the false start: it may pass."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.questions import Pick, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import decide_false_starts


@dataclass(frozen=True, slots=True)
class AcceptFalseStart(Act):
    """Let the false starts found so far pass, with a reason."""

    name = "accept the false start"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    missing = "accepting a false start needs a reason"
    title = "Accept the false start"
    questions = (
        Pick("Why?", reasons("nothing gained", "sensor false alarm", "caused by a person")),
    )
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs an undecided false start."""
        undecided = situation.run.undecided_false_start
        return "there is no false start to accept" if undecided is None else None

    def apply(self, situation: Situation, at: float) -> Run:
        """All undecided false starts are accepted."""
        return decide_false_starts(situation.run, self.reason)
