"""Acts on a result: accept doubts, finalise, re-issue."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import chain

from madrob_console.common.formatting import counted
from madrob_console.referee.acts.act import (
    RESULT_IS_WRITTEN,
    Act,
    Ask,
    Asked,
    Option,
    Pick,
    Question,
    RunView,
    Situation,
    Sure,
    Write,
    ask_why,
    reasons,
)
from madrob_console.referee.flags import Doubts, doubted_words, undecided, waiting_doubts
from madrob_console.referee.records import (
    AcceptedDoubts,
    Closure,
    DecisionKind,
    Protest,
    ProtestEnd,
    TeamWord,
    open_protests,
)
from madrob_console.referee.run import Phase, Run
from scoring.indicator_table import IndicatorName

_TEAM = Pick(
    "What does the team say?",
    (
        Option("n", "nothing yet: do not sign", None),
        Option("a", "acknowledged", TeamWord.ACKNOWLEDGED),
        Option("b", "absent", TeamWord.ABSENT),
    ),
    below=("If it protests: Escape, then Enter P files the protest.",),
)
_SIGN = "sign"
_SO = (
    Option("n", "no: decide first", None),
    Option("y", "yes, sign it as it is: that stays on record", _SIGN),
)
_NOTE = Write("Note (Enter for none):")
_NAMELESS = "signing needs the referee's name"


@dataclass(frozen=True, slots=True)
class Finalise(Act):
    """Close the result; `undecided` are all open questions that the referee knows of."""

    name = "finalise"
    phases = (Phase.STOPPED,)
    at_once = False
    done = "the result is signed, {act.team_word.told}"
    log = "result signed by {act.referee}, {act.team_word.told}"
    team_word: TeamWord
    referee: str
    note: str = ""
    undecided: tuple[str, ...] = ()

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if not situation.scored:
            return RESULT_IS_WRITTEN
        if open_protests(situation.run.protests):
            return "a protest is open: decide it first (Enter, then P)"
        return situation.refused or None

    def problem(self, situation: Situation) -> str | None:
        """Needs a signature, and every open question named."""
        if not self.referee.strip():
            return _NAMELESS
        found = [flag.words for flag in undecided(situation.flags)]
        if unseen := [words for words in found if words not in self.undecided]:
            return f"decide it first, or sign it knowing so: {'; '.join(unseen)}"
        if len(found) < len(self.undecided):
            return "what was undecided is decided by now: look again"
        return None

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Ask[Act]:
        """Asks for the team's word, a note and a missing name; first lists open questions."""
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

        return Ask("Sign the result", tuple(questions), make)

    def apply(self, situation: Situation, at: float) -> Run:
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
        return self.referee


def _checklist(view: RunView) -> tuple[str, ...]:
    found, unchanged = view.flags, _without_effect(view.run)
    steps = ", ".join(f"{record.step:d}" for record in view.steps if record.done)
    told = (IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME)
    values = [f"{n.words} {one.text}" for n, one in view.indicators.items() if n in told]
    rows = ["; ".join((f"{view.run.outcome}, steps {steps or 'none'}", *values))]
    rows += [f"! {flag.words}" for flag in undecided(found)]
    rows += [f"! {one.title} was upheld: nothing was changed since" for one in unchanged]
    if others := [flag.words for flag in found if not flag.undecided]:
        rows.append(f"- {'; '.join(others)}")
    return tuple(rows)


def _without_effect(run: Run) -> list[Protest]:
    """Upheld protests after whose filing nothing about the result has changed."""
    changed = -math.inf if run.changed is None else run.changed
    upheld = (ProtestEnd.UPHELD, ProtestEnd.PARTLY)
    return [
        one
        for one in run.protests
        if one.answer is not None and one.answer.end in upheld and changed < one.time
    ]


# Accept doubts on a result: the values stand as they are.


_NO_DOUBT = "no doubt waits for the referee"
_ALL = "all"
_MOST_LISTED = 4
"""Sentences of two rows that fit in a dialog, in 80 x 24 cells."""
_WHY = ask_why("seen on video: right", "no effect on the ranking", "the run is repeated")


@dataclass(frozen=True, slots=True)
class AcceptDoubts(Act):
    """Accept doubts (section 11); a later issue's doubt for another reason waits again."""

    name = "accept doubts"
    phases = (Phase.STOPPED,)
    missing = "accepting a doubt needs a reason"
    undoable = True
    title = "Accept doubts: the values stand as they are"
    doubts: Doubts
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if not situation.scored:
            return RESULT_IS_WRITTEN
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        return None if waiting else _NO_DOUBT

    def problem(self, situation: Situation) -> str | None:
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        named = [(name, words) for name, found in self.doubts.items() for words in found]
        if not named:
            return "accepting doubts needs one that waits"
        if any(words not in waiting.get(name, ()) for name, words in named):
            return "what is doubted is something else by now: look again"
        return None

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Ask[Asked] | str:
        waiting = waiting_doubts(view.indicators, view.run.accepted_doubts)
        if not waiting:
            return _NO_DOUBT
        if len(waiting) == 1:
            return cls._ask_why(waiting)
        each = (
            Option(str(number), f"{name.words}: {counted(len(found), 'doubt')}", name)
            for number, (name, found) in enumerate(waiting.items(), 1)
        )
        every = (Option("a", "on all of them", _ALL), *each)
        question = Pick("On which indicator?", every, quick=True)

        def chosen(which: str) -> Ask[Asked]:
            only = {name: found for name, found in waiting.items() if which in (_ALL, name)}
            return cls._ask_why(only)

        return Ask(cls.title, (question,), chosen)

    @classmethod
    def _ask_why(cls, doubts: Doubts) -> Ask[Asked]:
        listed = [f"? {words}" for words in dict.fromkeys(chain(*doubts.values()))]
        if (more := len(listed) - _MOST_LISTED) > 1:
            listed[_MOST_LISTED:] = [f"? and {more} more: the result has all of them"]
        title = f"Accept what is doubted of {doubted_words(doubts)}"
        question = replace(_WHY, listed=tuple(listed))
        return Ask(title, (question,), lambda reason: cls(doubts, reason))

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        accepted = AcceptedDoubts(at, self.reason, run.referee, self.doubts)
        return replace(
            run,
            decided=run.decided_and(DecisionKind.DOUBTS),
            accepted_doubts=(*run.accepted_doubts, accepted),
        )

    @property
    def done_text(self) -> str:
        return f"doubt accepted: {doubted_words(self.doubts)}"

    @property
    def logged(self) -> str:
        return f"referee accepts the doubt on {doubted_words(self.doubts)}"


# Re-issue: a final result can be ruled again, and gets a new issue.


@dataclass(frozen=True, slots=True)
class Reissue(Act):
    """Open a final result again; the next issue gets a new number, the old one stays."""

    name = "re-issue"
    phases = (Phase.FINAL,)
    at_once = False
    elsewhere = "only a final result is re-issued"
    missing = "a re-issue needs a reason"
    title = "Re-issue the final result; the old version stays"
    done = "the next version waits for its signature"
    questions = (
        Pick("Why?", reasons("a step was ruled wrongly", "found out later")),
        Sure("Re-issue the result?"),
    )
    reason: str

    def apply(self, situation: Situation, at: float) -> Run:
        return self.opened_again(situation.run, at)
