"""Mark an incident."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.questions import Ask, Option, Pick
from madrob_console.referee.run import Incident, IncidentKind, Phase, Run


@dataclass(frozen=True, slots=True)
class MarkIncident(Act):
    """Mark an incident at this instant (section 7)."""

    name = "mark an incident"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    title = "Mark an incident now"
    questions = (
        Pick(
            "Which? It changes no indicator; n adds a note later.",
            tuple(Option(kind.value[0], kind.value, kind.value) for kind in IncidentKind),
        ),
    )
    stands_out = True
    kind: IncidentKind
    note: str = ""

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act]:
        """Which kind: the second key marks it."""
        return Ask(cls.title, cls.questions, lambda kind: cls(IncidentKind(kind)))

    def apply(self, situation: Situation, at: float) -> Run:
        """One more incident."""
        run = situation.run
        return replace(run, incidents=(*run.incidents, Incident(at, self.kind, self.note)))

    @property
    def done(self) -> str:
        """Which kind."""
        return f"{self.kind} marked"

    @property
    def logged(self) -> str:
        """Which kind."""
        return f"incident: {self.kind}"
