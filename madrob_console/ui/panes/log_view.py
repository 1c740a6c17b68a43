"""The last lines of the event log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import time_of_day

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import LogLine, Snapshot

_TONES = {"referee": Tone.STRONG, "sensor": Tone.PLAIN, "clock": Tone.PLAIN, "system": Tone.DIM}


class EventLog(View):
    """As many lines as there is room for, the newest at the bottom."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Time, origin, text."""
        rows = self.size.height
        return [log_line(entry) for entry in snapshot.log[-rows:]] if rows else ()


def _tone(entry: LogLine) -> Tone:
    if entry.text.startswith("FALSE START"):
        return Tone.ALARM
    return Tone.NOTICE if entry.text.startswith("incident") else _TONES[entry.origin]


def log_line(entry: LogLine) -> Line:
    """Time since the start, or of day outside a run; who made it happen; what."""
    at = time_of_day(entry.time) if entry.relative is None else f"{entry.relative:+8.2f}"
    return line(
        Span(f"{at:>8} {entry.origin:<8}", Tone.DIM),
        Span(entry.text, _tone(entry)),
    )
