"""One run as the referee sees it: an immutable state (protocol section 2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from madrob_console.referee.evidence_account import EvidenceAccount
from madrob_console.referee.protests import Protest
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.protocol import Condition, EventName, LockDetection, Outcome, StartPose
from scoring.rest import HandleRest
from scoring.result import Ending
from scoring.rulesets import RulesetName

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A digest as `sha256sum` prints it."""

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


class CheckName(StrEnum):
    """The pre-start checks, in the order in which they are listed."""

    TOPICS = "topics"
    DOOR = "door closed"
    HANDLE = "handle at rest"
    HANDLE_ZERO = "handle zero"
    DOORWAY = "doorway clear"
    CLOCK = "clock skew"
    DISK = "disk space"
    RECORDER = "recorder"
    EVIDENCE = "evidence"
    REFEREE = "another referee"
    POSE = "start pose"


class IncidentKind(StrEnum):
    """Things that a referee marks; they change no indicator (section 7)."""

    HUMAN_INTERVENTION = "human intervention"
    COLLISION = "collision"
    FALL = "fall"
    OTHER = "other"


class DecisionKind(StrEnum):
    """What the referee decides of a run and can take back."""

    RULING = "ruling"
    INCIDENT = "incident"
    WAIVER = "waiver"
    VOID = "void"
    CORRECTION = "correction"
    DOUBTS = "accepted doubts"
    PROTEST = "decision on a protest"


class TeamWord(StrEnum):
    """What the team says of a final result."""

    ACKNOWLEDGED = "acknowledged"
    PROTESTED = "protested"
    ABSENT = "absent"


@dataclass(frozen=True, slots=True)
class RunSetup:
    """Everything set for a run before its start.

    Attributes:
        subject: the robot's number, 1 to 999.
        team: the team's name, cleaned.
        run_number: the repetition, 1 to 999.
        condition: what the robot has to do.
        start_pose: where the robot stands; on the starting side.
        referee: the referee's name, cleaned.
        timeout: s from the start.
        countdown: s before the start; the recording needs at least 1 s.
        ruleset: which rules make the indicators.
        lock_detection: what decides step 6 (protocol section 7).
        team_reason: why the team has another name than in the list of teams; empty = it has not.
        practice: it counts for nothing and stands apart from official runs (protocol section 2).
        out_of_plan: it was set up beyond the competition's plan.
        run_id: which run of all testbeds it is, a UUID; empty in runs of earlier versions. Set-ups
            that differ in nothing but this and `testbed` are equal.
        testbed: the name of the testbed; likewise.
    """

    subject: int
    team: str
    run_number: int
    condition: Condition
    start_pose: StartPose
    referee: str
    timeout: float
    countdown: float
    ruleset: RulesetName
    lock_detection: LockDetection
    team_reason: str = ""
    practice: bool = False
    out_of_plan: bool = False
    run_id: str = field(default="", compare=False)
    testbed: str = field(default="", compare=False)

    def problem(self) -> str | None:
        """Why a run cannot be set up like this, naming the field; None when it can."""
        if not 1 <= self.subject <= 999:
            return f"subject {self.subject}: use a number from 1 to 999"
        if not 1 <= self.run_number <= 999:
            return f"run number {self.run_number}: use a number from 1 to 999"
        pose = self.start_pose
        if not all(math.isfinite(value) for value in (pose.x, pose.y, pose.yaw)):
            return "start pose: x, y and yaw must be numbers"
        side = pose.side
        if side is not self.condition.starting_side:
            where = "on the threshold" if side is None else f"on the {side.upper()} side"
            wanted = self.condition.starting_side
            sign = "x > 0" if wanted.sign > 0 else "x < 0"
            return f"start pose lies {where}: it must lie on the {wanted.upper()} side ({sign})"
        if not 1.0 <= self.timeout <= 86400.0:
            return f"timeout {self.timeout:g} s: use 1 to 86400 s"
        if not 0.0 <= self.countdown <= 600.0:
            return f"countdown {self.countdown:g} s: use 0 to 600 s"
        return None


@dataclass(frozen=True, slots=True)
class Waiver:
    """A failing pre-start check that the referee let pass for this run.

    Attributes:
        check: which.
        reason: why.
        referee: the referee's name.
        time: s since the epoch.
    """

    check: CheckName
    reason: str
    referee: str
    time: float


