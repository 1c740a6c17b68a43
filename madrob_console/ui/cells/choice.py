"""One of a few values, on one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Generic, TypeVar

from rich.cells import cell_len
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.lines import Line, Lines, Span, Target, Tone, line

V = TypeVar("V")

_BACK, _ON = "back", "on"


class Choice(Lines, Generic[V], can_focus=True):
    """Left, right and space go through the values; nothing pops up.

    Args:
        options: the values with their labels, in order.
        value: the one to begin with.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False),
        Binding("right,space", "turn(1)", show=False),
    ]

    class Changed(Message):
        """The referee chose another value."""

        def __init__(self, choice: Choice[Any]) -> None:
            super().__init__()
            self.choice = choice

    def __init__(self, options: Sequence[tuple[str, V]], value: V, *, id: str) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self._options = list(options)
        self._index = 0
        self.value = value

    @property
    def value(self) -> V:
        """The value chosen now."""
        return self._options[self._index][1]

    @value.setter
    def value(self, value: V) -> None:
        for index, (_, known) in enumerate(self._options):
            if known == value:
                self._index = index
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        """The label between arrows; where it stands in a list of more than two."""
        label = self._options[self._index][0]
        focused = self.has_focus
        place = f" {self._index + 1}/{len(self._options)}"
        few = len(self._options) < 3  # and "1/2" reads like an attempt
        if few or not focused or cell_len(label) + 4 + len(place) > width:
            place = ""
        return [
            line(
                Target("< ", Tone.STRONG if focused else Tone.DIM, _BACK),
                Target(label, Tone.CURSOR if focused else Tone.PLAIN, _ON),
                Target(" >", Tone.STRONG if focused else Tone.DIM, _ON),
                Span(place, Tone.DIM),
            )
        ]

    def on_click(self, event: events.Click) -> None:
        """The left arrow goes back, the rest goes on."""
        if (hit := self.clicked(event)) is not None:
            self.action_turn(-1 if hit[0] == _BACK else 1)

    def action_turn(self, step: int) -> None:
        """Go to the next or previous value, around the end."""
        self._index = (self._index + step) % len(self._options)
        self.redraw()
        self.post_message(self.Changed(self))
