"""Acts on a result: accept doubts, finalise, re-issue."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import RESULT_IS_WRITTEN, Act, Situation
from madrob_console.referee.flags import Doubts, doubted_words, undecided, waiting_doubts
from madrob_console.referee.protests import open_protests
from madrob_console.referee.records import AcceptedDoubts, Closure, DecisionKind, TeamWord
from madrob_console.referee.run import Phase, Run

PROTEST_OPEN = "a protest is open: decide it first"
NAMELESS = "signing needs the referee's name"


@dataclass(frozen=True, slots=True)
class Finalise(Act):
    """Close the result; `undecided` are all open questions that the referee knows of."""

    name = "finalise"
    phases = (Phase.STOPPED,)
    at_once = False
    done = "the result is signed, {act.team_word.words}"
    log = "result signed by {act.referee}, {act.team_word.words}"
    team_word: TeamWord
    referee: str
    note: str = ""
    undecided: tuple[str, ...] = ()

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if not situation.scored:
            return RESULT_IS_WRITTEN
        if open_protests(situation.run.protests):
            return PROTEST_OPEN
        return situation.refused or None

    def problem(self, situation: Situation) -> str | None:
        """Needs a signature, and every open question named."""
        if not self.referee.strip():
            return NAMELESS
        open_questions = [flag.words for flag in undecided(situation.flags)]
        if unseen := [words for words in open_questions if words not in self.undecided]:
            return f"decide it first, or sign it knowing so: {'; '.join(unseen)}"
        if len(open_questions) < len(self.undecided):
            return "what was undecided is decided by now: look again"
        return None

    def apply(self, situation: Situation, at: float) -> Run:
        run, closure = situation.run, Closure(at, self.referee, self.team_word, self.note)
        signed = at if run.signed is None else run.signed
        return replace(
            run,
            phase=Phase.FINAL,
            closure=closure,
            signed=signed,
            signed_notes=len(run.notes),
        )


NO_DOUBT = "no doubt waits for the referee"


@dataclass(frozen=True, slots=True)
class AcceptDoubts(Act):
    """Accept doubts (section 11); a later issue's doubt for another reason waits again."""

    name = "accept doubts"
    done = "doubt accepted: {act.values}"
    log = "referee accepts the doubt on {act.values}"
    phases = (Phase.STOPPED,)
    missing = "accepting a doubt needs a reason"
    undoable = True
    doubts: Doubts
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if not situation.scored:
            return RESULT_IS_WRITTEN
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        return None if waiting else NO_DOUBT

    def problem(self, situation: Situation) -> str | None:
        waiting = waiting_doubts(situation.indicators, situation.run.accepted_doubts)
        named = [(name, words) for name, doubts in self.doubts.items() for words in doubts]
        if not named:
            return "accepting doubts needs one that waits"
        if any(words not in waiting.get(name, ()) for name, words in named):
            return "what is doubted is something else by now: look again"
        return None

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        accepted = AcceptedDoubts(at, self.reason, run.referee, self.doubts)
        return replace(
            run,
            decided=run.decided_and(DecisionKind.DOUBTS),
            accepted_doubts=(*run.accepted_doubts, accepted),
        )

    @property
    def values(self) -> str:
        return doubted_words(self.doubts)


@dataclass(frozen=True, slots=True)
class Reissue(Act):
    """Open a final result again; the next issue gets a new number, the old one stays."""

    name = "re-issue"
    phases = (Phase.FINAL,)
    at_once = False
    elsewhere = "only a final result is re-issued"
    missing = "a re-issue needs a reason"
    done = "the next version waits for its signature"
    reason: str

    def apply(self, situation: Situation, at: float) -> Run:
        return self.opened_again(situation.run, at)
