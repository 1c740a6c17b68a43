"""Set up the next run."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Consequence, RunView, Situation
from madrob_console.referee.questions import Ask, Sure
from madrob_console.referee.run import Phase, Run, RunSetup
from scoring.protocol import Outcome


@dataclass(frozen=True, slots=True)
class SetUp(Act):
    """Set up the next run. A form asks for the set-up, not a dialog."""

    name = "set up"
    phases = (Phase.IDLE, Phase.READY, Phase.STOPPED, Phase.FINAL)
    consequences = Consequence.NEW_RUN
    setup: RunSetup

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Not before the result of the last run is written."""
        if situation.run.phase is Phase.STOPPED and not situation.scored:
            return "the result of the last run is being written"
        return None

    def problem(self, situation: Situation) -> str | None:
        """A bad set-up, naming the field."""
        return self.setup.problem()

    def unless_final(self, view: RunView) -> Act | Ask[Act]:
        """At once; asked first if the last result is not final."""
        run = view.run
        if run.phase is not Phase.STOPPED or run.outcome is Outcome.ABORTED:
            return self
        sure = Sure("The last result is not final: it stays as it is. Set up the next run?")
        return Ask("Next run", (sure,), lambda: self)

    def apply(self, situation: Situation, at: float) -> Run:
        """A clean run: nothing of the one before stays but the handle zero."""
        return Run(Phase.READY, self.setup, handle_zero=situation.run.handle_zero)

    @property
    def done(self) -> str:
        """Which run."""
        return f"run {self.setup.run_number} of subject {self.setup.subject} is set up"
