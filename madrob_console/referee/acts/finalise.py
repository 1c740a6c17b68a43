"""Finalise: the result is signed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.flags import FlagKind, undecided
from madrob_console.referee.on_record import Closure, TeamWord
from madrob_console.referee.protests import Protest, ProtestEnd
from madrob_console.referee.questions import Ask, Option, Pick, Question, Write
from madrob_console.referee.run import Phase, Run

_TEAM = Pick(
    "What does the team say?",
    (
        Option("n", "nothing yet: do not finalise", None),
        Option("a", "acknowledged", TeamWord.ACKNOWLEDGED),
        Option("p", "protested in words only; one to be decided is filed by P", TeamWord.PROTESTED),
        Option("b", "absent", TeamWord.ABSENT),
    ),
)
_SIGN = "sign"
_SO = (
    Option("n", "no: decide first", None),
    Option("y", "yes, sign it as it is: that stays on record", _SIGN),
)
DECIDED_BY: Mapping[str, str] = {
    FlagKind.FALSE_START: "a accepts it with a reason",
    FlagKind.UNDECIDED_STEP: "its number confirms or denies it",
    FlagKind.DOUBT: "d accepts it with a reason",
    FlagKind.PROTEST: "P decides it",
}
"""Kind of what is undecided -> the key that decides it."""
_NOTE = Write("Note (Enter for none):")
_NAMELESS = "finalising needs the referee's name"


@dataclass(frozen=True, slots=True)
class Finalise(Act):
    """Close the result, with the team's word.

    Attributes:
        team_word: what the team says of it.
        referee: who signs.
        note: of the team or the referee.
        undecided: the words of all that the referee has left undecided, and knows of.
    """

    name = "finalise"
    phases = (Phase.STOPPED,)
    at_once = False
    team_word: TeamWord
    referee: str
    note: str = ""
    undecided: tuple[str, ...] = ()

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Not before the result is written."""
        if situation.scored:
            return situation.refused or None
        return "the result is being written"

    def problem(self, situation: Situation) -> str | None:
        """The referee signs, and nothing undecided is signed in silence."""
        if not self.referee.strip():
            return _NAMELESS
        found = [flag.words for flag in undecided(situation.flags)]
        if unseen := [words for words in found if words not in self.undecided]:
            return f"decide it first, or sign it knowing so: {'; '.join(unseen)}"
        if len(found) < len(self.undecided):
            return "what was undecided is decided by now: look again"
        return None

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act]:
        """The team's word, a note, the referee's name if it is missing; first what is undecided.

        The first of them lists what is to be seen before.
        """
        referee, waiting = view.run.referee, undecided(view.flags)
        listed = _checklist(view)
        questions: list[Question] = [_NOTE]
        if not referee:
            questions.append(Write("Referee's name:", missing=_NAMELESS))
        if waiting:
            questions[:0] = [Pick("Sign it all the same?", _SO, listed), _TEAM]
        else:
            questions.insert(0, replace(_TEAM, listed=listed))
        left = tuple(flag.words for flag in waiting)

        def make(*answers: str) -> Finalise:
            word, note, by = (*answers[bool(waiting) :], referee)[:3]
            return cls(TeamWord(word), by, note, left)

        return Ask("Finalise the result", tuple(questions), make)

    def apply(self, situation: Situation, at: float) -> Run:
        """The result is final."""
        run, closure = situation.run, Closure(at, self.referee, self.team_word, self.note)
        signed = at if run.signed is None else run.signed
        return replace(
            run,
            phase=Phase.FINAL,
            closure=closure,
            signed=signed,
            signed_notes=len(run.notes),
            signed_evidence=run.evidence,
        )

    @property
    def signature(self) -> str:
        """Who signed."""
        return self.referee

    @property
    def done(self) -> str:
        """With the team's word."""
        return f"the result is final, {self.team_word} by the team"


def _checklist(view: RunView) -> tuple[str, ...]:
    """What is to be seen before a result is final, what is undecided first; empty = nothing."""
    found, unchanged = view.flags, _without_effect(view.run)
    if not (found or unchanged):
        return ()
    steps = ", ".join(f"{record.step:d}" for record in view.steps if record.done)
    rows = [f"Before it is final: {view.run.outcome}, steps that count: {steps or 'none'}"]
    for flag in undecided(found):
        how = DECIDED_BY.get(flag.kind)
        rows.append(f"! {flag.words}" + (f": {how}" if how else ""))
    rows += [f"! {one.title} was upheld: nothing was changed since" for one in unchanged]
    if others := [flag.words for flag in found if not flag.undecided]:
        rows.append(f"- {'; '.join(others)}")
    return tuple(rows)


def _without_effect(run: Run) -> list[Protest]:
    """Protests that were upheld, and nothing about the result is another since they were filed."""
    changed = -math.inf if run.changed is None else run.changed
    upheld = (ProtestEnd.UPHELD, ProtestEnd.PARTLY)
    return [
        one
        for one in run.protests
        if one.answer is not None and one.answer.end in upheld and changed < one.time
    ]
