"""What a referee can do: small frozen classes with `refusal` and `apply`.

`refusal` says in words why an act is not possible now (the screens show it beside a dim
key); `apply` gives the new state. Acts are plain data and can cross a socket.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

from madrob_console.referee.preflight import Check, blocking
from madrob_console.referee.run import (
    CheckName,
    Closure,
    Incident,
    IncidentKind,
    Note,
    Phase,
    Run,
    RunSetup,
    TeamWord,
    Waiver,
)
from madrob_console.referee.transitions import (
    begin_countdown,
    decide_false_starts,
    stop,
    time_out,
)
from scoring.procedure import Ruling
from scoring.protocol import Outcome, Step


@dataclass(frozen=True, slots=True)
class Situation:
    """What an act is judged against.

    Attributes:
        run: the state of the run.
        checks: the pre-start checks as they stand.
        handle_mean: mean handle force of the last second, N; None = no data.
        scored: whether the run's result is written.
    """

    run: Run
    checks: tuple[Check, ...] = ()
    handle_mean: float | None = None
    scored: bool = False


class Act(ABC):
    """One act of the referee."""

    __slots__ = ()
    name: ClassVar[str]

    @abstractmethod
    def refusal(self, situation: Situation) -> str | None:
        """Why the act is not possible now, in words; None when it is."""

    @abstractmethod
    def apply(self, situation: Situation, at: float) -> Run:
        """The state after the act, done at time `at` (s since the epoch)."""

    @property
    def reason_given(self) -> str:
        """The reason or note that the referee gave, for the journal."""
        return str(getattr(self, "reason", getattr(self, "note", "")))


def _needs(situation: Situation, *phases: Phase) -> str | None:
    phase = situation.run.phase
    if phase in phases:
        return None
    return _WHY_NOT[phase]


_WHY_NOT = {
    Phase.IDLE: "no run is set up yet",
    Phase.READY: "the run has not started",
    Phase.COUNTDOWN: "the countdown is running",
    Phase.RUNNING: "a run is going on",
    Phase.STOPPED: "the run has stopped",
    Phase.FINAL: "the result is final",
}


def _referee(run: Run) -> str:
    return run.setup.referee if run.setup else ""


@dataclass(frozen=True, slots=True)
class SetUp(Act):
    """Set up the next run."""

    name: ClassVar[str] = "set up"
    setup: RunSetup

    def refusal(self, situation: Situation) -> str | None:
        """Refused from the countdown until the result is written, and for a bad set-up."""
        run = situation.run
        if run.active:
            return _WHY_NOT[run.phase]
        if run.phase is Phase.STOPPED and not situation.scored:
            return "the result of the last run is being written"
        return self.setup.problem()

    def apply(self, situation: Situation, at: float) -> Run:
        """A clean run: nothing of the one before stays but the handle zero."""
        return Run(Phase.READY, self.setup, handle_zero=situation.run.handle_zero)


@dataclass(frozen=True, slots=True)
class ConfirmPose(Act):
    """The referee saw the robot standing at its start pose."""

    name: ClassVar[str] = "confirm the start pose"

    def refusal(self, situation: Situation) -> str | None:
        """Only before the countdown."""
        return _needs(situation, Phase.READY)

    def apply(self, situation: Situation, at: float) -> Run:
        """The pose is confirmed."""
        return replace(situation.run, pose_confirmed=True)


@dataclass(frozen=True, slots=True)
class ZeroHandle(Act):
    """Take the mean handle force of the last second as zero (section 4)."""

    name: ClassVar[str] = "zero the handle"

    def refusal(self, situation: Situation) -> str | None:
        """Only before the countdown and with fresh handle data."""
        if refused := _needs(situation, Phase.IDLE, Phase.READY, Phase.FINAL):
            return refused
        return "no fresh handle force" if situation.handle_mean is None else None

    def apply(self, situation: Situation, at: float) -> Run:
        """The handle zero is the mean."""
        assert situation.handle_mean is not None
        return replace(situation.run, handle_zero=situation.handle_mean)


@dataclass(frozen=True, slots=True)
class Waive(Act):
    """Let a failed check pass for this run."""

    name: ClassVar[str] = "waive a check"
    check: CheckName
    reason: str

    def refusal(self, situation: Situation) -> str | None:
        """Only before the countdown, for a check that fails, with a reason."""
        if refused := _needs(situation, Phase.READY):
            return refused
        failing = [check.name for check in blocking(situation.checks)]
        if self.check not in failing:
            return f"the check '{self.check}' does not fail" if failing else "no check fails"
        return None if self.reason.strip() else "a waiver needs a reason"

    def apply(self, situation: Situation, at: float) -> Run:
        """One more waiver."""
        run = situation.run
        waiver = Waiver(self.check, self.reason, _referee(run), at)
        return replace(run, waivers=(*run.waivers, waiver))


@dataclass(frozen=True, slots=True)
class Start(Act):
    """Open the recording and begin the countdown."""

    name: ClassVar[str] = "start"

    def refusal(self, situation: Situation) -> str | None:
        """Every check must be ok or waived."""
        if refused := _needs(situation, Phase.READY):
            return refused
        blocks = blocking(situation.checks)
        if not blocks:
            return None
        more = f" (and {len(blocks) - 1} more)" if len(blocks) > 1 else ""
        return f"{blocks[0].name}: {blocks[0].reason}{more}"

    def apply(self, situation: Situation, at: float) -> Run:
        """The countdown runs; the start is planned."""
        return begin_countdown(situation.run, at)


@dataclass(frozen=True, slots=True)
class RestartCountdown(Act):
    """Begin the countdown again after a false start."""

    name: ClassVar[str] = "restart the countdown"
    reason: str = "false start"

    def refusal(self, situation: Situation) -> str | None:
        """Only during the countdown."""
        return _needs(situation, Phase.COUNTDOWN)

    def apply(self, situation: Situation, at: float) -> Run:
        """A new planned start; earlier false starts count as decided by the restart."""
        run = situation.run
        decided = tuple(
            replace(f, accepted=f.accepted or "countdown restarted") for f in run.false_starts
        )
        return begin_countdown(replace(run, false_starts=decided), at)


@dataclass(frozen=True, slots=True)
class AcceptFalseStart(Act):
    """Let the false starts found so far pass, with a reason."""

    name: ClassVar[str] = "accept the false start"
    reason: str

    def refusal(self, situation: Situation) -> str | None:
        """Needs an undecided false start and a reason."""
        if refused := _needs(situation, Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED):
            return refused
        if situation.run.undecided_false_start is None:
            return "there is no false start to accept"
        return None if self.reason.strip() else "accepting a false start needs a reason"

    def apply(self, situation: Situation, at: float) -> Run:
        """All undecided false starts are accepted."""
        return decide_false_starts(situation.run, self.reason)


@dataclass(frozen=True, slots=True)
class Abort(Act):
    """Interrupt the run: it is invalid (section 2). Wins over everything."""

    name: ClassVar[str] = "abort"
    reason: str = ""

    def refusal(self, situation: Situation) -> str | None:
        """Only while a countdown or a run goes on."""
        return _needs(situation, Phase.COUNTDOWN, Phase.RUNNING)

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped, invalid."""
        return stop(situation.run, Outcome.ABORTED, at, self.reason or "aborted by the referee")


