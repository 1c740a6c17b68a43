"""The last lines of the event log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.engine.shown.snapshot import Weight
from madrob_console.referee.journal import Origin
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import time_of_day

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import LogLine, Snapshot

_TONES = {
    Origin.REFEREE: Tone.STRONG,
    Origin.REMOTE: Tone.STRONG,
    Origin.SENSOR: Tone.PLAIN,
    Origin.CLOCK: Tone.PLAIN,
    Origin.SYSTEM: Tone.DIM,
}
_LOUD = {Weight.NOTICE: Tone.NOTICE, Weight.ALARM: Tone.ALARM}


class LogView(View):
    """As many lines as there is room for, the newest at the bottom."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Time, origin, text."""
        rows = self.size.height
        return [log_line(entry) for entry in snapshot.log[-rows:]] if rows else ()


def log_line(entry: LogLine) -> Line:
    """Time since the start, or of day outside a run; who made it happen; what."""
    at = time_of_day(entry.time) if entry.relative is None else f"{entry.relative:+8.2f}"
    return line(
        Span(f"{at:>8} {entry.origin:<8}", Tone.DIM),
        Span(entry.text, _LOUD.get(entry.weight) or _TONES[entry.origin]),
    )
