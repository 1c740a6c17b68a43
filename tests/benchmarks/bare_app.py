"""The least that Textual can do: a clock, ten times a second; `--widgets`: in many widgets."""

from __future__ import annotations

import sys
from datetime import datetime

from textual.app import App, ComposeResult
from textual.widgets import Static

PERIOD = 0.1
WIDGETS = 20


class BareApp(App[None]):
    """So many texts with a clock."""

    def __init__(self, widgets: int) -> None:
        super().__init__()
        self._texts = [Static() for _ in range(widgets)]

    def compose(self) -> ComposeResult:
        yield from self._texts

    def on_mount(self) -> None:
        self.show()
        self.set_interval(PERIOD, self.show)

    def show(self) -> None:
        now = datetime.now().astimezone()
        for number, text in enumerate(self._texts):
            text.update(f"clock {now:%H:%M:%S}.{now.microsecond // 100_000}  view {number:2}")


if __name__ == "__main__":
    app = BareApp(WIDGETS if "--widgets" in sys.argv else 1)
    app.run(mouse=False)
    sys.exit(app.return_code or 0)
