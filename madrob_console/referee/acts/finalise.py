"""Finalise: the result is signed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.questions import Ask, Option, Pick, Question, Write
from madrob_console.referee.run import Closure, Phase, Run, TeamWord

_TEAM = Pick(
    "What does the team say?",
    (
        Option("n", "not yet", None),
        Option("a", "acknowledged", TeamWord.ACKNOWLEDGED),
        Option("p", "protested", TeamWord.PROTESTED),
        Option("b", "absent", TeamWord.ABSENT),
    ),
)
_NOTE = Write("Note (Enter for none):")
_NAMELESS = "finalising needs the referee's name"


@dataclass(frozen=True, slots=True)
class Finalise(Act):
    """Close the result, with the team's word."""

    name = "finalise"
    phases = (Phase.STOPPED,)
    team_word: TeamWord
    referee: str
    note: str = ""

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Not before the result is written."""
        return None if situation.scored else "the result is being written"

    def problem(self, situation: Situation) -> str | None:
        """The referee signs."""
        return None if self.referee.strip() else _NAMELESS

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act]:
        """The team's word, a note, and the referee's name where it is missing."""
        referee = view.run.referee
        name = () if referee else (Write("Referee's name:", missing=_NAMELESS),)
        questions: tuple[Question, ...] = (_TEAM, _NOTE, *name)
        return Ask(
            "Finalise the result",
            questions,
            lambda word, note, by=referee: cls(TeamWord(word), by, note),
        )

    def apply(self, situation: Situation, at: float) -> Run:
        """The result is final."""
        closure = Closure(at, self.referee, self.team_word, self.note)
        return replace(situation.run, phase=Phase.FINAL, closure=closure)

    @property
    def signature(self) -> str:
        """Who signed."""
        return self.referee

    @property
    def done(self) -> str:
        """With the team's word."""
        return f"the result is final, {self.team_word} by the team"
