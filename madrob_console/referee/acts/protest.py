"""Acts on protests: file, decide, withdraw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from madrob_console.common.formatting import relative_text, seconds_of
from madrob_console.referee.acts.act import (
    Act,
    Ask,
    Asked,
    Option,
    Pick,
    Question,
    RunView,
    Situation,
    Write,
    ask_why,
)
from madrob_console.referee.records import (
    DecisionKind,
    Protest,
    ProtestAnswer,
    ProtestEnd,
    open_protests,
)
from madrob_console.referee.run import Phase, Run
from scoring.indicator_table import IndicatorName

# The team withdraws its protest.


_NONE_OPEN = "no protest is open"


@dataclass(frozen=True, slots=True)
class WithdrawProtest(Act):
    """Close a protest because the team withdraws it (section 2); `reason` is the team's."""

    name = "withdraw protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a withdrawal needs a reason"
    done = "protest {act.number} is withdrawn"
    log = "protest {act.number} withdrawn by the team"
    number: int
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        return None if open_protests(situation.run.protests) else _NONE_OPEN

    def problem(self, situation: Situation) -> str | None:
        return closing_problem(self.number, situation.run)

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Asked:
        def withdrawal(protest: Protest) -> Ask[Act]:
            listed = (f"! {protest.team}: {protest.text}",)
            why = ask_why("satisfied by the explanation", "filed by mistake")
            question = replace(why, text="What does the team say?", listed=listed)
            title = f"The team withdraws {protest.title}"
            return Ask(title, (question,), lambda reason: cls(protest.number, reason))

        return on_which(view, "The team withdraws a protest", withdrawal)

    def apply(self, situation: Situation, at: float) -> Run:
        run = self.opened_again(situation.run, at)
        answer = ProtestAnswer(at, ProtestEnd.WITHDRAWN, self.reason, run.referee)
        return closed(run, self.number, answer)


def on_which(view: RunView, title: str, then: Callable[[Protest], Ask[Act]]) -> Asked:
    """Asks which protest is meant, where several are open; `then` makes the next dialog."""
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


def closing_problem(number: int, run: Run) -> str | None:
    if any(one.number == number for one in open_protests(run.protests)):
        return None
    return f"protest {number} is not open: look again"


def closed(run: Run, number: int, answer: ProtestAnswer | None) -> Run:
    protests = tuple(
        replace(one, answer=answer) if one.number == number else one for one in run.protests
    )
    return replace(run, protests=protests)


# Decide a protest: upheld, in part, or rejected.


