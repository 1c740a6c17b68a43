"""Acts on protests: file, decide, withdraw."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.protests import Protest, ProtestAnswer, ProtestEnd, open_protests
from madrob_console.referee.records import DecisionKind
from madrob_console.referee.run import Phase, Run

NONE_OPEN = "no protest is open"


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
        return None if open_protests(situation.run.protests) else NONE_OPEN

    def problem(self, situation: Situation) -> str | None:
        return closing_problem(self.number, situation.run)

    def apply(self, situation: Situation, at: float) -> Run:
        run = self.opened_again(situation.run, at)
        answer = ProtestAnswer(at, ProtestEnd.WITHDRAWN, self.reason, run.referee)
        return closed(run, self.number, answer)


def closing_problem(number: int, run: Run) -> str | None:
    if any(protest.number == number for protest in open_protests(run.protests)):
        return None
    return f"protest {number} is not open: look again"


def closed(run: Run, number: int, answer: ProtestAnswer | None) -> Run:
    protests = tuple(
        replace(protest, answer=answer) if protest.number == number else protest
        for protest in run.protests
    )
    return replace(run, protests=protests)


NAMELESS = "a decision needs the referee's name"


@dataclass(frozen=True, slots=True)
class DecideProtest(Act):
    """Close a protest with words and a name (section 2).

    It changes nothing of the result itself: rulings, corrections and voids do. A result that was
    signed with the protest open is opened again.
    """

    name = "decide protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a decision needs words"
    done = log = "protest {act.number} {act.end}"
    stands_out = True
    undoable = True
    number: int
    end: ProtestEnd
    reason: str
    referee: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        return None if open_protests(situation.run.protests) else NONE_OPEN

    def problem(self, situation: Situation) -> str | None:
        if self.end is ProtestEnd.WITHDRAWN:
            return "a protest is withdrawn by the team, not by a decision"
        if not self.referee.strip():
            return NAMELESS
        return closing_problem(self.number, situation.run)

    def apply(self, situation: Situation, at: float) -> Run:
        answer = ProtestAnswer(at, self.end, self.reason, self.referee)
        run = closed(self.opened_again(situation.run, at), self.number, answer)
        return replace(run, decided=run.decided_and(DecisionKind.PROTEST))


MOST_PROTESTS = 20
"""Protests against one run."""

_MARGIN = 60.0
"""s before or after the recording in which a protested instant may lie."""

WHOLE_RUN = "the whole run"
WRITE_NOTE = "add a note"


@dataclass(frozen=True, slots=True)
class FileProtest(Act):
    """A team protests: the result is open until that is decided or withdrawn (section 2).

    A final result is opened again: the next issue gets a number, the old one stays. `after_start`
    is the instant in question, s.
    """

    name = "protest"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a protest needs the team's words"
    stands_out = True
    done = "protest of {act.team} about {act.about} waits for a decision"
    log = "{act.team} protests about {act.about}"
    text: str
    team: str
    about: str = WHOLE_RUN
    after_start: float | None = None

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if len(situation.run.protests) >= MOST_PROTESTS:
            return f"there are {MOST_PROTESTS} protests against this run already: {WRITE_NOTE}"
        return None

    def problem(self, situation: Situation) -> str | None:
        if not self.team.strip():
            return "a protest needs the name of the team"
        after = self.after_start
        return None if after is None else outside_recording(after, situation.run)

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


def outside_recording(after_start: float, run: Run) -> str | None:
    """Why an instant cannot be protested, `after_start` s from the start; None = it can."""
    start, began = run.start, run.countdown_began
    first = 0.0 if start is None or began is None else began - start
    last = 0.0 if start is None or run.stop is None else run.stop - start
    if first - _MARGIN <= after_start <= last + _MARGIN:
        return None
    return (
        f"the recording goes from {first:.0f} s to {last:.0f} s: {after_start:g} s is more than "
        f"{_MARGIN:.0f} s outside it"
    )