@dataclass(frozen=True, slots=True)
class FalseStart:
    """Touch, opening or approach during the countdown (protocol section 7).

    Attributes:
        time: s since the epoch.
        event: what happened.
        accepted: the referee's reason for letting it pass; null = not decided.
    """

    time: float
    event: EventName
    accepted: str | None = None


@dataclass(frozen=True, slots=True)
class Incident:
    """A mark of the referee; it changes no indicator (protocol section 7).

    Attributes:
        time: s since the epoch.
        kind: what happened.
        note: of the referee.
        withdrawn: why it was taken back; null = it stands.
    """

    time: float
    kind: IncidentKind
    note: str = ""
    withdrawn: str | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """A note of the referee.

    Attributes:
        time: s since the epoch.
        text: as it was written.
    """

    time: float
    text: str


@dataclass(frozen=True, slots=True)
class TestbedFault:
    """Something wrong with the testbed while the run was recorded, in words, with its time."""

    time: float
    text: str


@dataclass(frozen=True, slots=True)
class Closure:
    """How a result was finalised.

    Attributes:
        time: s since the epoch.
        referee: the referee's name.
        team_word: what the team says of the result.
        note: of the team or the referee.
    """

    time: float
    referee: str
    team_word: TeamWord
    note: str = ""


@dataclass(frozen=True, slots=True)
class Voiding:
    """The referee says that a valid run counts nowhere (protocol section 2).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
    """

    time: float
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Correction:
    """What was set up wrongly was put right after the stop (protocol section 2).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
        words: what was corrected.
        before: what was set until then; the folder is named after the first.
    """

    time: float
    reason: str
    referee: str
    words: str
    before: RunSetup


@dataclass(frozen=True, slots=True)
class AcceptedDoubts:
    """What is doubted of a result, and the referee lets stand (protocol section 11).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
        doubts: the sentences, by indicator; others that come with a later issue are not among them.
    """

    time: float
    reason: str
    referee: str
    doubts: dict[IndicatorName, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class TakenBack:
    """A decision that the referee took back: it counts no more and stays on record.

    Attributes:
        time: s since the epoch.
        kind: what it was.
        made: when it was made, s since the epoch.
        words: what it said.
        reason: why it was taken back.
        referee: the referee's name.
    """

    time: float
    kind: DecisionKind
    made: float
    words: str
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Reissuing:
    """Why a result was issued again; the issue before stays (protocol section 2).

    Attributes:
        time: s since the epoch.
        issue: number of the issue that came of it.
        what: which act did it, or the rule change, in the journal's word.
        reason: why, in the words of who did it; of a protest, what the team says.
        referee: the referee's name; empty where none is known.
        ruleset: by which rules the result is made from then on; null = as before.
    """

    time: float
    issue: int
    what: str
    reason: str
    referee: str
    ruleset: RulesetName | None = None


@dataclass(frozen=True, slots=True)
class RemovedEvidence:
    """Evidence of the run that was removed to make room; no score hangs on it.

    Attributes:
        time: s since the epoch.
        files: how many.
        bytes: their size.
    """

    time: float
    files: int
    bytes: int

    @property
    def words(self) -> str:
        """How much it was."""
        return f"{self.files} file{'' if self.files == 1 else 's'}, {self.bytes / 1e6:.1f} MB"


@dataclass(frozen=True, slots=True)
class JournalMark:
    """The lines of a run's journal that its result depends on.

    Those are its acts and changes; not events, which the recording has, not what was withdrawn, and
    not what was said beside a final result.

    Attributes:
        lines: how many there are.
        sha256: of them one after the other, each with its line end.
    """

    lines: int
    sha256: Sha256


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


def relative_text(at: float | None, start: float | None) -> str:
    """A time since the start, s with three decimals, with one where it is long; `-` for none."""
    if at is None or start is None:
        return "-"
    return f"{at - start:.3f}" if abs(at - start) < 900 else f"{at - start:.1f}"


def seconds_of(text: str) -> float | None:
    """Seconds that somebody typed: `12.5`, `6.5 s`, `-3`, `1:05.2`; None for anything else."""
    minutes, colon, rest = text.strip().removesuffix("s").rpartition(":")
    sign = -1.0 if minutes.startswith("-") else 1.0
    try:
        whole = abs(int(minutes)) if colon else 0
        typed = sign * (60.0 * whole + float(rest))
    except (ValueError, OverflowError):
        return None
    return typed if math.isfinite(typed) else None
