"""Void: a valid run counts nowhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.on_record import DecisionKind, Voiding
from madrob_console.referee.questions import Ask, Pick, Sure, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import changed
from scoring.protocol import Outcome

_SURE = Sure("Void it? It can be taken back.")


@dataclass(frozen=True, slots=True)
class Void(Act):
    """The run stays on record with its indicators and counts nowhere (section 2).

    A final result is opened again by that: the next issue has a number, the old one stays.
    """

    name = "void"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "voiding a run needs a reason"
    title = "VOID this run: it stays on record and counts nowhere"
    questions = (
        Pick(
            "Why?",
            reasons("robot unsafe", "testbed fault", "referee's mistake", "protest accepted"),
        ),
        _SURE,
    )
    stands_out = True
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Only what counts can be voided."""
        run = situation.run
        if run.voided is not None:
            return "the run is void already: that can be taken back"
        if run.outcome is Outcome.ABORTED:
            return "an aborted run is invalid already"
        return None if run.valid else "an interrupted run counts nowhere already"

    def problem(self, situation: Situation) -> str | None:
        """A final result must be on disk: it is kept beside the next issue."""
        final = situation.run.phase is Phase.FINAL
        return "the result is being written" if final and not situation.scored else None

    @classmethod
    def instead_of_abort(cls, reason: str) -> Ask[Act]:
        """What to ask when an abort came just after the stop."""
        title = f"The run was over before the abort ({reason}). {cls.title}"
        return Ask(title, (_SURE,), lambda: cls(reason))

    def apply(self, situation: Situation, at: float) -> Run:
        """It counts no more."""
        run = changed(self.opened_again(situation.run, at), at)
        voided = Voiding(at, self.reason, run.referee)
        return replace(run, decided=run.decided_and(DecisionKind.VOID), voided=voided)

    @property
    def done(self) -> str:
        """What it means."""
        return "the run is void and counts nowhere"

    @property
    def logged(self) -> str:
        """What it means."""
        return "run voided"
