"""The team of a set-up where there is a list of teams: chosen, not typed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from rich.cells import cell_len
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.names import terminal_safe
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line
from madrob_console.ui.look.words import fitted


class TeamLine(Lines, can_focus=True):
    """The team's name. What is typed here looks for a team in the list."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("delete,backspace", "clear", show=False),
    ]

    class Typed(Message):
        """The referee looks for a team."""

        def __init__(self, text: str) -> None:
            super().__init__()
            self.text = text

    class Cleared(Message):
        """The list's name shall stand here again."""

    _team = ""
    _other = False

    def say(self, name: str, *, other: bool) -> None:
        """Show a name.

        Args:
            name: empty = the team is not in the list.
            other: it is another one than the list has.
        """
        self._team, self._other = name, other
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        """The name, and that it is another one than the list's."""
        mark = " OTHER" if self._other else ""
        name, room = self._team or "(not in the list)", max(1, width - len(mark))
        tone = Tone.PLAIN if self._team and not self._other else Tone.WARN
        return [
            line(
                Span(
                    name if cell_len(name) <= room else fitted(name, room),
                    Tone.CURSOR if self.has_focus else tone,
                ),
                Span(mark, Tone.WARN),
            )
        ]

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """No letter that is typed here is a key of the console."""
        return character is not None and character.isprintable()

    def on_key(self, event: events.Key) -> None:
        """Look for a team."""
        if event.is_printable and event.character:
            event.stop()
            event.prevent_default()
            self.post_message(self.Typed(event.character))

    def on_paste(self, event: events.Paste) -> None:
        """The same."""
        event.stop()
        self.post_message(self.Typed(terminal_safe(event.text.strip())))

    def on_click(self, _event: events.Click) -> None:
        """The mouse asks for the list."""
        self.post_message(self.Typed(""))

    def action_clear(self) -> None:
        """Tell who listens."""
        self.post_message(self.Cleared())