@dataclass(frozen=True, slots=True)
class DeclareTimeout(Act):
    """The robot gave up: a valid timeout at this instant (section 8)."""

    name: ClassVar[str] = "declare timeout"
    reason: str = ""

    def refusal(self, situation: Situation) -> str | None:
        """Only while the run goes on, once."""
        if situation.run.timeout_at is not None:
            return "the timeout is already there; a settle time is being waited for"
        return _needs(situation, Phase.RUNNING)

    def apply(self, situation: Situation, at: float) -> Run:
        """The timeout is there; a settle time that is running may still complete the run."""
        return time_out(situation.run, at, self.reason or "declared by the referee")


@dataclass(frozen=True, slots=True)
class Rule(Act):
    """Confirm or deny a step (section 7), or take that back. The latest ruling counts."""

    name: ClassVar[str] = "rule on a step"
    step: Step
    confirmed: bool | None
    reason: str

    def refusal(self, situation: Situation) -> str | None:
        """From the start until the result is final, with a reason."""
        if refused := _needs(situation, Phase.RUNNING, Phase.STOPPED):
            return refused
        return None if self.reason.strip() else "a ruling needs a reason"

    def apply(self, situation: Situation, at: float) -> Run:
        """One more ruling."""
        run = situation.run
        ruling = Ruling(self.step, self.confirmed, at, self.reason, _referee(run))
        return replace(run, rulings=(*run.rulings, ruling))


