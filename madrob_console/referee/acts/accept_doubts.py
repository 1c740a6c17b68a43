"""Accept doubts on a result: the values stand as they are."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.doubts import doubted_words, waiting_doubts
from madrob_console.referee.questions import Ask, Option, Pick, Question, reasons
from madrob_console.referee.run import AcceptedDoubts, DecisionKind, Phase, Run
from scoring.indicator_table import IndicatorName

_NO_DOUBT = "no doubt waits for the referee"
_ALL = "all"
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
    doubts: dict[IndicatorName, tuple[str, ...]]
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
    def ask(cls, view: RunView, pressed: str) -> Ask[Act] | str:
        """Of which indicator, where there are several, and why; all doubts are seen before."""
        waiting = waiting_doubts(view.indicators, view.run.accepted_doubts)
        if not waiting:
            return _NO_DOUBT
        # one sentence may stand on several indicators: it is read once
        on: dict[str, dict[IndicatorName, tuple[str, ...]]] = {}
        for name, sentences in waiting.items():
            for words in sentences:
                on.setdefault(words, {})[name] = sentences
        listed = tuple(f"? {words} ({doubted_words(names)})" for words, names in on.items())
        questions: list[Question] = [replace(_WHY, listed=listed)]
        if len(waiting) > 1:
            each = (Option(str(number), name.words, name) for number, name in enumerate(waiting, 1))
            options = (Option("a", "all of them", _ALL), *each)
            questions = [Pick("Which does the referee accept?", options, listed), _WHY]

        def make(*answers: str) -> AcceptDoubts:
            *which, reason = answers
            chosen = [name for name in waiting if which in ([], [_ALL], [name])]
            return cls({name: waiting[name] for name in chosen}, reason)

        return Ask(cls.title, tuple(questions), make)

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
