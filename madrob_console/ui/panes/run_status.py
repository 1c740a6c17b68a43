"""Where the run stands, in words, beside the clock."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.large_text import large_text, width_of_large
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import OUTCOMES, PHASES, minutes_text
from madrob_console.ui.panes.run_clock import clock_size
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.WARN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
}


_LARGE_TEAM = 3
"""From this size of the clock on there is room for the team in large letters."""


class RunStatus(View):
    """Phase or outcome with the time left, who, and in which condition.

    Where the clock is large, so is the phase, and then the team.
    """

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows, or as many as the larger letters need."""
        run, size = snapshot.run, clock_size(self.app.size)
        phase = phase_span(run)
        stands = line(phase, *_on_its_way(snapshot), *_time_left(snapshot))
        who, condition = line(who_text(run)), line(Span(_condition(run), Tone.DIM))
        if size == 1:
            return [stands, who, condition]
        large = partial(in_large, width=width, size=size // 2, ascii_only=self.ascii_only)
        team = Span(team_text(run) if size >= _LARGE_TEAM else "", Tone.STRONG)
        return [*large(phase), stands, *large(team), who, condition]


def in_large(span: Span, width: int, size: int, *, ascii_only: bool) -> list[Line]:
    """A text in the largest letters up to a size that fit; no row where none do."""
    while size and width_of_large(span.text, size) > width:
        size -= 1
    rows = large_text(span.text, size, ascii_only=ascii_only) if size else None
    return [line(Span(row, span.tone)) for row in rows or ()]


def phase_span(run: Run) -> Span:
    """The phase in words; the outcome once there is one."""
    if run.outcome is not None:
        return Span(OUTCOMES[run.outcome].partition(":")[0], TONES[run.outcome])
    tone = Tone.GOOD if run.phase is Phase.RUNNING else Tone.STRONG
    return Span(PHASES[run.phase], Tone.WARN if run.phase is Phase.COUNTDOWN else tone)


def team_text(run: Run) -> str:
    """Subject and team."""
    return "" if run.setup is None else f"{run.setup.subject} {run.setup.team}".rstrip()


def who_text(run: Run) -> str:
    """Subject, team and run number."""
    if run.setup is None:
        return "no run is set up"
    team = f" {run.setup.team}" if run.setup.team else ""
    kind = "practice run" if run.setup.practice else "run"
    return f"{kind} {run.setup.run_number} of subject {run.setup.subject}{team}"


def what_text(run: Run) -> str:
    """The same, and what the robot has to do."""
    if run.setup is None:
        return who_text(run)
    condition = run.setup.condition
    what = f"condition {condition.number}: {condition.benchmark_type}, {condition.way}"
    return f"{who_text(run)}, {what}"


def _on_its_way(snapshot: Snapshot) -> Line:
    """What has happened, but is not on disk yet."""
    return line(Span("  NOT ON DISK YET", Tone.WARN)) if snapshot.pulse.unsaved else ()


def _time_left(snapshot: Snapshot) -> Line:
    run, pulse = snapshot.run, snapshot.pulse
    if pulse.stale and run.active:
        age = max(pulse.server, pulse.core)
        return line(Span(f"  as it was {age} s ago" if age else "  as it was", Tone.WARN))
    if run.outcome is not None:
        ended = run.outcome_reason if snapshot.result is None else snapshot.result.ended
        return line(f"  {ended}")
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
