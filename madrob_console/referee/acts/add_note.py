"""A note beside the run."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.on_record import Note
from madrob_console.referee.questions import Write
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class AddNote(Act):
    """Write a note beside the run."""

    name = "note"
    phases = tuple(phase for phase in Phase if phase is not Phase.IDLE)
    missing = "the note is empty"
    title = "Note"
    questions = (Write("Text:", missing=missing),)
    note: str

    def apply(self, situation: Situation, at: float) -> Run:
        """One more note."""
        run = situation.run
        return replace(run, notes=(*run.notes, Note(at, self.note)))
