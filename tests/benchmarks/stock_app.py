"""Textual as it comes, with as many widgets as the console, that changes its screen with a key.

Four panes behind each other, with what textual has for their purpose: a form, a live view, a
result and a page of help. A clock moves ten times a second, as in the console.
"""

from __future__ import annotations

import sys
from datetime import datetime
from typing import ClassVar

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, ContentSwitcher, Footer, Input, Label, Static

PERIOD = 0.1
FIELDS = 12
VIEWS = 12
OTHERS = 25
"""Widgets of the panes that no key of the benchmark shows."""

HELP = "\n".join(f"key {number:2}  what the key with this number does" for number in range(20))
ROW = "step  sensors  referee  counts"


class StockApp(App[None]):
    """F2, F3 and ? change the pane; ? again goes back."""

    CSS = "Input { height: 1; border: none; } .field { height: 1; } Label { width: 13; }"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f2", "show('form')", "form", priority=True),
        Binding("f3", "show('live')", "live", priority=True),
        Binding("question_mark", "show('help')", "help", priority=True),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._clock = Static()
        self._switcher = ContentSwitcher(initial="live")

    def compose(self) -> ComposeResult:
        """A line on top, the panes, the keys."""
        yield self._clock
        with self._switcher:
            with Vertical(id="form"):
                for number in range(FIELDS):
                    yield Horizontal(Label(f"field {number}"), Input("value"), classes="field")
                yield Button("Set up")
                yield from (Static(f"check {number} passed") for number in range(FIELDS))
            with Vertical(id="live"):
                yield from (Static(f"view {number}: {ROW}") for number in range(VIEWS))
            with VerticalScroll(id="help"):
                yield Static(f"this page\n{HELP}")
            with Vertical(id="others"):
                yield from (Static(f"{number}") for number in range(OTHERS))
        yield Footer()

    def on_mount(self) -> None:
        """Go on."""
        self.set_interval(PERIOD, self.tick)

    def tick(self) -> None:
        """The time with tenths, on top and in the live view."""
        now = datetime.now().astimezone()
        text = f"clock {now:%H:%M:%S}.{now.microsecond // 100_000}"
        self._clock.update(text)
        self.query_one("#live Static", Static).update(text)

    def action_show(self, name: str) -> None:
        """Another pane; help again goes back to the live view."""
        back = name == "help" and self._switcher.current == "help"
        self._switcher.current = "live" if back else name
        if self._switcher.current == "form":
            self.query_one(Input).focus()
        else:
            self.set_focus(None)


if __name__ == "__main__":
    app = StockApp()
    app.run(mouse=False)
    sys.exit(app.return_code or 0)
