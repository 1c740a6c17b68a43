"""The run in a terminal that is too small for the screens."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

from madrob_console.referee.acts import Abort
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.frame.playback_bar import state_span
from madrob_console.ui.look.words import fitted, minutes_text, shortened, wrapped
from madrob_console.ui.panes.banner import banner
from madrob_console.ui.panes.run_clock import clock_span
from madrob_console.ui.panes.run_status import phase_span

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

SMALLEST = (10, 3)
"""Columns and rows for the phase, the clock and the way to abort."""

_GAP = Span("  ")
_ROOM_FOR_REASONS = 24
_MOST_ROWS = 3


class Part(IntEnum):
    """What there is to show, the most important first."""

    CLOCK = 0
    ABORT = 1
    PHASE = 2
    KIND = 3
    URGENT = 4
    FAULT = 5
    LEFT = 6
    NEXT = 7
    HINT = 8


class TinyClock(View):
    """Clock, abort, and as much else as there are rows for."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """What fits into the rows that the style gives."""
        return tiny_lines(snapshot, width, self.room.height)


def tiny_lines(snapshot: Snapshot, width: int, height: int) -> list[Line]:
    """The most important parts that fit into `width` x `height` cells, from the top.

    Phase, clock and time left share a row where that is wide enough. Long texts are wrapped, and
    cut to one row before anything but the hint gives way to them.
    """
    lines: list[Line] = []
    for kept, most in _concessions():
        lines = _lines(snapshot, width, kept, most)
        if len(lines) <= height:
            break
    return lines[:height]


def _concessions() -> Iterator[tuple[Sequence[Part], int]]:
    """Parts that are kept and rows that a long text may take, less and less."""
    parts = list(Part)
    yield parts, _MOST_ROWS
    for most in range(_MOST_ROWS, 0, -1):
        yield parts[:-1], most
    for count in range(len(parts) - 2, 0, -1):
        yield parts[:count], 1


def _lines(snapshot: Snapshot, width: int, kept: Sequence[Part], most: int) -> list[Line]:
    """The parts that are kept and have something to say."""
    text, tone = banner(snapshot)
    urgent = tone in (Tone.ALARM, Tone.NOTICE)
    head = {
        Part.PHASE: phase_span(snapshot.run),
        Part.CLOCK: clock_span(snapshot),
        Part.KIND: Span("PRACTICE" if snapshot.practice else "", Tone.NOTICE),
        Part.LEFT: Span(_left(snapshot)),
    }
    lines = _packed((span for part, span in head.items() if part in kept and span.text), width)
    if Part.URGENT in kept and urgent:
        lines += _wrapped(text.strip(), tone, width, most)
    if Part.NEXT in kept and not urgent and snapshot.run.active:
        lines += _wrapped(text, tone, width, most)
    if Part.FAULT in kept and snapshot.all_faults:
        lines += _wrapped(f"FAULT {snapshot.all_faults[0]}", Tone.BAD, width, most)
    elif Part.FAULT in kept and snapshot.notice is not None:
        lines += _wrapped(snapshot.notice, Tone.WARN, width, most)
    if Part.ABORT in kept:
        lines.append(_abort(snapshot, width))
    if Part.HINT in kept:
        lines.append(line(Span(fitted("60x18 shows all", width), Tone.DIM)))
    return lines


def _packed(spans: Iterable[Span], width: int) -> list[Line]:
    """Spans on as few rows as they need."""
    lines: list[Line] = []
    for text, tone in spans:
        span = Span(shortened(text, width), tone)
        if lines and width_of((*lines[-1], _GAP, span)) <= width:
            lines[-1] = (*lines[-1], _GAP, span)
        else:
            lines.append((span,))
    return lines


def _wrapped(text: str, tone: Tone, width: int, most: int) -> list[Line]:
    """A text on at most `most` rows."""
    rows = wrapped(text, width) if text else []
    if len(rows) > most:
        rows = [*rows[: most - 1], fitted(" ".join(rows[most - 1 :]), width)]
    return [line(Span(row, tone)) for row in rows]


def _left(snapshot: Snapshot) -> str:
    """Time to the timeout; that of a countdown is the clock itself."""
    if snapshot.remaining is None or snapshot.run.phase is not Phase.RUNNING:
        return ""
    return f"{minutes_text(snapshot.remaining)} left"


def _abort(snapshot: Snapshot, width: int) -> Line:
    """The key as the footer has it; where it does nothing, dim and with the reason.

    A replay says that it is one: there is nothing to abort.
    """
    if snapshot.playback is not None:
        return line(Span("REPLAY", Tone.NOTICE), " ", state_span(snapshot.playback))
    refused = snapshot.refusal(Abort.name)
    if refused is None:
        return line(Span("F8", Tone.CAP), Span(" ABORT", Tone.STRONG))
    text = f"F8 abort: {refused}" if width >= _ROOM_FOR_REASONS else "(F8 abort)"
    return line(Span(fitted(text, width), Tone.DIM))
