"""A button on one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line


class PushButton(Lines, can_focus=True):
    """Enter or space presses it."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter,space", "press", show=False)]

    class Pressed(Message):
        """It was pressed."""

    def __init__(self, label: str, *, id: str) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self._label = label

    def say(self, label: str) -> None:
        """Change the label."""
        self._label = label
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        """The label in brackets."""
        tone = Tone.CURSOR if self.has_focus else Tone.STRONG
        return [line(Span(f"[ {self._label} ]", tone))]

    def on_click(self) -> None:
        """The mouse presses it."""
        self.action_press()

    def action_press(self) -> None:
        """Tell who listens."""
        self.post_message(self.Pressed())
