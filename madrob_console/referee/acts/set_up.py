"""Set up the next run."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Consequence, RunView, Situation
from madrob_console.referee.flags import undecided
from madrob_console.referee.questions import Ask, Sure
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_setup import RunSetup


@dataclass(frozen=True, slots=True)
class SetUp(Act):
    """Set up the next run. A form asks for the set-up, not a dialog."""

    name = "set up"
    phases = (Phase.IDLE, Phase.READY, Phase.STOPPED, Phase.FINAL)
    consequences = Consequence.NEW_RUN
    setup: RunSetup

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Not before the result of the last run is written, if it can be."""
        over = situation.run.phase in (Phase.STOPPED, Phase.FINAL)
        if over and not (situation.scored or situation.hopeless):
            return "the result of the last run is being written"
        return None

    def problem(self, situation: Situation) -> str | None:
        """A bad set-up, naming the field; a name that the list does not have, without a reason."""
        return self.setup.problem() or situation.teams.problem(self.setup)

    def settled(self, situation: Situation) -> Act:
        """With its identity; on a simulated testbed every run is practice (protocol section 2)."""
        practice = self.setup.practice or situation.simulated is not None
        return SetUp(
            replace(
                self.setup,
                practice=practice,
                run_id=situation.new_id(),
                testbed=situation.testbed,
                competition=situation.competition,
            )
        )

    def unless_final(self, view: RunView) -> Act | Ask[Act]:
        """At once; asked first if the last result waits for a signature.

        That of an aborted or voided run does not: the referee has ended it with a reason, and
        nothing of it is left to decide. An interrupted one does: a machine ended it, it has
        indicators, and whether it is repeated is the referee's decision (protocol section 2).
        """
        if not view.run.unsigned:
            return self
        left = "".join(f", {flag.words}" for flag in undecided(view.flags))
        sure = Sure(f"The last result is not final{left}: it stays as it is. Set up the next run?")
        return Ask("Next run", (sure,), lambda: self)

    def apply(self, situation: Situation, at: float) -> Run:
        """A clean run: nothing of the one before stays but the handle zero."""
        return replace(situation.run.cleared, phase=Phase.READY, setup=self.setup)

    @property
    def reason_given(self) -> str:
        """Why the team has another name than in the list."""
        return self.setup.team_reason

    @property
    def done(self) -> str:
        """Which run."""
        kind = "practice run" if self.setup.practice else "run"
        return f"{kind} {self.setup.run_number} of subject {self.setup.subject} is set up"
