"""What happened around a run: doubts, decisions, incidents, waivers, notes; its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rich.cells import cell_len

from madrob_console.archive.folders import PICTURES_FOLDER
from madrob_console.referee.acts.rule import RULED
from madrob_console.referee.doubt_answers import doubted_words
from madrob_console.referee.run import Run
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import cut_inside, date_of

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot


class RunMarks(View):
    """One row each, by kind, the newest first; then the folder (y copies it whole).

    Attributes:
        pictures: how many there are in the run's folder of what cameras saw.
    """

    def __init__(self) -> None:
        super().__init__()
        self.pictures = 0

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The rows; none before there is a result."""
        if snapshot.result is None:
            return ()
        doubts = (
            ("doubt", f"{words} ({', '.join(name.words for name in on)})")
            for words, on in snapshot.result.doubts.items()
        )
        rows = [*doubts, *run_marks(snapshot.run)] or [("marks", "none")]
        lines = [text for name, words in rows for text in _entry(name, words, width)]
        lines += _path("files", snapshot.folder or "not known", width)
        if self.pictures and snapshot.folder:
            kind = f"{self.pictures} pictures"
            lines += _path(kind, f"{snapshot.folder}/{PICTURES_FOLDER}", width)
        return lines


def run_marks(run: Run) -> Iterator[tuple[str, str]]:
    """Kind and words of every mark, the newest of a kind first; times in s since the start."""
    for false_start in reversed(run.false_starts):
        what, decided = false_start.event.words, false_start.accepted or "UNDECIDED"
        yield "false start", f"{_at(false_start.time, run)}{what} ({decided})"
    yield from _protests(run)
    yield from _decisions(run)
    for incident in reversed(run.incidents):
        more = f": {incident.note}" if incident.note else ""
        gone = "" if incident.withdrawn is None else f" WITHDRAWN: {incident.withdrawn}"
        yield "incident", f"{_at(incident.time, run)}{incident.kind}{more}{gone}"
    for fault in reversed(run.faults):
        yield "testbed fault", f"{_at(fault.time, run)}{fault.text}"
    for waiver in run.waivers:
        yield "waiver", f"{waiver.check}: {waiver.reason}"
    for note in reversed(run.notes):
        yield "note", f"{_at(note.time, run)}{note.text}"
    for removed in reversed(run.removed_evidence):
        yield "evidence removed", f"{date_of(removed.time)}: {removed.words}"


def _protests(run: Run) -> Iterator[tuple[str, str]]:
    """What teams say, and what was decided."""
    for one in reversed(run.protests):
        at = "" if one.at is None else f" {_at(one.at, run)}".rstrip()
        late = f"; late, admitted: {one.late}" if one.late else ""
        yield f"protest {one.number}", f"{one.team}, about {one.about}{at}: {one.text}{late}"
        if (answer := one.answer) is not None:
            came = f"; {one.late_decision}" if one.late_decision else ""
            yield "  decision", f"{answer.end}: {answer.reason} ({answer.referee}){came}"


def _decisions(run: Run) -> Iterator[tuple[str, str]]:
    """What the referee decided after the stop, or of a step."""
    for one in reversed(run.reissues):
        by = f" ({one.referee})" if one.referee else ""
        yield f"issue {one.issue}", f"{date_of(one.time)}, {one.what}: {one.reason}{by}"
    if run.voided is not None:
        yield "void", f"{_at(run.voided.time, run)}{run.voided.reason}"
    for change in reversed(run.corrections):
        yield "correction", f"{_at(change.time, run)}{change.words}: {change.reason}"
    for accepted in reversed(run.accepted_doubts):
        words = f"{doubted_words(accepted.doubts)}: {accepted.reason}"
        yield "doubt accepted", f"{_at(accepted.time, run)}{words}"
    for back in reversed(run.taken_back):
        yield "taken back", f"{_at(back.time, run)}{back.words}: {back.reason}"
    for ruling in reversed(run.rulings):
        word = RULED[ruling.confirmed]
        yield "ruling", f"{_at(ruling.time, run)}step {ruling.step} {word}: {ruling.reason}"


def _path(name: str, path: str, width: int) -> list[Line]:
    """One row: beside its name, or without it where that leaves room for all."""
    head = f"{name:<18}"
    if cell_len(head) + cell_len(path) > width:
        head = f"{name} "
    return [line(Span(head, Tone.DIM), Span(cut_inside(path, width - len(head)), Tone.STRONG))]


def _at(time: float, run: Run) -> str:
    return "" if run.start is None else f"{time - run.start:+.2f} s "


def _entry(name: str, words: str, width: int, tone: Tone = Tone.PLAIN) -> list[Line]:
    return paragraph(words, width, tone, head=(Span(f"{name:<18}", Tone.DIM),))
