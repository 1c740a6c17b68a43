"""The six steps: what the sensors say, what the referee says, what counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.run import relative_text
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import fitted
from scoring.procedure import StepRecord

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_NARROW = 50
"""Cells without the column of reasons; with fewer, only what counts is shown."""


class StepTable(View):
    """The steps as they stand, or as they are in the result."""

    def __init__(self, *, of_result: bool = False) -> None:
        super().__init__()
        self._of_result = of_result

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header and six rows."""
        if not self._of_result:
            return step_lines(snapshot.steps, snapshot.run.start, width)
        if snapshot.result is None:
            return ()
        return step_lines(snapshot.result.steps, snapshot.result.start, width)


def step_lines(steps: Sequence[StepRecord], start: float | None, width: int) -> list[Line]:
    """The table; times in s since `start`. With room, a column says why a step is not done."""
    narrow, room = width < _NARROW, width - _NARROW - 2
    why = "  why not" if room >= 14 else ""
    head = f"    {'step':<19} {'sensors':>7}  {'referee':<9} {'final':>7}{why}"
    if narrow:
        head = f"    {'step':<19}{'final':>7}"
    pending = next((record.step for record in steps if not record.done), None)
    rows = [line(Span(fitted(head, width), Tone.DIM))]
    for record in steps:
        row = (_compact if narrow else _row)(record, start, is_next=record.step is pending)
        if why and record.reason:
            row = line(*row, Span(f"  {fitted(record.reason, room)}", Tone.DIM))
        rows.append(row)
    return rows


def _compact(record: StepRecord, start: float | None, *, is_next: bool) -> Line:
    """What counts, and whether the referee said so; the result has all columns."""
    final = _final(record, start)
    return line(
        Span("✓ " if record.done else "> " if is_next else "  ", final.tone),
        f"{record.step} {record.step.text:<18}",
        final,
        Span(" ref" if record.referee is not None else "", Tone.WARN),
    )


def _row(record: StepRecord, start: float | None, *, is_next: bool) -> Line:
    ruling = record.referee
    said = "-" if ruling is None else "confirmed" if ruling.confirmed else "denied"
    mark = "x" if said == "denied" else ">" if is_next else " "
    tone = Tone.STRONG if is_next else Tone.DIM
    if record.done:
        mark, tone = "✓", Tone.PLAIN
    return line(
        Span(f"{mark} ", Tone.GOOD if record.done else Tone.BAD if mark == "x" else Tone.STRONG),
        Span(f"{record.step} {record.step.text:<19} ", tone),
        Span(f"{relative_text(record.sensors, start):>7}  ", tone),
        Span(f"{said:<9} ", Tone.WARN if ruling is not None else Tone.DIM),
        _final(record, start),
    )


def _final(record: StepRecord, start: float | None) -> Span:
    if record.done:
        return Span(f"{relative_text(record.final, start):>7}", Tone.GOOD)
    return Span(f"{'no':>7}", Tone.DIM)
