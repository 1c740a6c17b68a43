"""The help pane: keys and symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import VerticalScroll

from madrob_console.ui.keys import FUNCTION_KEYS, LETTER_KEYS
from madrob_console.ui.widgets.lines import Line, Lines, Span, Tone, line
from madrob_console.ui.widgets.passage import LEGEND
from madrob_console.ui.words import wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

_TEXT = """\
Set-up (F2): Tab, Enter and arrows go through the fields, left and right change a choice. What \
you see is set up as soon as you leave a field. Then F6 when the robot stands at its start pose, \
and F5.
A dim key is not possible now: press it and the line above the keys says why.
F8 and F9 ask for a reason and then for y. The clock runs on. Escape closes a question and never \
does more.
Letters type text while a text field has the focus; function keys always work."""


class HelpText(Lines):
    """All keys, then how things hang together, then the symbols."""

    def lines(self, width: int) -> Sequence[Line]:
        """The page."""
        rows = [
            line(
                Span(f"{key.cap:>4}", Tone.CAP),
                f"  {key.label.strip():<9}",
                Span(key.help, Tone.DIM),
            )
            for key in (*FUNCTION_KEYS, *LETTER_KEYS)
        ]
        for text in _TEXT.splitlines():
            rows += [line(), *(line(row) for row in wrapped(text, width))]
        rows += [line(), line(Span("Passage sensors", Tone.STRONG))]
        rows += [line(Span(f"{mark:>4}  ", Tone.STRONG), meaning) for mark, meaning in LEGEND]
        rows.append(
            line("The hinge is on the left: sensor 4 is next to it, sensor 0 farthest away.")
        )
        return rows


class HelpPane(VerticalScroll):
    """Arrows scroll."""

    def __init__(self) -> None:
        super().__init__(id="help")

    def compose(self) -> ComposeResult:
        """One page."""
        yield HelpText()

    def show(self, snapshot: Snapshot) -> None:
        """The help does not change."""
