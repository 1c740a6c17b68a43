"""One run as the referee sees it: an immutable state and its transitions (protocol section 2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from madrob_console.referee.evidence import Evidence
from madrob_console.referee.protests import Protest
from madrob_console.referee.records import (
    AcceptedDoubts,
    Closure,
    Correction,
    DecisionKind,
    FalseStart,
    Incident,
    JournalMark,
    Note,
    Reissuing,
    TakenBack,
    TestbedFault,
    Voiding,
    Waiver,
)
from madrob_console.referee.run_setup import RunSetup
from scoring.procedure import Ruling
from scoring.protocol import Condition, Outcome
from scoring.rest import HandleRest
from scoring.result import Ending

VALID_OUTCOMES = (Outcome.COMPLETED, Outcome.TIMEOUT)
"""Such a run is valid, unless it was voided (protocol section 2)."""

"""Prefixes of remarks that follow from the referee's decisions."""


class Phase(StrEnum):
    """The states of a run."""

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
        handle_zero: N, subtracted before the touch threshold; kept from run to run.
        zero_samples: the samples behind it; None = never set.
        countdown_began: the beginning of the recording.
        start: planned during the countdown, actual afterwards.
        held: when a false start held the countdown; None = it is not held.
        robot_start: when the robot said that it set out; None = it has not said so.
        robot_words: what it said last of its end: it gave up, it is done.
        timeout_at: when the timeout came, while a running settle time delays the stop.
        corrections: of the set-up; `setup` includes them.
        decided: decisions that were not taken back, in order.
        unrecorded: scored messages that the recording lacks.
        record_lost: that its recording has lost what was set, and what stands for it; empty = it
            has not.
        evidence: what was recorded beside the testbed's topics; None = nothing was wanted.
        issue: number of the result's latest issue; 0 before the first.
        signed: when the result was signed first since its last change, even if it was reopened.
        changed: when a ruling, a correction, a void or a re-issue changed it last.
        signed_notes: the number of notes at the signing; later ones stand beside the result.
        ruleset: of the re-issue; None = that of `setup`.
    """

    phase: Phase = Phase.IDLE
    setup: RunSetup | None = None
    pose_confirmed: bool = False
    handle_zero: float = 0.0
    zero_samples: HandleRest | None = None
    waivers: tuple[Waiver, ...] = ()
    countdown_began: float | None = None
    start: float | None = None
    held: float | None = None
    robot_start: float | None = None
    robot_words: str | None = None
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
    record_lost: str = ""
    evidence: Evidence | None = None
    issue: int = 0
    reissues: tuple[Reissuing, ...] = ()
    closure: Closure | None = None
    signed: float | None = None
    changed: float | None = None
    signed_notes: int = 0
    ruleset: str | None = None
    journal: JournalMark | None = None

    @property
    def cleared(self) -> Run:
        """A new run that keeps only the handle zero."""
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
        return (*self.decided, kind)

    def decided_without(self, kind: DecisionKind) -> tuple[DecisionKind, ...]:
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
        """The set-up before any correction; the folder is named after it."""
        return self.corrections[0].before if self.corrections else self.setup

    def number_in(self, subject: int, condition: Condition) -> int | None:
        setups = [c.before for c in self.corrections] + ([self.setup] if self.setup else [])
        return next(
            (s.run_number for s in setups if (s.subject, s.condition) == (subject, condition)), None
        )

    @property
    def undecided_false_start(self) -> FalseStart | None:
        return next((f for f in self.false_starts if f.accepted is None), None)

    @property
    def referee(self) -> str:
        return self.setup.referee if self.setup else ""

    @property
    def team_reason(self) -> str:
        return "" if self.setup is None else self.setup.team_reason

    @property
    def practice(self) -> bool:
        return self.setup is not None and self.setup.practice

    @property
    def out_of_plan(self) -> bool:
        return self.setup is not None and self.setup.out_of_plan

    @property
    def active(self) -> bool:
        return self.phase in (Phase.COUNTDOWN, Phase.RUNNING)

    @property
    def fixed_start(self) -> float | None:
        """The start, planned or actual; None while the countdown is held, too."""
        return self.start if self.held is None else None

    @property
    def ending(self) -> Ending:
        """How the run ended; an interrupted one has no stop.

        A time at which the machine failed is no property of the robot.
        """
        if self.outcome is None:
            return Ending(Outcome.INTERRUPTED, "no stop is recorded: the run was cut off", None)
        interrupted = self.outcome is Outcome.INTERRUPTED
        return Ending(self.outcome, self.outcome_reason, None if interrupted else self.stop)

    @property
    def answered_at(self) -> float | None:
        """When the robot answered to the start; an answer after the stop is none."""
        late = self.stop is not None and (self.robot_start or 0.0) > self.stop
        return None if late else self.robot_start

    @property
    def answer(self) -> str:
        """What the robot said to the start, in words; empty when it said nothing."""
        if self.start is None or self.answered_at is None:
            return ""
        return f"the robot answered to the start {self.answered_at - self.start:.3f} s after it"


LEAST_PREROLL = 1.0
"""s of recording before the start, at least (protocol section 3)."""


def begin_countdown(run: Run, at: float) -> Run:
    """Begins the countdown at `at` (s since the epoch); the start lies at least 1 s later."""
    assert run.setup is not None
    return replace(
        run,
        phase=Phase.COUNTDOWN,
        countdown_began=at,
        start=at + max(run.setup.countdown, LEAST_PREROLL),
        held=None,
    )


def resume_countdown(run: Run, at: float) -> Run:
    """Lets a held countdown go on at `at`: the start lies as much later as it was held."""
    if run.held is None or run.start is None:
        return run
    return replace(run, start=run.start + max(0.0, at - run.held), held=None)


def begin_run(run: Run) -> Run:
    return replace(run, phase=Phase.RUNNING)


def note_fault(run: Run, fault: TestbedFault) -> Run:
    """Adds a fault; one that was noted before gets its newest words."""
    same = (fault.time, fault.kind)
    others = [other for other in run.faults if not fault.kind or (other.time, other.kind) != same]
    return replace(run, faults=(*others, fault))


def decide_false_starts(run: Run, reason: str) -> Run:
    decided = tuple(replace(f, accepted=f.accepted or reason) for f in run.false_starts)
    return replace(run, false_starts=decided)


def time_out(run: Run, at: float, reason: str) -> Run:
    """Notes a timeout at `at`, elapsed or declared (section 2)."""
    return replace(run, timeout_at=at, outcome_reason=reason)


def stop(run: Run, outcome: Outcome, at: float, reason: str) -> Run:
    """Ends the run at `at`; one whose countdown is held ends as long before its start."""
    return replace(
        resume_countdown(run, at),
        phase=Phase.STOPPED,
        outcome=outcome,
        stop=at,
        outcome_reason=reason,
        timeout_at=None,
    )


def changed(run: Run, at: float) -> Run:
    """Notes a change of the result; the time for protests begins anew."""
    return replace(run, changed=at, signed=None)


def reissued(
    run: Run, at: float, what: str, reason: str, referee: str, rules: str | None = None
) -> Run:
    """Gives the result another issue, open again; `rules` of None keep the present ones."""
    issue = max(1, run.issue) + 1
    return replace(
        run,
        phase=Phase.STOPPED,
        closure=None,
        issue=issue,
        reissues=(*run.reissues, Reissuing(at, issue, what, reason, referee, rules)),
        ruleset=rules or run.ruleset,
    )
