"""Text that changes now and then: names of fields, messages."""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len
from textual.geometry import Size

from madrob_console.ui.cells.lines import Line, Lines, Tone, paragraph


class Label(Lines):
    """A text in one tone, on as many rows as it needs.

    Attributes:
        tone: of all of it.
    """

    def __init__(self, text: str = "", tone: Tone = Tone.DIM, *, id: str | None = None) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self._text = text
        self.tone = tone

    @property
    def text(self) -> str:
        """The text."""
        return self._text

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Show another text."""
        self._text, self.tone = text, tone
        self.redraw()

    def get_content_width(self, container: Size, viewport: Size) -> int:
        """As wide as the text, where the width is `auto`."""
        return cell_len(self._text)

    def lines(self, width: int) -> Sequence[Line]:
        """The text, wrapped."""
        return paragraph(self._text, width, self.tone)
