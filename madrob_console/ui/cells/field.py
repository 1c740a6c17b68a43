"""Text fields on one line that do not blink."""

from __future__ import annotations

from dataclasses import dataclass

from textual import events
from textual.binding import Binding
from textual.message import Message
from textual.widgets import Input

from madrob_console.common.names import terminal_safe

_EDITING = {
    binding.key: binding.action
    for binding in Binding.make_bindings(Input.BINDINGS)
    if binding.action.startswith(("cursor_", "home", "end", "delete_"))
}
_OF_NUMBERS = "0123456789.,+-eE "


class Field(Input):
    """A compact input; pasted line breaks become blanks instead of cutting the text."""

    def __init__(self, *, id: str | None = None, select_on_focus: bool = True) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id, select_on_focus=select_on_focus, compact=True)
        self.cursor_blink = False

    async def on_key(self, event: events.Key) -> None:
        # textual lets the screen see these keys first: a letter typed meanwhile would overtake them
        if (action := _EDITING.get(event.key)) is not None:
            event.prevent_default()
            event.stop()
            await self.run_action(action)

    def on_blur(self) -> None:
        """Shows the beginning of a long text; coming back selects it all."""
        if self.select_on_focus:
            self.cursor_position = 0

    def on_paste(self, event: events.Paste) -> None:
        # Input itself keeps only the first line: what follows would be lost without a word
        text = terminal_safe(event.text.strip())
        if text:
            self.replace(text, *self.selection)
        event.prevent_default()
        event.stop()


class NumberField(Field):
    """A field that refuses letters, and says so."""

    @dataclass
    class Refused(Message):
        """A letter was typed into the field of that name."""

        field: str
        letter: str

    async def on_key(self, event: events.Key) -> None:
        char = event.character
        if event.is_printable and char is not None and char not in _OF_NUMBERS:
            event.prevent_default()
            event.stop()
            self.post_message(self.Refused((self.id or "").replace("-", " "), char))
