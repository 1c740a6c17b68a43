"""The run's clock in large digits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import clock_text

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_GLYPHS = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": ("▀█ ", " █ ", "▀▀▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    ":": ("▄", "▄", " "),
    ".": (" ", " ", "▀"),
    "-": ("   ", "▀▀▀", "   "),
}
_ASCII_GLYPHS = {
    "0": (" _ ", "| |", "|_|"),
    "1": ("   ", "  |", "  |"),
    "2": (" _ ", " _|", "|_ "),
    "3": (" _ ", " _|", " _|"),
    "4": ("   ", "|_|", "  |"),
    "5": (" _ ", "|_ ", " _|"),
    "6": (" _ ", "|_ ", "|_|"),
    "7": (" _ ", "  |", "  |"),
    "8": (" _ ", "|_|", "|_|"),
    "9": (" _ ", "|_|", " _|"),
    ":": (" ", ".", "."),
    ".": (" ", " ", "."),
    "-": ("   ", " _ ", "   "),
}


class RunClock(View):
    """Time since the start; negative in the countdown, the execution time once stopped.

    Textual writes a changed row from the widget's left edge on, so the tenths, ten times as
    quick as the rest, are a widget of their own (`RunTenths`).
    """

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows, to the right; plain digits where there is no room for large ones."""
        text, tone = clock_span(snapshot)
        rows = large_digits(text[:-2], ascii_only=self.ascii_only)
        if len(rows[0]) > width:
            rows = ("", text[:-2], "")
        return [line(Span(f"{row:>{width}}", tone)) for row in rows]


class RunTenths(View):
    """The point and the tenths beside `RunClock`."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows."""
        text, tone = clock_span(snapshot)
        rows = large_digits(text[-2:], ascii_only=self.ascii_only)
        return [line(Span(f" {row}", tone)) for row in rows]


def clock_span(snapshot: Snapshot) -> Span:
    """The clock in ordinary digits."""
    if snapshot.elapsed is None:
        return Span("-:--.-", Tone.STRONG)
    return Span(clock_text(snapshot.elapsed), Tone.WARN if snapshot.elapsed < 0 else Tone.STRONG)


def large_digits(text: str, *, ascii_only: bool = False) -> tuple[str, str, str]:
    """Three rows of block characters, or of bars, that read as `text`."""
    glyphs = [(_ASCII_GLYPHS if ascii_only else _GLYPHS)[char] for char in text]
    first, second, third = (" ".join(glyph[row] for glyph in glyphs) for row in range(3))
    return first, second, third
