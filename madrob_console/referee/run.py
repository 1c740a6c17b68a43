"""One run as the referee sees it: an immutable state (protocol section 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from scoring.procedure import Ruling
from scoring.protocol import Condition, EventName, LockDetection, Outcome, StartPose
from scoring.result import Ending
from scoring.rulesets import RulesetName


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
    DOORWAY = "doorway clear"
    CLOCK = "clock skew"
    DISK = "disk space"
    RECORDER = "recorder"
    POSE = "start pose"


class IncidentKind(StrEnum):
    """Things that a referee marks; they change no indicator (section 7)."""

    HUMAN_INTERVENTION = "human intervention"
    COLLISION = "collision"
    FALL = "fall"
    OTHER = "other"


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
class Run:
    """The state of the run; acts and transitions return a new one.

    Times are s since the epoch, steady (section 8).

    Attributes:
        phase: where the run stands.
        setup: None before a run is set up.
        pose_confirmed: the referee saw the robot at its start pose.
        handle_zero: N, subtracted before the touch threshold; kept from run to run.
        waivers: checks let pass for this run.
        countdown_began: the opening of the recording.
        start: planned during the countdown, actual afterwards.
        stop: the end of the run.
        timeout_at: when the timeout came, while a running settle time delays the stop.
        outcome, outcome_reason: how and why it ended.
        false_starts, incidents, notes, rulings: what happened and what the referee said.
        faults: of the testbed while it was recorded, each once.
        issue: number of the result's latest issue; 0 before the first.
        closure: set by finalising.
    """

    phase: Phase = Phase.IDLE
    setup: RunSetup | None = None
    pose_confirmed: bool = False
    handle_zero: float = 0.0
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
    faults: tuple[TestbedFault, ...] = ()
    issue: int = 0
    closure: Closure | None = None

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

    def remarks(self) -> list[str]:
        """What the referee's decisions and the testbed's faults say about the data, in words."""
        remarks = [f"check waived: {w.check}: {w.reason}" for w in self.waivers]
        for mark in self.false_starts:
            decision = f"accepted: {mark.accepted}" if mark.accepted else "not decided"
            remarks.append(f"false start: {mark.event} ({decision})")
        for fault in self.faults:
            at = "" if self.start is None else f" at {fault.time - self.start:.1f} s"
            remarks.append(f"fault{at}: {fault.text}")
        return remarks


def relative_text(at: float | None, start: float | None) -> str:
    """A time since the start, s with three decimals, with one where it is long; `-` for none."""
    if at is None or start is None:
        return "-"
    return f"{at - start:.3f}" if abs(at - start) < 900 else f"{at - start:.1f}"
