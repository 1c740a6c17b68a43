"""The referee's parts of `result.json`, as they are published: see `result_document`."""

from __future__ import annotations

import msgspec

from madrob_console.referee.run import CheckName, IncidentKind, TeamWord
from scoring.protocol import BenchmarkType, EventName, LockDetection, Side, Step
from scoring.rulesets import RulesetName


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the document."""


class Condition(Part, frozen=True):
    """What the robot had to do: one of 20 conditions (protocol section 1).

    Attributes:
        benchmark_type: how the door resists.
        opening_side: the side towards which the panel moves.
        starting_side: the side on which the robot starts.
    """

    benchmark_type: BenchmarkType
    opening_side: Side
    starting_side: Side


class StartPose(Part, frozen=True):
    """Where the robot stood at the start, in the frame `madrob_door` (protocol section 1).

    Attributes:
        x: towards the CCW side, m.
        y: along the wall, m.
        yaw: degrees.
    """

    x: float
    y: float
    yaw: float


class Setup(Part, frozen=True):
    """What was set for the run before its start.

    Attributes:
        subject: the robot's number, 1 to 999.
        team: the team's name.
        run_number: the repetition, 1 to 999.
        condition: what the robot had to do.
        start_pose: where it stood.
        referee: the referee's name.
        timeout: s from the start.
        countdown: s before the start.
        ruleset: the rules chosen for the run.
        lock_detection: what was to decide step 6 (protocol section 7).
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


class Ruling(Part, frozen=True):
    """The referee's word on a step (protocol section 7).

    Attributes:
        step: which of the six.
        confirmed: true = done, false = not done, null = withdrawn: the sensors count.
        time: when the referee said so, s since the epoch.
        reason: why.
        referee: the referee's name.
    """

    step: Step
    confirmed: bool | None
    time: float
    reason: str
    referee: str


class Waiver(Part, frozen=True):
    """A failing pre-start check that the referee let pass.

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


class FalseStart(Part, frozen=True):
    """Touch, opening or approach during the countdown (protocol section 7).

    Attributes:
        time: s since the epoch.
        event: what happened.
        accepted: the referee's reason for letting it pass; null = not decided.
    """

    time: float
    event: EventName
    accepted: str | None


class Incident(Part, frozen=True):
    """A mark of the referee; it changes no indicator (protocol section 7).

    Attributes:
        time: s since the epoch.
        kind: what happened.
        note: of the referee.
        withdrawn: why it was taken back; null = it stands.
    """

    time: float
    kind: IncidentKind
    note: str
    withdrawn: str | None


class Note(Part, frozen=True):
    """A note of the referee.

    Attributes:
        time: s since the epoch.
        text: as it was written.
    """

    time: float
    text: str


class Closure(Part, frozen=True):
    """How the result was finalised.

    Attributes:
        time: s since the epoch.
        referee: the referee's name.
        team_word: what the team says of the result.
        note: of the team or the referee.
    """

    time: float
    referee: str
    team_word: TeamWord
    note: str
