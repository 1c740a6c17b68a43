"""Small controls made of lines: a choice, a label, a button."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from rich.cells import cell_len
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.lines import (
    NAMED_KEYS,
    Line,
    Lines,
    Span,
    Target,
    Tone,
    line,
    paragraph,
    with_keys,
)

V = TypeVar("V")

_BACK, _ON = "back", "on"


class Choice(Lines, Generic[V], can_focus=True):
    """Left, right and space go through the values; nothing pops up."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False),
        Binding("right,space", "turn(1)", show=False),
    ]

    @dataclass
    class Changed(Message):
        """The referee chose another value."""

        choice: Choice[Any]

    def __init__(self, options: Sequence[tuple[str, V]], value: V, *, id: str) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self._options = list(options)
        self._index = 0
        self.value = value

    @property
    def value(self) -> V:
        return self._options[self._index][1]

    @value.setter
    def value(self, value: V) -> None:
        for index, (_, option) in enumerate(self._options):
            if option == value:
                self._index = index
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
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

    def take_click(self, target: str, _event: events.Click) -> None:
        self.action_turn(-1 if target == _BACK else 1)

    def action_turn(self, step: int) -> None:
        self._index = (self._index + step) % len(self._options)
        self.redraw()
        self.post_message(self.Changed(self))


class Label(Lines):
    """A text in one tone, on as many rows as it needs; `keys` are those that it names."""

    def __init__(
        self,
        text: str = "",
        tone: Tone = Tone.DIM,
        *,
        id: str | None = None,  # noqa: A002 - textual's name
        keys: Mapping[str, str] = NAMED_KEYS,
    ) -> None:
        super().__init__(id=id)
        self._text, self._named = text, keys
        self.tone = tone

    @property
    def text(self) -> str:
        return self._text

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        self._text, self.tone = text, tone
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        return with_keys(paragraph(self._text, width, self.tone), self._named)


class PushButton(Lines, can_focus=True):
    """Enter or space presses it."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter,space", "press", show=False)]

    class Pressed(Message):
        """It was pressed."""

    def __init__(self, label: str, *, id: str) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self.label = label

    def say(self, label: str) -> None:
        self.label = label
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        tone = Tone.CURSOR if self.has_focus else Tone.STRONG
        return [line(Span(f"[ {self.label} ]", tone))]

    def on_click(self, _event: events.Click) -> None:
        self.action_press()

    def action_press(self) -> None:
        self.post_message(self.Pressed())
