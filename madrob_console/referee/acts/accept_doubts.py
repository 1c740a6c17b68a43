"""Accept doubts on a result: the values stand as they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

from madrob_console.referee.acts.act import Act, Asked, RunView, Situation
from madrob_console.referee.doubt_answers import Doubts, doubted_words, waiting_doubts
from madrob_console.referee.on_record import AcceptedDoubts, DecisionKind
from madrob_console.referee.questions import Ask, Option, Pick, reasons
from madrob_console.referee.run import Phase, Run

_NO_DOUBT = "no doubt waits for the referee"
_ALL = "all"
_MOST_LISTED = 4
"""Sentences of two rows that a dialog has room for, in 80 x 24 cells."""
_WHY = Pick(
    "Why? It stands with the result, and so do the doubts.",
    reasons("seen on video: right", "no effect on the ranking", "the run is repeated"),
)


@dataclass(frozen=True, slots=True)
class AcceptDoubts(Act):
    """Let doubts on a result stand, with a reason (section 11).

    It says which: what is doubted of a later issue for another reason waits again.

    Attributes:
        doubts: the sentences, by indicator.
        reason: why.
    """

    name = "accept doubts"
    phases = (Phase.STOPPED,)
    missing = "accepting a doubt needs a reason"
    title = "Accept doubts: the values stand as they are"
    doubts: Doubts
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs a result with a doubt that waits."""
        if not situation.scored:
            return "the result is being written"
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        return None if waiting else _NO_DOUBT

    def problem(self, situation: Situation) -> str | None:
        """Only what is doubted, and waits, can be accepted."""
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        named = [(name, words) for name, found in self.doubts.items() for words in found]
        if not named:
            return "accepting doubts needs one that waits"
        if any(words not in waiting.get(name, ()) for name, words in named):
            return "what is doubted is something else by now: look again"
        return None

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Asked] | str:
        """On which indicator, where there are several; then why, with all that is doubted of it."""
        waiting = waiting_doubts(view.indicators, view.run.accepted_doubts)
        if not waiting:
            return _NO_DOUBT
        if len(waiting) == 1:
            return cls._ask_why(waiting)
        each = (
            Option(str(number), f"{name.words}: {_counted(len(found))}", name)
            for number, (name, found) in enumerate(waiting.items(), 1)
        )
        question = Pick("On which indicator?", (Option("a", "on all of them", _ALL), *each))

        def chosen(which: str) -> Ask[Asked]:
            only = {name: found for name, found in waiting.items() if which in (_ALL, name)}
            return cls._ask_why(only)

        return Ask(cls.title, (question,), chosen)

    @classmethod
    def _ask_why(cls, doubts: Doubts) -> Ask[Asked]:
        """Why they are accepted, below the sentences; one may stand on several indicators."""
        listed = [f"? {words}" for words in dict.fromkeys(chain(*doubts.values()))]
        if (more := len(listed) - _MOST_LISTED) > 1:
            listed[_MOST_LISTED:] = [f"? and {more} more: the result has all of them"]
        title = f"Accept what is doubted of {doubted_words(doubts)}"
        question = replace(_WHY, listed=tuple(listed))
        return Ask(title, (question,), lambda reason: cls(doubts, reason))

    def apply(self, situation: Situation, at: float) -> Run:
        """They are accepted, and stay beside the values."""
        run = situation.run
        accepted = AcceptedDoubts(at, self.reason, run.referee, self.doubts)
        return replace(
            run,
            decided=run.decided_and(DecisionKind.DOUBTS),
            accepted_doubts=(*run.accepted_doubts, accepted),
        )

    @property
    def done(self) -> str:
        """On which indicators."""
        return f"doubt accepted: {doubted_words(self.doubts)}"

    @property
    def logged(self) -> str:
        """On which indicators."""
        return f"referee accepts the doubt on {doubted_words(self.doubts)}"


def _counted(doubts: int) -> str:
    return f"{doubts} doubt{'s' if doubts > 1 else ''}"
