"""What is wrong now: faults, the banner, the evidence line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len

from madrob_console.referee.acts import Abort, Start
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import (
    Line,
    Span,
    Tone,
    View,
    line,
    paragraph,
    width_of,
    with_keys,
)
from madrob_console.ui.keys.key_table import with_caps
from madrob_console.ui.look.words import shortened, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot


MOST_ROWS = 3
"""Rows that faults may take from the screen."""

FAULT, NOTE = " FAULT ", " NOTE  "

BELOW, ON_LIVE = " below", ": F3"
"""Where the rest of the faults stands."""


class AllFaults(View):
    """Every fault, with all its words, if the screen's fault line has no room for them."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if not short_form(snapshot, self.screen.size.width, BELOW).cut:
            return ()
        rows = [line(Span("all faults", Tone.STRONG), Span("  arrows and PgDn scroll", Tone.DIM))]
        for fault in snapshot.all_faults:
            rows += paragraph(fault, width, Tone.BAD, line("- "))
        return rows


class ShortForm(NamedTuple):
    """The faults in a few rows, and whether any of their words are missing there."""

    rows: list[str]
    cut: bool


def notices(snapshot: Snapshot, width: int) -> list[Line]:
    """Notices that are no faults and stand before them: a row at most."""
    rows = [] if snapshot.notice is None else wrapped(snapshot.notice, width - len(FAULT))[:1]
    return [line(Span(NOTE, Tone.NOTICE), Span(text, Tone.WARN)) for text in rows]


def short_form(snapshot: Snapshot, width: int, where: str) -> ShortForm:
    """A row for each fault, as the fault line has them; `where` says where the rest stands."""
    faults, room = snapshot.all_faults, width - len(FAULT)
    rows = list(faults[: MOST_ROWS - len(notices(snapshot, width))])
    hidden = len(faults) - len(rows)
    cut = hidden > 0 or any(cell_len(row) > room for row in rows)
    more = f" ({f'and {hidden} more' if hidden else 'more'}{where})" if cut else ""
    rows[:-1] = [_cut(row, room) for row in rows[:-1]]
    rows[-1:] = [_cut(row, room - len(more)) + more for row in rows[-1:]]
    return ShortForm(rows, cut)


def _cut(fault: str, room: int) -> str:
    """Whole words: half a number says something else."""
    return fault if cell_len(fault) <= room else f"{wrapped(fault, room - 2)[0]} …"


class Banner(View):
    """A false start, a question, or what comes next."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = banner(snapshot)
        return with_keys(paragraph(text, width, tone))


def banner(snapshot: Snapshot) -> tuple[str, Tone]:
    run = snapshot.run
    silent = snapshot.playback is not None or snapshot.right.only_watches
    if (false_start := run.undecided_false_start) is not None:
        at = "" if run.start is None else f" at {false_start.time - run.start:.1f} s"
        again = "r restarts, " if run.held is not None else ""
        how = "" if silent else f": {again}a accepts it"
        return f" FALSE START: {false_start.event.words}{at}{how} ", Tone.ALARM
    if writing := snapshot.pulse.writing:
        how = "; F8 withdraws it" if snapshot.refusal(Abort.name) is None else ""
        return f" {writing.upper()}: waiting for the disk{how} ", Tone.NOTICE
    if snapshot.ask_referee is not None:
        how = "" if silent else " (1-6 rules on a step)"
        return f" REFEREE: {snapshot.ask_referee}{how} ", Tone.NOTICE
    if snapshot.settling:
        return "door closed: waiting for the settle time of step 6", Tone.WARN
    if run.phase is Phase.RUNNING and run.robot_words is not None:
        how = "" if silent else "; F9 declares the timeout"
        return f" REFEREE: the robot says '{run.robot_words}'{how} ", Tone.NOTICE
    return _next(snapshot, silent=silent), Tone.PLAIN


def _next(snapshot: Snapshot, *, silent: bool) -> str:
    match snapshot.run.phase:
        case Phase.IDLE | Phase.READY if snapshot.right.only_watches:
            return ""
        case Phase.IDLE:
            return "F2: set up a run"
        case Phase.READY:
            refused = snapshot.refusal(Start.name)
            return (
                "F5 starts the countdown" if refused is None else f"F5 waits: {with_caps(refused)}"
            )
        case Phase.COUNTDOWN:
            return "countdown: nobody touches the handle or the door"
        case Phase.RUNNING:
            step = next((record for record in snapshot.steps if not record.done), None)
            return "" if step is None else f"next: step {step.step} {step.step.text}"
        case Phase.STOPPED:
            if snapshot.result is not None:
                return "F4: result"
            if snapshot.rescoring:
                return "the result is being scored again"
            return "the run has stopped" if snapshot.playback else "the result is being written"
        case Phase.FINAL:
            more = "F4: result" if silent else "x sets up the next run"
            return f"the result is final: {more}"


class EvidenceLine(View):
    """What is recorded beside the run, and what is wrong with it."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if (evidence := snapshot.evidence) is None:
            return ()
        remarks = list(evidence.remarks(snapshot.run.start))
        row = line(Span("evidence", Tone.STRONG), Span(f"  {evidence.words}"))
        for text in remarks:
            if part := shortened(f"  {text}", width - width_of(row)):
                row = (*row, Span(part, Tone.WARN))
        return [row]
