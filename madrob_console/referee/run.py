"""One run as the referee sees it: an immutable state and its transitions (protocol section 2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from madrob_console.referee.evidence_account import EvidenceAccount
from madrob_console.referee.records import (
    AcceptedDoubts,
    Closure,
    Correction,
    DecisionKind,
    FalseStart,
    Incident,
    JournalMark,
    Note,
    Protest,
    Reissuing,
    RemovedEvidence,
    RunSetup,
    TakenBack,
    TestbedFault,
    Voiding,
    Waiver,
)
from scoring.procedure import Ruling
from scoring.protocol import Condition, Outcome
from scoring.rest import HandleRest
from scoring.result import Ending
from scoring.rulesets import RulesetName

VALID_OUTCOMES = (Outcome.COMPLETED, Outcome.TIMEOUT)
"""A run that ended so is valid, unless it was voided (protocol section 2)."""

DECISION_REMARKS = ("check waived: ", "false start: ")
"""How remarks on the data begin that follow from what the referee decided."""


class Phase(StrEnum):
    """Where a run stands."""

    IDLE = "idle"
    READY = "ready"
    COUNTDOWN = "countdown"
    RUNNING = "running"
    STOPPED = "stopped"
    FINAL = "final"


@dataclass(frozen=True, slots=True)
class Run:
    """The state of the run; acts and transitions return a new one.

    Times are s since the epoch, steady (section 8).

    Attributes:
        phase: where the run stands.
        setup: None before a run is set up.
        pose_confirmed: the referee saw the robot at its start pose.
        handle_zero: N, subtracted before the touch threshold; kept from run to run.
        zero_samples: the samples behind it; None = it was never set, or by an earlier version.
        waivers: checks let pass for this run.
        countdown_began: the opening of the recording.
        start: planned during the countdown, actual afterwards.
        stop: the end of the run.
        timeout_at: when the timeout came, while a running settle time delays the stop.
        outcome, outcome_reason: how and why it ended.
        false_starts, incidents, notes, rulings: what happened and what the referee said.
        voided: by the referee; None = it counts as its outcome says.
        corrections: of the set-up, which is as it is after them.
        accepted_doubts: which doubts on the indicators the referee lets stand.
        protests: of teams against the result, open and closed ones, in the order of their numbers.
        taken_back: what the referee decided and took back.
        decided: what was decided and stands, in the order in which it was.
        faults: of the testbed while it was recorded, each once.
        unrecorded: messages that were scored and that its recording lacks: the disk was full, too
            slow, or failed.
        evidence: what was recorded beside the testbed's topics; None = nothing was wanted.
        removed_evidence: what was removed of the cameras' and other topics' recordings.
        issue: number of the result's latest issue; 0 before the first.
        reissues: why there is more than one, oldest first.
        closure: set by finalising.
        signed: when the result was signed, s since the epoch: the first time since it changed, also
            while it is open again; None = never.
        changed: when a ruling, a correction, a void or a re-issue changed it last, likewise.
        signed_notes: how many of the notes were there when that was done; the others stand beside
            the result.
        signed_evidence: the `evidence` as it was told then; the files may say more since.
        ruleset: by which rules the result was re-issued; None = by those that were set.
        journal: what says all this, for its result; None while that is of no interest.
    """

    phase: Phase = Phase.IDLE
    setup: RunSetup | None = None
    pose_confirmed: bool = False
    handle_zero: float = 0.0
    zero_samples: HandleRest | None = None
    waivers: tuple[Waiver, ...] = ()
    countdown_began: float | None = None
    start: float | None = None
    stop: float | None = None
    timeout_at: float | None = None
    outcome: Outcome | None = None
    outcome_reason: str = ""
    false_starts: tuple[FalseStart, ...] = ()
    incidents: tuple[Incident, ...] = ()
    notes: tuple[Note, ...] = ()
    rulings: tuple[Ruling, ...] = ()
    voided: Voiding | None = None
    corrections: tuple[Correction, ...] = ()
    accepted_doubts: tuple[AcceptedDoubts, ...] = ()
    protests: tuple[Protest, ...] = ()
    taken_back: tuple[TakenBack, ...] = ()
    decided: tuple[DecisionKind, ...] = ()
    faults: tuple[TestbedFault, ...] = ()
    unrecorded: int = 0
    evidence: EvidenceAccount | None = None
    removed_evidence: tuple[RemovedEvidence, ...] = ()
    issue: int = 0
    reissues: tuple[Reissuing, ...] = ()
    closure: Closure | None = None
    signed: float | None = None
    changed: float | None = None
    signed_notes: int = 0
    signed_evidence: EvidenceAccount | None = None
    ruleset: RulesetName | None = None
    journal: JournalMark | None = None

    @property
    def cleared(self) -> Run:
        """A clean run: nothing of this one stays but the handle zero."""
        return Run(handle_zero=self.handle_zero, zero_samples=self.zero_samples)

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        return self.outcome in VALID_OUTCOMES and self.voided is None

    @property
    def comparable(self) -> bool:
        """Whether it is compared with other runs (protocol section 11)."""
        return self.valid and self.outcome is Outcome.COMPLETED

    def decided_and(self, kind: DecisionKind) -> tuple[DecisionKind, ...]:
        """What stands after one more decision."""
        return (*self.decided, kind)

    def decided_without(self, kind: DecisionKind) -> tuple[DecisionKind, ...]:
        """What stands without the last decision of a kind."""
        left = list(reversed(self.decided))
        if kind in left:
            left.remove(kind)
        return tuple(reversed(left))

    @property
    def unsigned(self) -> bool:
        """Whether it is over with a result that counts, or may count, and is not final."""
        void = self.outcome is Outcome.ABORTED or self.voided is not None
        return self.phase is Phase.STOPPED and not void

    @property
    def set_up_as(self) -> RunSetup | None:
        """What was set before any correction: the folder is named after it."""
        return self.corrections[0].before if self.corrections else self.setup

    def number_in(self, subject: int, condition: Condition) -> int | None:
        """The run number that the run has, or had before a correction, in a series."""
        known = [c.before for c in self.corrections] + ([self.setup] if self.setup else [])
        return next(
            (s.run_number for s in known if (s.subject, s.condition) == (subject, condition)), None
        )

    @property
    def undecided_false_start(self) -> FalseStart | None:
        """The first false start that the referee has not decided; None if there is none."""
        return next((f for f in self.false_starts if f.accepted is None), None)

    @property
    def last_incident(self) -> Incident | None:
        """The last incident that was not withdrawn; None if there is none."""
        return next((mark for mark in reversed(self.incidents) if mark.withdrawn is None), None)

    @property
    def referee(self) -> str:
        """The referee's name; empty where none was set."""
        return self.setup.referee if self.setup else ""

    @property
    def team_reason(self) -> str:
        """Why its team has another name than in the list; empty = it has not."""
        return "" if self.setup is None else self.setup.team_reason

    @property
    def practice(self) -> bool:
        """Whether it is set up as practice."""
        return self.setup is not None and self.setup.practice

    @property
    def out_of_plan(self) -> bool:
        """Whether it was set up beyond the competition's plan."""
        return self.setup is not None and self.setup.out_of_plan

    @property
    def active(self) -> bool:
        """Whether leaving now would leave a countdown or a run behind."""
        return self.phase in (Phase.COUNTDOWN, Phase.RUNNING)

    @property
    def ending(self) -> Ending:
        """How the run ended, for its result.

        An interrupted run has no stop: the time at which the machine failed says nothing about
        the robot. So does a run whose journal ends before its stop.
        """
        if self.outcome is None:
            return Ending(Outcome.INTERRUPTED, "no stop is recorded: the run was cut off", None)
        interrupted = self.outcome is Outcome.INTERRUPTED
        return Ending(self.outcome, self.outcome_reason, None if interrupted else self.stop)

    def evidence_removed(self, date: Callable[[float], str]) -> str:
        """When its evidence was removed, in words; empty = it was not.

        Args:
            date: a time in words, of s since the epoch.
        """
        if not self.removed_evidence:
            return ""
        return f"removed by tidy on {date(self.removed_evidence[-1].time)}"

    def remarks(self) -> list[str]:
        """What the referee's decisions and the testbed's faults say about the data, in words."""
        waived, false_start = DECISION_REMARKS
        remarks = [f"{waived}{w.check}: {w.reason}" for w in self.waivers]
        for mark in self.false_starts:
            decision = f"accepted: {mark.accepted}" if mark.accepted else "not decided"
            remarks.append(f"{false_start}{mark.event} ({decision})")
        for fault in self.faults:
            at = "" if self.start is None else f" at {fault.time - self.start:.1f} s"
            remarks.append(f"fault{at}: {fault.text}")
        return remarks


