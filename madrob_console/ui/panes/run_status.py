"""Where the run stands, in words, beside the clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import OUTCOMES, PHASES, minutes_text
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.WARN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
}


class RunStatus(View):
    """Phase or outcome with the time left, who, and in which condition."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows."""
        return [
            line(phase_span(snapshot.run), *_time_left(snapshot)),
            line(who_text(snapshot.run)),
            line(Span(_condition(snapshot.run), Tone.DIM)),
        ]


def phase_span(run: Run) -> Span:
    """The phase in words; the outcome once there is one."""
    if run.outcome is not None:
        return Span(OUTCOMES[run.outcome].partition(":")[0], TONES[run.outcome])
    tone = Tone.GOOD if run.phase is Phase.RUNNING else Tone.STRONG
    return Span(PHASES[run.phase], Tone.WARN if run.phase is Phase.COUNTDOWN else tone)


def who_text(run: Run) -> str:
    """Subject, team and run number."""
    if run.setup is None:
        return "F2 sets up a run"
    team = f" {run.setup.team}" if run.setup.team else ""
    return f"run {run.setup.run_number} of subject {run.setup.subject}{team}"


def what_text(run: Run) -> str:
    """The same, and what the robot has to do."""
    if run.setup is None:
        return who_text(run)
    condition = run.setup.condition
    what = f"condition {condition.number}: {condition.benchmark_type}, {condition.way}"
    return f"{who_text(run)}, {what}"


def _time_left(snapshot: Snapshot) -> Line:
    run = snapshot.run
    if run.outcome is not None:
        return line(f"  {run.outcome_reason}")
    if snapshot.remaining is None:
        return ()
    if run.phase is Phase.COUNTDOWN:
        return line(f"  starts in {minutes_text(snapshot.remaining)}")
    of = f" of {minutes_text(run.setup.timeout)}" if run.setup else ""
    return line(f"  {minutes_text(snapshot.remaining)} left{of}")


def _condition(run: Run) -> str:
    if run.setup is None:
        return ""
    condition = run.setup.condition
    return f"condition {condition.number}: {condition.way}, {condition.benchmark_type}"
