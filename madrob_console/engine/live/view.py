"""Parts of a snapshot that are worked out from the state: clock, faults, questions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from madrob_console.engine.shown.snapshot import DoorView, LatchView, RecorderView, TopicView
from madrob_console.referee.health import Freshness
from madrob_console.referee.run import Phase, Run
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import LockDetection, Step

NO_STEPS = tuple(StepRecord(step, step.text) for step in Step)
"""The six steps before a run."""


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
