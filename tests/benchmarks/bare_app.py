"""The least that Textual can do: one text with a clock, ten times a second, and one key."""

from __future__ import annotations

import sys
from datetime import datetime
from typing import ClassVar

from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.widgets import Static

PERIOD = 0.1


class BareApp(App[None]):
    """A clock and the number of times that `k` was pressed."""

    BINDINGS: ClassVar[list[BindingType]] = [("k", "count", "count")]

    def __init__(self) -> None:
        super().__init__()
        self._pressed = 0
        self._text = Static()

    def compose(self) -> ComposeResult:
        """One text."""
        yield self._text

    def on_mount(self) -> None:
        """Go on."""
        self.show()
        self.set_interval(PERIOD, self.show)

    def show(self) -> None:
        """The time with tenths."""
        now = datetime.now().astimezone()
        self._text.update(
            f"clock {now:%H:%M:%S}.{now.microsecond // 100_000} keys {self._pressed}."
        )

    def action_count(self) -> None:
        """One more."""
        self._pressed += 1
        self.show()


if __name__ == "__main__":
    app = BareApp()
    app.run(mouse=False)
    sys.exit(app.return_code or 0)