@dataclass(frozen=True, slots=True)
class MarkIncident(Act):
    """Mark an incident at this instant (section 7)."""

    name: ClassVar[str] = "mark an incident"
    kind: IncidentKind
    note: str = ""

    def refusal(self, situation: Situation) -> str | None:
        """From the countdown until the result is final."""
        return _needs(situation, Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)

    def apply(self, situation: Situation, at: float) -> Run:
        """One more incident."""
        run = situation.run
        return replace(run, incidents=(*run.incidents, Incident(at, self.kind, self.note)))


@dataclass(frozen=True, slots=True)
class WithdrawIncident(Act):
    """Take back the last incident: it stays on record as withdrawn."""

    name: ClassVar[str] = "withdraw an incident"
    reason: str

    def refusal(self, situation: Situation) -> str | None:
        """Needs an incident, a reason, and a result that is not final."""
        if refused := _needs(situation, Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED):
            return refused
        if situation.run.last_incident is None:
            return "there is no incident to withdraw"
        return None if self.reason.strip() else "withdrawing an incident needs a reason"

    def apply(self, situation: Situation, at: float) -> Run:
        """The last incident that stands is withdrawn."""
        run = situation.run
        withdrawn = tuple(
            replace(mark, withdrawn=self.reason) if mark is run.last_incident else mark
            for mark in run.incidents
        )
        return replace(run, incidents=withdrawn)


@dataclass(frozen=True, slots=True)
class AddNote(Act):
    """Write a note beside the run."""

    name: ClassVar[str] = "note"
    note: str

    def refusal(self, situation: Situation) -> str | None:
        """Once a run is set up."""
        if situation.run.phase is Phase.IDLE:
            return _WHY_NOT[Phase.IDLE]
        return None if self.note.strip() else "the note is empty"

    def apply(self, situation: Situation, at: float) -> Run:
        """One more note."""
        run = situation.run
        return replace(run, notes=(*run.notes, Note(at, self.note)))


@dataclass(frozen=True, slots=True)
class Finalise(Act):
    """Close the result, with the team's word."""

    name: ClassVar[str] = "finalise"
    team_word: TeamWord
    referee: str
    note: str = ""

    def refusal(self, situation: Situation) -> str | None:
        """Once the result is written; the referee signs."""
        if refused := _needs(situation, Phase.STOPPED):
            return refused
        if not situation.scored:
            return "the result is being written"
        return None if self.referee.strip() else "finalising needs the referee's name"

    def apply(self, situation: Situation, at: float) -> Run:
        """The result is final."""
        closure = Closure(at, self.referee, self.team_word, self.note)
        return replace(situation.run, phase=Phase.FINAL, closure=closure)


@dataclass(frozen=True, slots=True)
class Reissue(Act):
    """Open a final result again; the next issue gets a new number, the old one stays."""

    name: ClassVar[str] = "re-issue"
    reason: str

    def refusal(self, situation: Situation) -> str | None:
        """Only a final result, with a reason."""
        if situation.run.phase is not Phase.FINAL:
            return "only a final result is re-issued"
        return None if self.reason.strip() else "a re-issue needs a reason"

    def apply(self, situation: Situation, at: float) -> Run:
        """Stopped again: rulings are possible until it is finalised once more."""
        run = situation.run
        return replace(run, phase=Phase.STOPPED, closure=None, issue=run.issue + 1)


ACTS: tuple[type[Act], ...] = (
    SetUp,
    ConfirmPose,
    ZeroHandle,
    Waive,
    Start,
    RestartCountdown,
    AcceptFalseStart,
    Abort,
    DeclareTimeout,
    Rule,
    MarkIncident,
    WithdrawIncident,
    AddNote,
    Finalise,
    Reissue,
)
"""All acts."""
