"""Acts that change what was decided: correct the set-up, take a decision back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from madrob_console.common.formatting import relative_text
from madrob_console.referee.acts.act import RESULT_IS_WRITTEN, Act, Situation
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.acts.protest import closed
from madrob_console.referee.flags import doubted_words
from madrob_console.referee.protests import Protest, ProtestAnswer, ProtestEnd
from madrob_console.referee.records import Correction, DecisionKind, TakenBack
from madrob_console.referee.run import Phase, Run, changed
from madrob_console.referee.run_setup import RunSetup
from scoring.protocol import Condition

NO_RUN = "no run is set up yet"


@dataclass(frozen=True, slots=True)
class Correct(Act):
    """Correct subject, sides or benchmark type; the run is scored again (section 2).

    The folder keeps its name. In another series (subject and condition) the run gets the number
    that it had there before, else the next unused one. A final result is opened again. The engine
    sets `team` from the list of teams, and `run_number`; 0 = not yet.
    """

    name = "correct"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a correction needs a reason"
    stands_out = True
    undoable = True
    subject: int
    condition: Condition
    reason: str
    team: str = ""
    run_number: int = 0

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """A wrong team that is seen in the run is corrected after it."""
        if situation.run.active:
            return "let the run end, then correct it"
        return super(Correct, cls).impossible(situation)

    def problem(self, situation: Situation) -> str | None:
        setup = situation.run.setup
        if setup is None:
            return NO_RUN
        if (self.subject, self.condition) == (setup.subject, setup.condition):
            return "that is what is set up"
        scored = None if situation.scored else RESULT_IS_WRITTEN
        return self._corrected(setup, 1).problem() or scored

    def numbered(self, number: int) -> Correct:
        return replace(self, run_number=number)

    def named(self, situation: Situation) -> Correct:
        return replace(self, team=situation.teams.names.get(self.subject, self.team))

    def _corrected(self, setup: RunSetup, number: int) -> RunSetup:
        pose = setup.start_pose
        if pose.side is not self.condition.starting_side:
            pose = pose.mirrored
        after = replace(setup, run_number=number, condition=self.condition, start_pose=pose)
        if self.subject == setup.subject:
            return after
        return replace(after, subject=self.subject, team=self.team, team_reason="")

    def apply(self, situation: Situation, at: float) -> Run:
        run = changed(self.opened_again(situation.run, at), at)
        setup = run.setup
        if setup is None:
            raise ValueError(NO_RUN)
        corrected = self._corrected(setup, self.run_number)
        words = corrected_words(setup, corrected)
        correction = Correction(at, self.reason, run.referee, words, setup)
        return replace(
            run,
            decided=run.decided_and(DecisionKind.CORRECTION),
            setup=corrected,
            corrections=(*run.corrections, correction),
        )

    @property
    def done_text(self) -> str:
        number = f", run {self.run_number}" if self.run_number else ""
        return f"corrected to subject {self.subject}, condition {self.condition.number}{number}"

    @property
    def logged(self) -> str:
        return self.done_text


def corrected_words(before: RunSetup, after: RunSetup) -> str:
    """What a correction changed: `starting side from CCW to CW`."""
    return ", ".join(_changes(before, after)) or "set-up"


def _changes(before: RunSetup, after: RunSetup) -> Iterator[str]:
    if before.subject != after.subject:
        yield f"subject from {before.subject} to {after.subject}"
    old, new = before.condition, after.condition
    if old.opening_side is not new.opening_side:
        yield f"opening side from {old.opening_side.upper()} to {new.opening_side.upper()}"
    if old.starting_side is not new.starting_side:
        yield f"starting side from {old.starting_side.upper()} to {new.starting_side.upper()}"
    if old.benchmark_type is not new.benchmark_type:
        yield f"benchmark type from {old.benchmark_type} to {new.benchmark_type}"


NOTHING_TO_TAKE_BACK = "there is nothing to take back"
_FINAL = "the result is final: re-issue it first"
_OF_A_FINAL_RESULT = (DecisionKind.VOID, DecisionKind.CORRECTION, DecisionKind.PROTEST)
_CHANGES = (DecisionKind.RULING, DecisionKind.VOID, DecisionKind.CORRECTION)


@dataclass(frozen=True, slots=True)
class Decision:
    """The last decision of its kind, made at `time` (s since the epoch)."""

    kind: DecisionKind
    time: float
    words: str


def last_decision(run: Run) -> Decision | None:
    last = next((kind for kind in reversed(run.decided) if _within_reach(kind, run)), None)
    return None if last is None else _last_of(last, run)


@dataclass(frozen=True, slots=True)
class TakeBack(Act):
    """Take back the last decision of the referee (section 2).

    It names the decision: a later one is never taken back instead. A final result is opened again
    where its void, its correction or the decision on a protest is taken back; that protest is open
    again.
    """

    name = "take back"
    phases = tuple(phase for phase in Phase if phase is not Phase.IDLE)
    at_once = False
    missing = "taking back needs a reason"
    done = "{act.kind} taken back"
    log = "referee takes back the last {act.kind}"
    kind: DecisionKind
    made: float
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        run = situation.run
        if last_decision(run) is not None:
            return None
        return _FINAL if run.decided else NOTHING_TO_TAKE_BACK

    def problem(self, situation: Situation) -> str | None:
        """Refuses all but the last of its kind, and on a final result what does not concern it."""
        run = situation.run
        if self._standing(run) is None:
            return f"this {self.kind} is not the last one that stands"
        return None if _within_reach(self.kind, run) else _FINAL

    def apply(self, situation: Situation, at: float) -> Run:
        before = self.opened_again(situation.run, at)
        decision = self._standing(before)
        if decision is None:
            raise ValueError(f"no {self.kind} of that time stands")
        record = TakenBack(
            at, decision.kind, decision.time, decision.words, self.reason, before.referee
        )
        run = _without(before, self.kind)
        if self.kind in _CHANGES:
            run = changed(run, at)
        return replace(run, taken_back=(*run.taken_back, record))

    def _standing(self, run: Run) -> Decision | None:
        if self.kind not in run.decided:
            return None
        last = _last_of(self.kind, run)
        return last if last.time == self.made else None


def _last_of(kind: DecisionKind, run: Run) -> Decision:
    match kind:
        case DecisionKind.RULING:
            ruling = run.rulings[-1]
            words = f"step {ruling.step} {RULED[ruling.confirmed]} ({ruling.reason})"
            return Decision(kind, ruling.time, words)
        case DecisionKind.INCIDENT:
            mark = run.incidents[-1]
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
    """The protest that was decided last; withdrawals are the team's."""
    decided = [
        (protest, protest.answer)
        for protest in run.protests
        if protest.answer is not None and protest.answer.end is not ProtestEnd.WITHDRAWN
    ]
    return max(decided, key=lambda pair: (pair[1].time, pair[0].number))


def _without(run: Run, kind: DecisionKind) -> Run:
    left = run.decided_without(kind)
    match kind:
        case DecisionKind.RULING:
            return replace(run, decided=left, rulings=run.rulings[:-1])
        case DecisionKind.INCIDENT:
            return replace(run, decided=left, incidents=run.incidents[:-1])
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
    return run.phase is not Phase.FINAL or kind in _OF_A_FINAL_RESULT
