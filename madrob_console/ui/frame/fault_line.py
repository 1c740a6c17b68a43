"""What is wrong now; it stays until it is gone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.cells import cell_len

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.frame.top_line import ROOMY
from madrob_console.ui.look.words import fitted
from madrob_console.ui.panes.all_faults import BELOW, FAULT, ON_LIVE, notices, short_form

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot


class FaultLine(View):
    """The faults, one a row; the last row counts those that found no room.

    Attributes:
        whole_below: whether the pane that is shown has all of them where they are cut here.
    """

    def __init__(self, where: str = "") -> None:
        super().__init__()
        self.whole_below = False
        self._where = where

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Up to three rows."""
        told = notices(snapshot, width)
        if not snapshot.all_faults and told:
            return told
        if not snapshot.all_faults:
            room = 0 if width >= ROOMY else min(cell_len(self._where), width - 10)
            where = fitted(self._where, room)  # the top line has no room for it
            left = fitted("no faults", width - cell_len(where))
            return [line(Span(left + where, Tone.DIM))]
        rows = short_form(snapshot, width, BELOW if self.whole_below else ON_LIVE).rows
        marks = [FAULT] + [" " * len(FAULT)] * (len(rows) - 1)
        return told + [
            line(Span(mark, Tone.ALARM), Span(row, Tone.BAD))
            for mark, row in zip(marks, rows, strict=True)
        ]
