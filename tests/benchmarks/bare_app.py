"""The least that Textual can do: a clock, ten times a second, and how many keys came.

With `--widgets` it is in as many widgets as the console has.
"""

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
        self._keys = 0

    def compose(self) -> ComposeResult:
        yield from self._texts

    def on_mount(self) -> None:
        self.show()
        self.set_interval(PERIOD, self.show)

    def on_key(self) -> None:
        self._keys += 1
        self.show()

    def show(self) -> None:
        now = datetime.now().astimezone()
        for number, text in enumerate(self._texts):
            clock = f"{now:%H:%M:%S}.{now.microsecond // 100_000}"
            text.update(f"clock {clock}  view {number:2}  key {self._keys - 1}")


if __name__ == "__main__":
    app = BareApp(WIDGETS if "--widgets" in sys.argv else 1)
    app.run(mouse=False)
    sys.exit(app.return_code or 0)