# Changes of a run that acts, sensors and the clock bring about (protocol section 2).


LEAST_PREROLL = 1.0
"""Recording begins at least this long before the start, s (protocol section 3)."""


def begin_countdown(run: Run, at: float) -> Run:
    """The countdown begins at `at` (s since the epoch); the start lies at least 1 s later."""
    assert run.setup is not None
    return replace(
        run,
        phase=Phase.COUNTDOWN,
        countdown_began=at,
        start=at + max(run.setup.countdown, LEAST_PREROLL),
    )


def begin_run(run: Run) -> Run:
    """The planned start has come."""
    return replace(run, phase=Phase.RUNNING)


def decide_false_starts(run: Run, reason: str) -> Run:
    """All undecided false starts are let pass with `reason`."""
    decided = tuple(replace(f, accepted=f.accepted or reason) for f in run.false_starts)
    return replace(run, false_starts=decided)


def time_out(run: Run, at: float, reason: str) -> Run:
    """The timeout came at `at`, elapsed or declared (section 2)."""
    return replace(run, timeout_at=at, outcome_reason=reason)


def stop(run: Run, outcome: Outcome, at: float, reason: str) -> Run:
    """The run ends at `at` (s since the epoch)."""
    return replace(
        run,
        phase=Phase.STOPPED,
        outcome=outcome,
        stop=at,
        outcome_reason=reason,
        timeout_at=None,
    )


def changed(run: Run, at: float) -> Run:
    """What the result says is another one since `at`: teams have all the time for a protest."""
    return replace(run, changed=at, signed=None)


def reissued(
    run: Run, at: float, what: str, reason: str, referee: str, rules: RulesetName | None = None
) -> Run:
    """The result gets another issue, final or not; it is open afterwards.

    Args:
        run: before it, and over.
        at: when, s since the epoch.
        what: the act or change that does it, in the journal's word.
        reason: why.
        referee: who says so; empty where no name is known.
        rules: by which its result is made from now on; None = by those that made it.
    """
    issue = max(1, run.issue) + 1
    return replace(
        run,
        phase=Phase.STOPPED,
        closure=None,
        issue=issue,
        reissues=(*run.reissues, Reissuing(at, issue, what, reason, referee, rules)),
        ruleset=rules or run.ruleset,
    )