_NAMELESS = "a decision needs the referee's name"
_HOW = Pick(
    "How is it decided? It changes no value: rule, correct or void for that.",
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
    signed with the protest open is opened again.
    """

    name = "decide protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = _WHY.missing
    done = log = "protest {act.number} {act.end}"
    stands_out = True
    undoable = True
    number: int
    end: ProtestEnd
    reason: str
    referee: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        return None if open_protests(situation.run.protests) else _NONE_OPEN

    def problem(self, situation: Situation) -> str | None:
        if self.end is ProtestEnd.WITHDRAWN:
            return "a protest is withdrawn by the team, not by a decision"
        if not self.referee.strip():
            return _NAMELESS
        return closing_problem(self.number, situation.run)

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Asked:
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

    def apply(self, situation: Situation, at: float) -> Run:
        answer = ProtestAnswer(at, self.end, self.reason, self.referee)
        run = closed(self.opened_again(situation.run, at), self.number, answer)
        return replace(run, decided=run.decided_and(DecisionKind.PROTEST))

    @property
    def signature(self) -> str:
        return self.referee


MOST_PROTESTS = 20
"""Protests against one run."""

_MARGIN = 60.0
"""s before or after the recording in which a protested instant may lie."""

_WHOLE = "the whole run"
_FILE, _DECIDE, _WITHDRAW = "file", "decide", "withdraw"
_TEXT = Write("What does the team say?", missing="a protest needs the team's words")


@dataclass(frozen=True, slots=True)
class FileProtest(Act):
    """A team protests: the result is open until that is decided or withdrawn (section 2).

    A final result is opened again: the next issue gets a number, the old one stays. `after_start`
    is the instant in question, s.
    """

    name = "protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    stands_out = True
    title = "PROTEST: the result stays open until it is decided"
    done = "protest of {act.team} about {act.about} waits for a decision"
    log = "{act.team} protests about {act.about}"
    text: str
    team: str
    about: str = _WHOLE
    after_start: float | None = None

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if len(situation.run.protests) >= MOST_PROTESTS:
            return f"there are {MOST_PROTESTS} protests against this run already: add a note (n)"
        return None

    def problem(self, situation: Situation) -> str | None:
        """Needs words and a team."""
        if not self.text.strip():
            return _TEXT.missing
        if not self.team.strip():
            return "a protest needs the name of the team"
        after = self.after_start
        return None if after is None else _outside(after, situation.run) or None

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Asked:
        waiting = open_protests(view.run.protests)
        if not waiting:
            return cls._ask_about(view)
        first = waiting[0]
        listed = (f"! {first.title} of {first.team}: {first.text}",)

        def chosen(what: str) -> Asked:
            if what == _FILE:
                return cls._ask_about(view)
            return (DecideProtest if what == _DECIDE else WithdrawProtest).ask_questions(
                view, pressed
            )

        options = (
            Option("d", "decide it", _DECIDE),
            Option("w", "the team withdraws it", _WITHDRAW),
            Option("a", "another protest is filed", _FILE),
        )
        question = Pick("What becomes of it?", options, listed)
        count = f"{len(waiting)} protests are open" if len(waiting) > 1 else "A protest is open"
        return Ask(count, (question,), chosen)

    @classmethod
    def _ask_about(cls, view: RunView) -> Ask[Asked]:
        run = view.run
        steps = {f"step {one.step:d}: {one.step.text}": one for one in view.steps}
        options = (
            Option("w", _WHOLE, _WHOLE),
            *(Option(str(one.step.value), one.step.text, words) for words, one in steps.items()),
            Option("i", "an indicator", "indicator"),
            Option("t", "a time of the run: type it", "time"),
        )

        def chosen(what: str) -> Asked:
            if what == "indicator":
                return cls._ask_indicator(view)
            if what == "time":
                question = Write("Seconds from the start of the run (12.5, -3, 1:05):")
                return Ask(cls.title, (question,), lambda typed: cls._ask_at(view, typed))
            found = steps.get(what)
            time = None if found is None else found.final or found.sensors
            known = time is not None and run.start is not None
            at = time - run.start if known else None  # type: ignore[operator]
            return cls._ask_words(view, what, at)

        return Ask(cls.title, (Pick("What is it about?", options),), chosen)

    @classmethod
    def _ask_indicator(cls, view: RunView) -> Ask[Asked]:
        options = tuple(
            Option(chr(ord("a") + number), name.words, name.words)
            for number, name in enumerate(
                [one for one in IndicatorName if one in view.indicators] or list(IndicatorName)
            )
        )
        question = Pick("Which indicator?", options)
        return Ask(cls.title, (question,), lambda words: cls._ask_words(view, words, None))

    @classmethod
    def _ask_at(cls, view: RunView, typed: str) -> Asked:
        at = seconds_of(typed)
        if at is None:
            return f"{typed!r} is no time: 12.5, -3 or 1:05 is one"
        if outside := _outside(at, view.run):
            return outside
        return cls._ask_words(view, f"{relative_text(at, 0.0)} s", at)

    @classmethod
    def _ask_words(cls, view: RunView, about: str, at: float | None) -> Ask[Asked]:
        run = view.run
        own = "" if run.setup is None else run.setup.team or f"subject {run.setup.subject}"
        team = (Option("1", own, own),) if own.strip() else ()
        who = Pick("Who protests?", (*team, Option("o", "another team: type it", None, free=True)))
        title = f"PROTEST about {about}"
        return Ask(title, (who, _TEXT), lambda team, text: cls(text, team, about, at))

    def apply(self, situation: Situation, at: float) -> Run:
        run = self.opened_again(situation.run, at)
        instant = None
        if self.after_start is not None and run.start is not None:
            instant = run.start + self.after_start
        protest = Protest(
            number=len(run.protests) + 1,
            time=at,
            team=self.team,
            text=self.text,
            about=self.about,
            at=instant,
            referee=run.referee,
        )
        return replace(run, protests=(*run.protests, protest))

    @property
    def reason_given(self) -> str:
        return self.text


def _outside(after_start: float, run: Run) -> str:
    start, began = run.start, run.countdown_began
    first = 0.0 if start is None or began is None else began - start
    last = 0.0 if start is None or run.stop is None else run.stop - start
    if first - _MARGIN <= after_start <= last + _MARGIN:
        return ""
    return (
        f"the recording goes from {first:.0f} s to {last:.0f} s: {after_start:g} s is more than "
        f"{_MARGIN:.0f} s outside it"
    )
