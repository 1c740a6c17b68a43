"""Parts of a snapshot that are worked out from the state: clock, refusals, faults, questions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from madrob_console.engine.shown.snapshot import DoorView, LatchView, RecorderView, TopicView
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Situation,
    Start,
    Waive,
    WithdrawIncident,
    ZeroHandle,
)
from madrob_console.referee.health import Freshness
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import CheckName, IncidentKind, Phase, Run, RunSetup, TeamWord
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose, Step

NO_STEPS = tuple(StepRecord(step, None, None, None) for step in Step)
"""The six steps before a run."""

_SAMPLE_SETUP = RunSetup(
    subject=1,
    team="",
    run_number=1,
    condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
    start_pose=StartPose(1.0, 0.0, 0.0),
)

_SAMPLE_ACTS: tuple[Act, ...] = (
    SetUp(_SAMPLE_SETUP),
    ConfirmPose(),
    ZeroHandle(),
    Start(),
    RestartCountdown(),
    AcceptFalseStart("given"),
    Abort(),
    DeclareTimeout(),
    Rule(Step.TOUCH, confirmed=True, reason="given"),
    MarkIncident(IncidentKind.OTHER),
    WithdrawIncident("given"),
    AddNote("given"),
    Finalise(TeamWord.ACKNOWLEDGED, "given"),
    Reissue("given"),
)
"""Acts that can be judged by their kind; reasons are asked for afterwards."""


def elapsed(run: Run, now: float) -> float | None:
    """Seconds since the start; negative in the countdown, frozen at the stop."""
    if run.start is None:
        return None
    return (now if run.stop is None else run.stop) - run.start


def remaining(run: Run, now: float) -> float | None:
    """Seconds to the timeout while running, to the start in the countdown."""
    if run.start is None or run.setup is None:
        return None
    if run.phase is Phase.COUNTDOWN:
        return max(0.0, run.start - now)
    if run.phase is Phase.RUNNING:
        return max(0.0, run.start + run.setup.timeout - now)
    return None


def refusals(situation: Situation) -> dict[str, str]:
    """Act name -> why it is not possible now."""
    failing = [check.name for check in blocking(situation.checks)]
    waive = Waive(failing[0] if failing else CheckName.TOPICS, "given")
    judged = ((act.name, act.refusal(situation)) for act in (*_SAMPLE_ACTS, waive))
    return {name: why for name, why in judged if why is not None}


def question(run: Run, procedure: Procedure | None, latch: LatchView) -> str | None:
    """What only the referee can answer now, in words."""
    if run.phase is not Phase.RUNNING or procedure is None:
        return None
    if procedure.lock_detection is LockDetection.SENSOR:
        if latch.freshness in (Freshness.LOST, Freshness.NEVER):
            return "the latch sensor is silent: confirm or deny steps 2 and 6"
        return None
    if procedure.lock_detection is LockDetection.REFEREE and Step.CLOSE in procedure.done:
        return "the door is closed: confirm step 6 once it is locked"
    return None


def faults(
    topics: Sequence[TopicView],
    recorder: RecorderView,
    door: DoorView,
    run: Run,
    others: Iterable[str | None],
) -> tuple[str, ...]:
    """What is wrong now, one line each."""
    found = [problem for problem in others if problem]
    if recorder.problem:
        found.append(f"recorder: {recorder.problem}")
    if recorder.dropped:
        found.append(f"recorder: {recorder.dropped} messages dropped")
    if run.setup is not None and door.angle is not None:
        against = -door.angle * run.setup.condition.opening_side.sign
        if against > door.closed_angle:
            found.append(f"panel at {door.angle:+.3f} rad, against the opening side")
    found += [f"{view.topic}: {view.problem}" for view in topics if view.problem]
    return tuple(found)
