"""Re-issue: a final result can be ruled again, and gets a new issue."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.questions import Pick, Sure, reasons
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class Reissue(Act):
    """Make a final result not final again; the next issue gets a new number, the old one stays."""

    name = "re-issue"
    phases = (Phase.FINAL,)
    at_once = False
    elsewhere = "only a final result is re-issued"
    missing = "a re-issue needs a reason"
    title = "Re-issue the final result; the old issue stays"
    questions = (
        Pick("Why?", reasons("a step was ruled wrongly", "protest of the team accepted")),
        Sure("Re-issue the result?"),
    )
    reason: str

    def problem(self, situation: Situation) -> str | None:
        """Not before the final result is written: it is kept beside the next issue.

        It is while the question is answered: the key is not refused for that moment.
        """
        return None if situation.scored else "the result is being written"

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped again: rulings are possible until it is finalised once more."""
        return self.opened_again(situation.run, at)
