"""The team withdraws its protest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Asked, RunView, Situation
from madrob_console.referee.protests import Protest, ProtestAnswer, ProtestEnd, open_protests
from madrob_console.referee.questions import Ask, Option, Pick, reasons
from madrob_console.referee.run import Phase, Run

_NONE_OPEN = "no protest is open"


@dataclass(frozen=True, slots=True)
class WithdrawProtest(Act):
    """Close a protest because the team withdraws it (section 2).

    Attributes:
        number: of the protest.
        reason: what the team says.
    """

    name = "withdraw protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a withdrawal needs a reason"
    number: int
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs an open protest."""
        return None if open_protests(situation.run.protests) else _NONE_OPEN

    def problem(self, situation: Situation) -> str | None:
        """It is open."""
        return closing_problem(self.number, situation)

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Asked:
        """Which one, where there are several, and why."""

        def withdrawal(protest: Protest) -> Ask[Act]:
            listed = (f"! {protest.team}: {protest.text}",)
            why = reasons("satisfied by the explanation", "filed by mistake")
            question = Pick("What does the team say?", why, listed)
            title = f"The team withdraws {protest.title}"
            return Ask(title, (question,), lambda reason: cls(protest.number, reason))

        return on_which(view, "The team withdraws a protest", withdrawal)

    def apply(self, situation: Situation, at: float) -> Run:
        """It is closed."""
        run = self.opened_again(situation.run, at)
        answer = ProtestAnswer(at, ProtestEnd.WITHDRAWN, self.reason, run.referee)
        return closed(run, self.number, answer)

    @property
    def done(self) -> str:
        """Which one."""
        return f"protest {self.number} is withdrawn"

    @property
    def logged(self) -> str:
        """Which one."""
        return f"protest {self.number} withdrawn by the team"


def on_which(view: RunView, title: str, then: Callable[[Protest], Ask[Act]]) -> Asked:
    """Ask which protest is meant, where several are open.

    Args:
        view: what the referee sees.
        title: of the question.
        then: what to ask about the one that is meant.
    """
    waiting = {str(one.number): one for one in open_protests(view.run.protests)}
    if not waiting:
        return _NONE_OPEN
    if len(waiting) == 1:
        return then(*waiting.values())
    options = tuple(
        Option(chr(ord("a") + at), f"{one.title} of {one.team}", number)
        for at, (number, one) in enumerate(list(waiting.items())[:9])
    )
    question = Pick("Which one?", options)
    return Ask(title, (question,), lambda number: then(waiting[number]))


def closing_problem(number: int, situation: Situation) -> str | None:
    """Why a protest cannot be closed, in words; None = it can."""
    run = situation.run
    if all(one.number != number for one in open_protests(run.protests)):
        return f"protest {number} is not open: look again"
    final = run.phase is Phase.FINAL
    return "the result is being written" if final and not situation.scored else None


def closed(run: Run, number: int, answer: ProtestAnswer | None) -> Run:
    """The run with a protest that is closed, or open again."""
    protests = tuple(
        replace(one, answer=answer) if one.number == number else one for one in run.protests
    )
    return replace(run, protests=protests)
