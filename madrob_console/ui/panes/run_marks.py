"""What happened around a run: incidents, false starts, waivers, rulings, notes; its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.acts.rule import RULED
from madrob_console.referee.run import Run
from madrob_console.ui.cells.lines import Line, Span, Tone, View, paragraph

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot


class RunMarks(View):
    """One row each, by kind; then the folder, whole, however long it is."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The rows; none before there is a result."""
        if snapshot.result is None:
            return ()
        rows = list(run_marks(snapshot.run)) or [("marks", "no incident, false start or waiver")]
        lines = [text for name, words in rows for text in _entry(name, words, width)]
        return [*lines, *_entry("files", snapshot.folder or "not known", width, Tone.STRONG)]


def run_marks(run: Run) -> Iterator[tuple[str, str]]:
    """Kind and words of every mark, times in s since the start."""
    for incident in run.incidents:
        more = f": {incident.note}" if incident.note else ""
        gone = "" if incident.withdrawn is None else f" WITHDRAWN: {incident.withdrawn}"
        yield "incident", f"{_at(incident.time, run)}{incident.kind}{more}{gone}"
    for false_start in run.false_starts:
        what = str(false_start.event).replace("_", " ")
        decided = false_start.accepted or "not decided"
        yield "false start", f"{_at(false_start.time, run)}{what} ({decided})"
    for ruling in run.rulings:
        word = RULED[ruling.confirmed]
        yield "ruling", f"{_at(ruling.time, run)}step {ruling.step} {word}: {ruling.reason}"
    for waiver in run.waivers:
        yield "waiver", f"{waiver.check}: {waiver.reason}"
    for note in run.notes:
        yield "note", f"{_at(note.time, run)}{note.text}"


def _at(time: float, run: Run) -> str:
    return "" if run.start is None else f"{time - run.start:+.2f} s "


def _entry(name: str, words: str, width: int, tone: Tone = Tone.PLAIN) -> list[Line]:
    return paragraph(words, width, tone, head=(Span(f"{name:<18}", Tone.DIM),))
