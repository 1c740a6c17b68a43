"""A text field on one line that does not blink."""

from __future__ import annotations

from textual import events
from textual.widgets import Input

from madrob_console.names import terminal_safe


class Field(Input):
    """A compact input; pasted line breaks become blanks instead of cutting the text."""

    def __init__(self, *, id: str | None = None, select_on_focus: bool = True) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id, select_on_focus=select_on_focus, compact=True)
        self.cursor_blink = False

    def on_blur(self) -> None:
        """Show the beginning of a long text, where coming back selects it all."""
        if self.select_on_focus:
            self.cursor_position = 0

    def _on_paste(self, event: events.Paste) -> None:
        # Input itself keeps only the first line: what follows would be lost without a word
        text = terminal_safe(event.text.strip())
        if text:
            self.replace(text, *self.selection)
        event.prevent_default()
        event.stop()
