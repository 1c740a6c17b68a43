"""Take back: a decision of the referee counts no more."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.acts.rule import RULED
from madrob_console.referee.acts.withdraw_protest import closed
from madrob_console.referee.doubt_answers import doubted_words
from madrob_console.referee.on_record import DecisionKind, TakenBack
from madrob_console.referee.protests import Protest, ProtestAnswer, ProtestEnd
from madrob_console.referee.questions import Ask, Pick, Sure, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_times import relative_text
from madrob_console.referee.transitions import changed

_NOTHING = "there is nothing to take back"
_FINAL = "the result is final: re-issue it first"
_OF_A_FINAL_RESULT = (DecisionKind.VOID, DecisionKind.CORRECTION, DecisionKind.PROTEST)
_CHANGES = (DecisionKind.RULING, DecisionKind.VOID, DecisionKind.CORRECTION)


@dataclass(frozen=True, slots=True)
class Decision:
    """The last decision of its kind.

    Attributes:
        kind: what it is.
        time: when it was made, s since the epoch.
        words: what it says.
    """

    kind: DecisionKind
    time: float
    words: str


def last_decision(run: Run) -> Decision | None:
    """The last decision that can be taken back now; None if there is none."""
    last = next((kind for kind in reversed(run.decided) if _within_reach(kind, run)), None)
    return None if last is None else _last_of(last, run)


@dataclass(frozen=True, slots=True)
class TakeBack(Act):
    """Take back the last decision of the referee (section 2).

    It says which it means: one that came after it is never taken back instead. A final result is
    opened again by that, where its void, its correction or the decision on a protest is taken
    back; that protest is open again.
    """

    name = "take back"
    phases = tuple(phase for phase in Phase if phase is not Phase.IDLE)
    at_once = False
    missing = "taking back needs a reason"
    kind: DecisionKind
    made: float
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs a decision that stands."""
        run = situation.run
        if last_decision(run) is not None:
            return None
        if run.decided:
            return _FINAL
        return _NOTHING

    def problem(self, situation: Situation) -> str | None:
        """It is the last of its kind, and of a final result only what it is about."""
        run = situation.run
        if self._found(run) is None:
            return f"this {self.kind} is not the last one that stands"
        if not _within_reach(self.kind, run):
            return _FINAL
        final = run.phase is Phase.FINAL
        return "the result is being written" if final and not situation.scored else None

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act] | str:
        """Which it is, and why."""
        last = last_decision(view.run)
        if last is None:
            return _NOTHING
        return Ask(
            f"Take back the last decision: {last.words}",
            (
                Pick("Why?", reasons("my mistake", "seen on video", "protest accepted")),
                Sure("Take it back? It stays on record as taken back."),
            ),
            lambda reason: cls(last.kind, last.time, reason),
        )

    def apply(self, situation: Situation, at: float) -> Run:
        """As if it had not been decided, but for the record of it."""
        before = self.opened_again(situation.run, at)
        found = self._found(before)
        if found is None:
            raise ValueError(f"no {self.kind} of that time stands")
        record = TakenBack(at, found.kind, found.time, found.words, self.reason, before.referee)
        run = _without(before, self.kind)
        if self.kind in _CHANGES:
            run = changed(run, at)
        return replace(run, taken_back=(*run.taken_back, record))

    def _found(self, run: Run) -> Decision | None:
        if self.kind not in run.decided:
            return None
        last = _last_of(self.kind, run)
        return last if last.time == self.made else None

    @property
    def done(self) -> str:
        """What kind it was."""
        return f"{self.kind} taken back"

    @property
    def logged(self) -> str:
        """What kind it was."""
        return f"referee takes back the last {self.kind}"


def _last_of(kind: DecisionKind, run: Run) -> Decision:
    """The last decision of a kind, where one stands."""
    match kind:
        case DecisionKind.RULING:
            ruling = run.rulings[-1]
            words = f"step {ruling.step} {RULED[ruling.confirmed]} ({ruling.reason})"
            return Decision(kind, ruling.time, words)
        case DecisionKind.INCIDENT:
            mark = run.last_incident
            assert mark is not None
            at = "" if run.start is None else f" at {relative_text(mark.time, run.start)} s"
            return Decision(kind, mark.time, f"incident{at}: {mark.kind}")
        case DecisionKind.WAIVER:
            waiver = run.waivers[-1]
            words = f"check waived: {waiver.check} ({waiver.reason})"
            return Decision(kind, waiver.time, words)
        case DecisionKind.VOID:
            assert run.voided is not None
            return Decision(kind, run.voided.time, f"void ({run.voided.reason})")
        case DecisionKind.CORRECTION:
            last = run.corrections[-1]
            return Decision(kind, last.time, f"corrected: {last.words} ({last.reason})")
        case DecisionKind.DOUBTS:
            accepted = run.accepted_doubts[-1]
            words = f"doubt accepted: {doubted_words(accepted.doubts)} ({accepted.reason})"
            return Decision(kind, accepted.time, words)
        case DecisionKind.PROTEST:
            protest, answer = _last_decided(run)
            return Decision(kind, answer.time, f"{protest.title} {answer.end} ({answer.reason})")


def _last_decided(run: Run) -> tuple[Protest, ProtestAnswer]:
    """The protest that was decided last, where one was; withdrawals are the team's."""
    decided = [
        (one, one.answer)
        for one in run.protests
        if one.answer is not None and one.answer.end is not ProtestEnd.WITHDRAWN
    ]
    return max(decided, key=lambda found: (found[1].time, found[0].number))


def _without(run: Run, kind: DecisionKind) -> Run:
    """The run without its last decision of a kind."""
    left = run.decided_without(kind)
    match kind:
        case DecisionKind.RULING:
            return replace(run, decided=left, rulings=run.rulings[:-1])
        case DecisionKind.INCIDENT:
            last = run.last_incident
            return replace(
                run, decided=left, incidents=tuple(m for m in run.incidents if m is not last)
            )
        case DecisionKind.WAIVER:
            return replace(run, decided=left, waivers=run.waivers[:-1])
        case DecisionKind.VOID:
            return replace(run, decided=left, voided=None)
        case DecisionKind.CORRECTION:
            earlier, before = run.corrections[:-1], run.corrections[-1].before
            return replace(run, decided=left, setup=before, corrections=earlier)
        case DecisionKind.DOUBTS:
            return replace(run, decided=left, accepted_doubts=run.accepted_doubts[:-1])
        case DecisionKind.PROTEST:
            protest, _ = _last_decided(run)
            return closed(replace(run, decided=left), protest.number, None)


def _within_reach(kind: DecisionKind, run: Run) -> bool:
    """Whether a decision of that kind can be taken back without a re-issue before it."""
    return run.phase is not Phase.FINAL or kind in _OF_A_FINAL_RESULT
