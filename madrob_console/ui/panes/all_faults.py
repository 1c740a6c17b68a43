"""What is wrong now: in the few rows of the fault line, and whole where those are not enough."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import shortened, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

MOST_ROWS = 3
"""Rows that faults may take from the screen."""

FAULT, NOTE = " FAULT ", " NOTE  "
"""What the first row of the fault line begins with."""

BELOW, ON_LIVE = " below", ": F3"
"""Where the rest of the faults stands."""


class AllFaults(View):
    """Every fault, with all its words, where the fault line of the screen has no room for them."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """As many rows as they need; none where the fault line says everything."""
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
    """What is no fault and stands before them: a row at most."""
    told = [] if snapshot.notice is None else wrapped(snapshot.notice, width - len(FAULT))[:1]
    return [line(Span(NOTE, Tone.NOTICE), Span(text, Tone.WARN)) for text in told]


def short_form(snapshot: Snapshot, width: int, where: str) -> ShortForm:
    """The faults as the fault line of a screen has them.

    Args:
        snapshot: what is shown.
        width: of the screen, cells.
        where: the rest of them stands.
    """
    faults, room = snapshot.all_faults, width - len(FAULT)
    most = MOST_ROWS - len(notices(snapshot, width))
    rows: list[str] = []
    shown = 0
    for fault in faults:
        lines = wrapped(fault, room)
        if rows and len(rows) + len(lines) > most:
            break
        rows += lines
        shown += 1
    hidden, kept = len(faults) - shown, rows[:most]
    if not hidden and kept == rows:
        return ShortForm(rows, cut=False)
    more = f"({f'and {hidden} more' if hidden else 'more'}{where})"
    if kept == rows and cell_len(kept[-1]) + 1 + cell_len(more) <= room:
        kept[-1] += f" {more}"
    elif kept == rows and len(rows) < most:
        kept.append(more)
    else:
        kept[-1] = f"{_cut(kept[-1], room - 1 - cell_len(more))} {more}"
    return ShortForm(kept, cut=True)


def _cut(row: str, width: int) -> str:
    """The first words of a row: a number tells nothing without what it counts."""
    words = row.split()
    while words and (cell_len(" ".join(words)) > width - 2 or words[-1].isdigit()):
        words.pop()
    return f"{' '.join(words)} …" if words else shortened(f"{row} …", width)
