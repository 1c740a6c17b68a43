"""Start: the countdown begins."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.referee.acts.act import Act, Consequence, Situation
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import begin_countdown


@dataclass(frozen=True, slots=True)
class Start(Act):
    """Open the recording and begin the countdown."""

    name = "start"
    phases = (Phase.READY,)
    at_once = False
    consequences = Consequence.RECORDING | Consequence.COUNTDOWN

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Every check must be ok or waived; what is simulated must be set up as practice."""
        setup = situation.run.setup
        if situation.simulated is not None and setup is not None and not setup.practice:
            return "the testbed is simulated, a run on it is practice: set it up again"
        blocks = blocking(situation.checks)
        if not blocks:
            return None
        more = f" (and {len(blocks) - 1} more)" if len(blocks) > 1 else ""
        return f"{blocks[0].name}: {blocks[0].reason}{more}"

    def apply(self, situation: Situation, at: float) -> Run:
        """The countdown runs; the start is planned."""
        return begin_countdown(situation.run, at)
