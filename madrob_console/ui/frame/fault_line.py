"""What is wrong now; it stays until it is gone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.cells import cell_len

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.frame.top_line import ROOMY
from madrob_console.ui.look.words import fitted, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

MOST_ROWS = 3
"""Rows that faults may take from the screen."""


class FaultLine(View):
    """The faults, one a row; the last row counts those that found no room."""

    def __init__(self, where: str = "") -> None:
        super().__init__()
        self._where = where

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Up to three rows."""
        faults = list(snapshot.all_faults)
        notice = [] if snapshot.notice is None else wrapped(snapshot.notice, width - 7)[:1]
        notices = [line(Span(" NOTE  ", Tone.NOTICE), Span(text, Tone.WARN)) for text in notice]
        if not faults and notices:
            return notices
        if not faults:
            room = 0 if width >= ROOMY else min(cell_len(self._where), width - 10)
            where = fitted(self._where, room)  # the top line has no room for it
            left = fitted("no faults", width - cell_len(where))
            return [line(Span(left + where, Tone.DIM))]
        rows: list[str] = []
        shown = 0
        for fault in faults:
            lines = wrapped(fault, width - 7)
            most = MOST_ROWS - len(notices)
            if rows and len(rows) + len(lines) > most:
                break
            rows.extend(lines[:most])
            shown += 1
        if hidden := len(faults) - shown:
            rows[-1] = f"{rows[-1][: width - 24]} (and {hidden} more: F3)"
        marks = [" FAULT "] + ["       "] * (len(rows) - 1)
        return notices + [
            line(Span(mark, Tone.ALARM), Span(row, Tone.BAD))
            for mark, row in zip(marks, rows, strict=True)
        ]
