"""Decide a protest: upheld, in part, or rejected."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Asked, RunView, Situation
from madrob_console.referee.acts.withdraw_protest import closed, closing_problem, on_which
from madrob_console.referee.on_record import DecisionKind
from madrob_console.referee.protests import (
    Protest,
    ProtestAnswer,
    ProtestEnd,
    late_words,
    open_protests,
)
from madrob_console.referee.questions import Ask, Option, Pick, Question, Write
from madrob_console.referee.run import Phase, Run

_NAMELESS = "a decision needs the referee's name"
_HOW = Pick(
    "How is it decided? What that changes: 1-6 rule, c corrects, v voids; then f.",
    (
        Option("u", "upheld", ProtestEnd.UPHELD),
        Option("p", "partly upheld", ProtestEnd.PARTLY),
        Option("r", "rejected", ProtestEnd.REJECTED),
    ),
)
_WHY = Write("In words, for the team:", missing="a decision needs words")


@dataclass(frozen=True, slots=True)
class DecideProtest(Act):
    """Close a protest with words and a name (section 2).

    It changes nothing of the result itself: rulings, corrections and voids do. A result that was
    signed with the protest open is opened again by that.

    Attributes:
        number: of the protest.
        end: how it is decided.
        reason: in words, for the team.
        referee: who decides.
        late: that it is after its deadline, in words; empty = in time. Given out by the engine.
    """

    name = "decide protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = _WHY.missing
    stands_out = True
    number: int
    end: ProtestEnd
    reason: str
    referee: str
    late: str = ""

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs an open protest."""
        return None if open_protests(situation.run.protests) else "no protest is open"

    def problem(self, situation: Situation) -> str | None:
        """It is open, is decided, and somebody signs that."""
        if self.end is ProtestEnd.WITHDRAWN:
            return "a protest is withdrawn by the team, not by a decision"
        if not self.referee.strip():
            return _NAMELESS
        return closing_problem(self.number, situation)

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Asked:
        """Which one, where there are several; how, why, and who decides if that is not known."""

        def decision(protest: Protest) -> Ask[Act]:
            how = replace(_HOW, listed=(f"! {protest.team}: {protest.text}",))
            questions: list[Question] = [how, _WHY]
            known = view.run.referee
            if not known:
                questions.append(Write("Referee's name:", missing=_NAMELESS))

            def make(end: str, why: str, by: str = known) -> DecideProtest:
                return cls(protest.number, ProtestEnd(end), why, by)

            return Ask(f"Decide {protest.title}", tuple(questions), make)

        return on_which(view, "Decide a protest", decision)

    def settled(self, situation: Situation) -> Act:
        """With a word where it comes late."""
        known = (one for one in situation.run.protests if one.number == self.number)
        due = next((one.due for one in known), math.inf)
        return replace(self, late=late_words(due, situation.time))

    def apply(self, situation: Situation, at: float) -> Run:
        """It is closed."""
        answer = ProtestAnswer(at, self.end, self.reason, self.referee)
        run = closed(self.opened_again(situation.run, at), self.number, answer)
        return replace(run, decided=run.decided_and(DecisionKind.PROTEST))

    @property
    def signature(self) -> str:
        """Who decided."""
        return self.referee

    @property
    def done(self) -> str:
        """How."""
        return self.logged

    @property
    def logged(self) -> str:
        """How, and whether late."""
        return f"protest {self.number} {self.end}{f' ({self.late})' if self.late else ''}"
