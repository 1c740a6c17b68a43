"""The run's clock in large digits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from textual.geometry import Size

from madrob_console.ui.cells.large_text import HEIGHT, large_text, rows_of, width_of_large
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import clock_text

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_LARGEST_TIME = "-00:00"
"""What there is room for, whatever the time: nothing moves when a run goes on for long."""

_FEWEST = (50, 16)
"""Columns and rows of the terminal for each size of the clock."""


def clock_size(terminal: Size) -> int:
    """How large the clock is: it grows with the terminal and with nothing else."""
    width, height = _FEWEST
    return max(1, min(terminal.width // width, terminal.height // height))


class RunClock(View):
    """Time since the start; negative in the countdown, the execution time once stopped.

    Textual writes a changed row from the widget's left edge on, so the tenths, ten times as
    quick as the rest, are a widget of their own (`RunTenths`), which stays small.
    """

    def get_content_width(self, container: Size, viewport: Size) -> int:
        """For minutes and seconds."""
        return width_of_large(_LARGEST_TIME, clock_size(viewport)) + 1

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """To the right; plain digits where there is no room for large ones."""
        text, tone = clock_span(snapshot)
        size = clock_size(self.app.size)
        rows = large_text(text[:-2], size, ascii_only=self.ascii_only)
        if rows is None or len(rows[0]) > width:
            rows = ["", text[:-2], *[""] * (rows_of(size) - 2)]
        return [line(Span(f"{row:>{width}}", tone)) for row in rows]


class RunTenths(View):
    """The point and the tenths beside `RunClock`, at the foot of its digits."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows, and those above them."""
        text, tone = clock_span(snapshot)
        size = clock_size(self.app.size)
        rows = large_text(text[-2:], 1, ascii_only=self.ascii_only) or ["", text[-2:], ""]
        above = rows_of(size) - len(rows) - (size > 1 and HEIGHT * size % 2 == 0)
        return [*[line("")] * above, *(line(Span(f" {row}", tone)) for row in rows)]


def clock_span(snapshot: Snapshot) -> Span:
    """The clock in ordinary digits; `?` for the tenths of one that may have gone on unseen."""
    if snapshot.elapsed is None:
        return Span("-:--.-", Tone.STRONG)
    if snapshot.pulse.stale and snapshot.run.active:
        return Span(f"{clock_text(snapshot.elapsed)[:-1]}?", Tone.DIM)
    return Span(clock_text(snapshot.elapsed), Tone.WARN if snapshot.elapsed < 0 else Tone.STRONG)
