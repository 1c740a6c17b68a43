"""Withdraw an incident."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.on_record import DecisionKind
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class WithdrawIncident(Act):
    """Take back the last incident: in older journals; today `TakeBack` does."""

    name = "withdraw an incident"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    missing = "withdrawing an incident needs a reason"
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs an incident."""
        if situation.run.last_incident is None:
            return "there is no incident to withdraw"
        return None

    def apply(self, situation: Situation, at: float) -> Run:
        """The last incident that stands is withdrawn."""
        run = situation.run
        withdrawn = tuple(
            replace(mark, withdrawn=self.reason) if mark is run.last_incident else mark
            for mark in run.incidents
        )
        return replace(run, decided=run.decided_without(DecisionKind.INCIDENT), incidents=withdrawn)
