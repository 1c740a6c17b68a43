"""Where the run stands: words, clock, the six steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from textual.geometry import Size

from madrob_console.common.formatting import relative_text
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.cells.lines import Line, Span, Target, Tone, View, line, width_of
from madrob_console.ui.look.words import (
    OUTCOMES,
    PHASES,
    clock_text,
    fitted,
    minutes_text,
    rough_text,
    wrapped,
)
from scoring.procedure import UNSETTLED, StepRecord
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from scoring.result import Result


_LARGEST_TIME = "-00:00"
"""What there is room for, whatever the time: nothing moves when a run goes on for long."""


class RunClock(View):
    """Minutes and seconds since the start, negative in the countdown; once stopped those it took.

    The tenths are a view of their own: they alone change ten times a second.
    """

    def get_content_width(self, container: Size, viewport: Size) -> int:
        return len(digit_rows(_LARGEST_TIME)[0]) + 1

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = clock_span(snapshot)
        return [line(Span(f"{row:>{width}}", tone)) for row in digit_rows(text[:-2])]


class Tenths(View):
    """In the same digits."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = clock_span(snapshot)
        return [line(Span(row, tone)) for row in digit_rows(text[-2:])]


def clock_span(snapshot: Snapshot) -> Span:
    """The clock in ordinary digits; `?` for the tenths of one that may have gone on unseen."""
    if snapshot.elapsed is None:
        return Span("-:--.-", Tone.STRONG)
    if snapshot.pulse.stale and snapshot.run.active:
        return Span(f"{clock_text(snapshot.elapsed)[:-1]}?", Tone.DIM)
    return Span(clock_text(snapshot.elapsed), Tone.WARN if snapshot.elapsed < 0 else Tone.STRONG)


TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.WARN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
}


class RunStatus(View):
    """Phase or outcome with the time left, who, and in which condition."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        run = snapshot.run
        phase = phase_span(run, snapshot.result)
        unsaved = Span("  NOT ON DISK YET" if snapshot.pulse.unsaved else "", Tone.WARN)
        stands = line(phase, unsaved, *_time_left(snapshot))
        return [stands, line(who_text(run)), line(Span(condition_text(run), Tone.DIM))]


def phase_span(run: Run, result: Result | None = None) -> Span:
    """The phase or the outcome; with the result, `ENDED` where not all steps of a run count."""
    if run.outcome is not None:
        word = OUTCOMES[run.outcome].partition(":")[0]
        lacks_steps = result is not None and result.lacks_steps
        return Span("ENDED" if lacks_steps else word, TONES[run.outcome])
    if run.held is not None:
        return Span("HELD", Tone.BAD)
    tone = Tone.GOOD if run.phase is Phase.RUNNING else Tone.STRONG
    return Span(PHASES[run.phase], Tone.WARN if run.phase is Phase.COUNTDOWN else tone)


def team_text(run: Run) -> str:
    return "" if run.setup is None else f"{run.setup.subject} {run.setup.team}".rstrip()


def who_text(run: Run) -> str:
    if run.setup is None:
        return "no run is set up"
    team = f" {run.setup.team}" if run.setup.team else ""
    kind = "practice run" if run.setup.practice else "run"
    return f"{kind} {run.setup.run_number} of subject {run.setup.subject}{team}"


def what_text(run: Run) -> str:
    return ", ".join(filter(None, (who_text(run), condition_text(run))))


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
        if run.held is not None:
            return line(f"  {snapshot.remaining:.1f} s before the start")
        return line(f"  starts in {minutes_text(snapshot.remaining)}")
    of = f" of {minutes_text(run.setup.timeout)}" if run.setup else ""
    return line(f"  {minutes_text(snapshot.remaining)} left{of}")


def condition_text(run: Run) -> str:
    if run.setup is None:
        return ""
    condition = run.setup.condition
    return f"condition {condition.number}: {condition.way}, {condition.benchmark_type}"


_STEP = 23
"""Cells of mark, number and name."""
_TIME = 8
_REASON = 20
"""Cells of a ruling with its reason; with fewer, it stands without."""
_MARKS = {"✓": Tone.GOOD, "x": Tone.BAD, ">": Tone.STRONG, " ": Tone.DIM}


class StepTable(View):
    """The steps of the result, or as they stand while there is none."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        result = snapshot.result
        if result is None:
            return step_lines(snapshot.steps, snapshot.run.start, width, settled=False)
        return step_lines(result.steps, result.start, width)


def step_lines(
    steps: Sequence[StepRecord], start: float | None, width: int, *, settled: bool = True
) -> list[Line]:
    """Times in s since `start` (s since the epoch).

    `settled`: no time can change any more; else those that can are rough and marked.
    """
    cells = max(0, min(_TIME, width - _STEP))
    room = width - _STEP - cells - 2
    pending = None if settled else next((step.step for step in steps if not step.done), None)
    head = f"{'    step':<{_STEP}}{'official' if settled else 'live':>{cells}}  referee (sensor)"
    rows = [line(Span(fitted(head, width), Tone.DIM))]
    for record in steps:
        rough = not settled and record.step in UNSETTLED
        counts = step_time(record.final, start, rough=rough) if record.done else "no"
        words = _words_on_step(record, step_time(record.sensors, start, rough=rough), room)
        mark = (
            "✓" if record.done else "x" if record.denied else ">" if record.step is pending else " "
        )
        tone = _MARKS[mark]
        rows.append(
            line(
                Span(f"{mark} ", tone),
                Target(
                    f"{record.step} {record.step.text:<{_STEP - 4}}",
                    Tone.PLAIN if record.done else tone,
                    str(record.step.value),
                ),
                Span(f"{counts:>{cells}}", tone),
                Span(
                    f"  {fitted(words, room)}" if room > 0 else "",
                    Tone.DIM if record.referee is None else Tone.WARN,
                ),
            )
        )
    return rows


def _words_on_step(record: StepRecord, sensors: str, room: int) -> str:
    """The referee's ruling beside what the sensors say, or why the step is not done."""
    ruling = record.referee
    if ruling is None:
        return record.why_not if room >= _REASON else ""
    by = f" by {ruling.referee or 'the referee'}: {ruling.reason}"
    return f"{RULED[ruling.confirmed]} ({sensors}){by if room >= _REASON else ''}"


def step_time(at: float | None, start: float | None, *, rough: bool) -> str:
    """A time of a step, s since the start; one that may still change is rough and marked."""
    if rough and at is not None and start is not None:
        return rough_text(at - start)
    return relative_text(at, start)


FLAG_TONES = {
    FlagWeight.REMARK: Tone.DIM,
    FlagWeight.CAUTION: Tone.WARN,
    FlagWeight.ALARM: Tone.BAD,
}


def packed(texts: Iterable[Span], width: int, between: str = "; ") -> list[Line]:
    """Each text on the row of the one before it if it fits there, else on rows of its own."""
    rows: list[Line] = []
    for text in texts:
        if rows and width_of(beside := line(*rows[-1], Span(between, Tone.DIM), text)) <= width:
            rows[-1] = beside
        else:
            rows += [line(Span(part, text.tone)) for part in wrapped(text.text, width)]
    return rows
