"""How the screens say things: times, sizes, outcomes, lines that fit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.cells import cell_len, chop_cells, set_cell_size

from madrob_console.referee.run import Phase
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import ExportView
    from madrob_console.referee.acts import Act

_LONGEST_REASON = 60

ROUGH = "~"
"""Marks a time that may still change."""

OUTCOMES = {
    Outcome.COMPLETED: "COMPLETED",
    Outcome.TIMEOUT: "TIMEOUT",
    Outcome.ABORTED: "ABORTED: invalid",
    Outcome.INTERRUPTED: "INTERRUPTED: does not count",
}

PHASES = {
    Phase.IDLE: "NO RUN SET UP",
    Phase.READY: "READY",
    Phase.COUNTDOWN: "COUNTDOWN",
    Phase.RUNNING: "RUNNING",
    Phase.STOPPED: "STOPPED",
    Phase.FINAL: "FINAL",
}


def clock_text(seconds: float, decimals: int = 1) -> str:
    """Minutes and seconds, cut and never rounded up: `-0:04.2`, `12:03.9`."""
    second = 10**decimals
    parts = math.floor(abs(seconds) * second + 1e-6)
    sign = "-" if seconds < 0 and parts else ""
    whole = parts // second
    return f"{sign}{whole // 60}:{whole % 60:02d}.{parts % second:0{decimals}d}"


def minutes_text(seconds: float) -> str:
    """Minutes and seconds of a time to go, rounded up so that 0:00 means none is left."""
    whole = math.ceil(max(0.0, seconds) - 1e-6)
    return f"{whole // 60}:{whole % 60:02d}"


def rough_text(duration: float) -> str:
    """A time that may still change: one decimal of a second, marked."""
    return f"{ROUGH}{duration:.1f}"


def done_text(act: Act) -> str:
    reason = act.reason_given
    return f"Done: {act.done_text}" + (f" ({shortened(reason, _LONGEST_REASON)})" if reason else "")


def export_text(export: ExportView) -> str:
    if not export.path:
        if not export.problem:
            runs = "" if export.dossier else "the runs of "
            return f"Packing {runs}{export.what} in the background ..."
        return f"No zip of {export.what}: {export.problem}"
    missing = f", but not all ({export.problem})" if export.problem else ""
    return f"Packed{missing}: {export.path} (y copies it)"


def fitted(text: str, width: int) -> str:
    """The text in exactly `width` cells; what is cut shows an ellipsis."""
    if cell_len(text) <= width:
        return set_cell_size(text, width)
    return f"{set_cell_size(text, width - 1)}…" if width > 0 else ""


def shortened(text: str, width: int) -> str:
    """The text in at most `width` cells; what is cut shows an ellipsis."""
    return text if cell_len(text) <= width else fitted(text, width).rstrip()


def cut_inside(text: str, width: int) -> str:
    """The text in at most `width` cells; a long one is cut in its middle: both ends tell more."""
    if cell_len(text) <= width:
        return text
    if width < 3:
        return shortened(text, width)
    head, tail = text[: len(text) // 2], text[len(text) // 2 :]
    while cell_len(head) + 1 + cell_len(tail) > width:
        if cell_len(head) > width // 3:
            head = head[:-1]
        else:
            tail = tail[1:]
    return f"{head}…{tail}"


def wrapped(text: str, width: int) -> list[str]:
    """The text in lines of at most `width` cells, broken at blanks if there are any.

    A word that is longer, as a path, is broken behind a slash or an underscore if it has one.
    """
    lines: list[str] = []
    for word in text.split():
        if lines and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines += _chopped(word, max(2, width))
    return lines or [""]


def _chopped(word: str, width: int) -> list[str]:
    pieces: list[str] = []
    while cell_len(word) > width:
        first = chop_cells(word, width)[0]
        end = max(first.rfind(sign) for sign in "/_") + 1
        pieces.append(first[:end] if end > 1 else first)
        word = word[len(pieces[-1]) :]
    return [*pieces, word]
