"""Rule on a step."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.on_record import DecisionKind
from madrob_console.referee.questions import Ask, Option, Pick, Sure, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_times import relative_text
from madrob_console.referee.transitions import changed
from scoring.procedure import Ruling
from scoring.protocol import Step

RULED = {True: "confirmed", False: "denied", None: "as the sensors say"}
"""What a ruling says of a step."""

_VERDICTS = {"confirm": True, "deny": False, "sensors": None}
_LOGGED = {True: "confirms", False: "denies", None: "takes back the ruling on"}
_WHY = Pick(
    "Why?",
    reasons(
        *("seen by the referee", "sensor missed it", "sensor false alarm", "seen on video"),
        "my mistake",
    ),
)


@dataclass(frozen=True, slots=True)
class Rule(Act):
    """Confirm or deny a step (section 7), or take that back. The latest ruling counts."""

    name = "rule on a step"
    phases = (Phase.RUNNING, Phase.STOPPED)
    missing = "a ruling needs a reason"
    step: Step
    confirmed: bool | None
    reason: str

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act]:
        """Confirmed or denied, and why; the key is the step's number."""
        step = Step(int(pressed))
        record = next((record for record in view.steps if record.step is step), None)
        found = None if record is None else record.sensors
        sensors = "not done" if found is None else relative_text(found, view.run.start) + " s"
        verdict = Pick(
            f"Sensors: {sensors}. Referee: {_said(record.referee if record else None)}.",
            (
                Option("c", "confirm: it is done", "confirm"),
                Option("d", "deny: it is not done", "deny"),
                Option("s", "as the sensors say: take a ruling back", "sensors"),
            ),
        )
        return Ask(
            f"Step {step}: {step.text}",
            (verdict, _WHY, Sure("Is that right? It can be ruled again.")),
            lambda word, reason: cls(step, _VERDICTS[word], reason),
        )

    def apply(self, situation: Situation, at: float) -> Run:
        """One more ruling."""
        run = situation.run
        ruling = Ruling(self.step, self.confirmed, at, self.reason, run.referee)
        decided = run.decided_and(DecisionKind.RULING)
        return changed(replace(run, decided=decided, rulings=(*run.rulings, ruling)), at)

    @property
    def done(self) -> str:
        """Which step, and how."""
        return f"step {self.step} {RULED[self.confirmed]}"

    @property
    def logged(self) -> str:
        """Which step, and how."""
        return f"referee {_LOGGED[self.confirmed]} step {self.step}"


def _said(ruling: Ruling | None) -> str:
    if ruling is None:
        return "nothing yet"
    return f"{RULED[ruling.confirmed]} ({ruling.reason})"
