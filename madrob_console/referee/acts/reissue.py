"""Re-issue: a final result is opened again."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.questions import Pick, Sure, reasons
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class Reissue(Act):
    """Open a final result again; the next issue gets a new number, the old one stays."""

    name = "re-issue"
    phases = (Phase.FINAL,)
    elsewhere = "only a final result is re-issued"
    missing = "a re-issue needs a reason"
    title = "Re-issue the final result; the old issue stays"
    questions = (
        Pick("Why?", reasons("a step was ruled wrongly", "protest of the team accepted")),
        Sure("Open the result again?"),
    )
    reason: str

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped again: rulings are possible until it is finalised once more."""
        run = situation.run
        return replace(run, phase=Phase.STOPPED, closure=None, issue=run.issue + 1)
