"""Numbers in Textual's large digits, three rows of cells."""

from __future__ import annotations

from rich.segment import Segment
from rich.style import Style
from textual.renderables.digits import Digits


def digit_rows(text: str) -> list[str]:
    drawn = Digits(text).render(Style(bold=True))
    return [row.text for row in drawn if isinstance(row, Segment) and row.text != "\n"]
