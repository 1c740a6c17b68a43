"""Acts during and after a run: abort, timeout, incidents, rulings, notes, void."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import (
    LONGEST_TEXT,
    Act,
    Consequence,
    Situation,
)
from madrob_console.referee.records import DecisionKind, Incident, IncidentKind, Note, Voiding
from madrob_console.referee.run import (
    Phase,
    Run,
    begin_countdown,
    changed,
    decide_false_starts,
    resume_countdown,
    stop,
    time_out,
)
from scoring.procedure import Ruling
from scoring.protocol import Outcome, Step


@dataclass(frozen=True, slots=True)
class AcceptFalseStart(Act):
    """Accept the false starts so far, with a reason; a held countdown goes on."""

    name = "accept the false start"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    missing = "accepting a false start needs a reason"
    done = "false start accepted"
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        undecided = situation.run.undecided_false_start
        return "there is no false start to accept" if undecided is None else None

    def apply(self, situation: Situation, at: float) -> Run:
        return resume_countdown(decide_false_starts(situation.run, self.reason), at)


@dataclass(frozen=True, slots=True)
class AddNote(Act):
    """Write a note beside the run."""

    name = "note"
    phases = tuple(phase for phase in Phase if phase is not Phase.IDLE)
    missing = "the note is empty"
    done = "note written"
    note: str

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        return replace(run, notes=(*run.notes, Note(at, self.note)))


@dataclass(frozen=True, slots=True)
class DeclareTimeout(Act):
    """The robot gave up: a valid timeout at this instant (section 8)."""

    name = "declare timeout"
    phases = (Phase.RUNNING,)
    done = "timeout declared"
    urgent = True
    reason: str = ""

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if situation.run.timeout_at is None:
            return None
        return "the timeout is already there; a settle time is being waited for"

    def apply(self, situation: Situation, at: float) -> Run:
        """A running settle time may still complete the run."""
        return time_out(situation.run, at, self.reason or "declared by the referee")


_LATEST = 86_400.0
"""s from the start; later events cannot concern the run."""


@dataclass(frozen=True, slots=True)
class MarkIncident(Act):
    """Mark an incident now, or `after_start` s from the start (section 7)."""

    undoable = True
    name = "mark an incident"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    done = "incident marked: {act.kind}{act.when}"
    log = "incident: {act.kind}{act.when}"
    stands_out = True
    kind: IncidentKind
    note: str = ""
    after_start: float | None = None

    def problem(self, situation: Situation) -> str | None:
        """The time must not be before the recording."""
        run, after = situation.run, self.after_start
        if after is None or run.start is None:
            return None
        began = (run.countdown_began or run.start) - run.start
        if began <= after < _LATEST:
            return None
        return f"{after:g} s from the start: the recording began at {began:.1f} s"

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        if self.after_start is not None and run.start is not None:
            at = run.start + self.after_start
        mark = Incident(at, self.kind, self.note)
        return replace(
            run, decided=run.decided_and(DecisionKind.INCIDENT), incidents=(*run.incidents, mark)
        )

    @property
    def when(self) -> str:
        return "" if self.after_start is None else f" at {self.after_start:+.2f} s"


@dataclass(frozen=True, slots=True)
class RestartCountdown(Act):
    """Begin the countdown again after a false start."""

    name = "restart the countdown"
    phases = (Phase.COUNTDOWN,)
    done = "the countdown begins again"
    at_once = False
    consequences = Consequence.COUNTDOWN
    reason: str = "false start"

    def apply(self, situation: Situation, at: float) -> Run:
        """Plans a new start; earlier false starts count as decided by the restart."""
        return begin_countdown(decide_false_starts(situation.run, "countdown restarted"), at)


RULED = {True: "confirmed", False: "denied", None: "as the sensors say"}

_LOGGED = {True: "confirms", False: "denies", None: "takes back the ruling on"}


@dataclass(frozen=True, slots=True)
class Rule(Act):
    """Confirm or deny a step (section 7), or take that back. The latest ruling counts."""

    undoable = True
    name = "rule on a step"
    phases = (Phase.RUNNING, Phase.STOPPED)
    missing = "a ruling needs a reason"
    step: Step
    confirmed: bool | None
    reason: str

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        ruling = Ruling(self.step, self.confirmed, at, self.reason, run.referee)
        decided = run.decided_and(DecisionKind.RULING)
        return changed(replace(run, decided=decided, rulings=(*run.rulings, ruling)), at)

    @property
    def done_text(self) -> str:
        return f"step {self.step} {RULED[self.confirmed]}"

    @property
    def logged(self) -> str:
        return f"referee {_LOGGED[self.confirmed]} step {self.step}"


@dataclass(frozen=True, slots=True)
class Void(Act):
    """The run stays on record with its indicators and counts nowhere (section 2).

    A final result is opened again: the next issue gets a number, the old one stays.
    """

    name = "void"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "voiding a run needs a reason"
    done = "the run is void, it does not count"
    log = "run voided"
    stands_out = True
    undoable = True
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if situation.run.voided is not None:
            return "the run is void already: that can be taken back"
        return None

    def apply(self, situation: Situation, at: float) -> Run:
        run = changed(self.opened_again(situation.run, at), at)
        voided = Voiding(at, self.reason, run.referee)
        return replace(run, decided=run.decided_and(DecisionKind.VOID), voided=voided)


@dataclass(frozen=True, slots=True)
class Abort(Act):
    """Interrupt the run: it is invalid (section 2). Wins over everything."""

    name = "abort"
    phases = (Phase.COUNTDOWN, Phase.RUNNING)
    done = "the run is aborted"
    urgent = True
    at_once = True  # before its line is on disk
    reason: str = ""

    def __post_init__(self) -> None:
        """Cuts a long reason: nothing refuses an abort."""
        object.__setattr__(self, "reason", self.reason[:LONGEST_TEXT])

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """A run that is over can be voided instead, if it counts."""
        refused = super(Abort, cls).impossible(situation)
        if refused is not None and situation.run.valid and Void.impossible(situation) is None:
            return f"{refused}: void it instead"
        return refused

    def apply(self, situation: Situation, at: float) -> Run:
        return stop(situation.run, Outcome.ABORTED, at, self.reason or "aborted by the referee")
