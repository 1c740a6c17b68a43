"""The six steps: what the sensors say, what the referee says, what counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.run_times import relative_text
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import fitted, rough_text
from scoring.procedure import UNSETTLED, StepRecord

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_NARROW = 50
"""Cells without the column of reasons; with fewer, only what counts is shown."""

_COMPACT = 34
"""Cells of what counts with `ref` behind it; with fewer, an `R` stands before the step."""

_LEAST_ROOM = 14
"""Cells that a column of reasons needs."""


class StepTable(View):
    """The steps as they stand, or as they are in the result."""

    def __init__(self, *, of_result: bool = False) -> None:
        super().__init__()
        self._of_result = of_result

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header and six rows; more for reasons that would not be whole."""
        result = snapshot.result
        if not self._of_result:
            return step_lines(snapshot.steps, snapshot.run.start, width, settled=result is not None)
        return [] if result is None else result_step_lines(result.steps, result.start, width)


def step_lines(
    steps: Sequence[StepRecord], start: float | None, width: int, *, settled: bool = True
) -> list[Line]:
    """The table of a run that goes on; times in s since `start`.

    With room, a column says why a step is not done.

    Args:
        steps: the six.
        start: of the run, s since the epoch.
        width: cells.
        settled: no time can change any more; else those that can are rough and marked.
    """
    room = _room(width)
    pending = next((record.step for record in steps if not record.done), None)
    rows = [_head(width, "counts" if settled else "so far", why=bool(room))]
    for record in steps:
        rough = not settled and record.step in UNSETTLED
        row = _row(record, start, width, is_next=record.step is pending, rough=rough)
        why = Span(f"  {fitted(record.reason or '', room)}", Tone.DIM)
        rows.append(line(*row, why if room else ""))
    return rows


def result_step_lines(steps: Sequence[StepRecord], start: float, width: int) -> list[Line]:
    """The table of a result; why a step is not done stands beside it, without room below it."""
    room = _room(width)
    rows = [_head(width, "counts", why=bool(room))]
    for record in steps:
        row, why = _row(record, start, width, is_next=False, rough=False), record.why_not
        if room:
            rows.append(line(*row, Span(f"  {fitted(why, room)}", Tone.DIM)))
        else:
            below = paragraph(why, width, Tone.DIM, head=line(" " * 4)) if why else []
            rows += [row, *below]
    return rows


def _room(width: int) -> int:
    """Cells for reasons in a column; 0 for too few."""
    room = width - _NARROW - 2
    return room if room >= _LEAST_ROOM else 0


def _head(width: int, last: str, *, why: bool) -> Line:
    if width < _NARROW:
        text = f"    {'step':<19}{last:>7}"
    else:
        text = f"    {'step':<19} {'sensors':>7}  {'referee':<9} {last:>7}"
    return line(Span(fitted(text + ("  why not" if why else ""), width), Tone.DIM))


def _row(
    record: StepRecord, start: float | None, width: int, *, is_next: bool, rough: bool
) -> Line:
    if width < _NARROW:
        return _compact(record, start, width, is_next=is_next, rough=rough)
    ruling = record.referee
    said = "-" if ruling is None else "confirmed" if ruling.confirmed else "denied"
    mark = "x" if said == "denied" else ">" if is_next else " "
    tone = Tone.STRONG if is_next else Tone.DIM
    if record.done:
        mark, tone = "✓", Tone.PLAIN
    return line(
        Span(f"{mark} ", Tone.GOOD if record.done else Tone.BAD if mark == "x" else Tone.STRONG),
        Span(f"{record.step} {record.step.text:<19} ", tone),
        Span(f"{step_time(record.sensors, start, rough=rough):>7}  ", tone),
        Span(f"{said:<9} ", Tone.WARN if ruling is not None else Tone.DIM),
        _counts(record, start, rough=rough),
    )


def _compact(
    record: StepRecord, start: float | None, width: int, *, is_next: bool, rough: bool
) -> Line:
    """What counts, and whether the referee said so; the result has all columns."""
    counts = _counts(record, start, rough=rough)
    ruled = record.referee is not None
    roomy = width >= _COMPACT
    return line(
        Span("✓" if record.done else ">" if is_next else " ", counts.tone),
        Span("R" if ruled and not roomy else " ", Tone.WARN),
        f"{record.step} {record.step.text:<19}",
        counts,
        Span(" ref" if ruled and roomy else "", Tone.WARN),
    )


def _counts(record: StepRecord, start: float | None, *, rough: bool) -> Span:
    if record.done:
        text = step_time(record.final, start, rough=rough)
        return Span(f"{text:>7}", Tone.PLAIN if rough else Tone.GOOD)
    return Span(f"{'no':>7}", Tone.DIM)


def step_time(at: float | None, start: float | None, *, rough: bool) -> str:
    """A time of a step, s since the start; one that may still change is rough and marked."""
    if rough and at is not None and start is not None:
        return rough_text(at - start)
    return relative_text(at, start)
