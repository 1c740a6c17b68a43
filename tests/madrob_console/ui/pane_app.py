"""One pane alone on a screen, as the console would show it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import ClassVar

from textual.app import App, ComposeResult
from textual.containers import Container
from textual.message import Message
from textual.pilot import Pilot
from textual.screen import Screen

from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.panes.history_pane import HistoryPane
from madrob_console.ui.panes.runs_pane import RunsPane
from madrob_console.ui.panes.standings_pane import StandingsPane
from tests.madrob_console.ui.drawn import drawn

PANE = (80, 19)
"""What a terminal of 80x24 leaves to a pane."""


class PaneScreen(Screen[None]):
    """Holds the pane."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    AUTO_FOCUS = ""

    def __init__(self, pane: HistoryPane | StandingsPane) -> None:
        super().__init__()
        self.pane = pane

    def compose(self) -> ComposeResult:
        yield Container(self.pane, id="body")


class PaneApp(App[None]):
    """Keeps the messages that a pane sends to the console."""

    CSS_PATH = MadrobApp.CSS_PATH
    HORIZONTAL_BREAKPOINTS = MadrobApp.HORIZONTAL_BREAKPOINTS
    VERTICAL_BREAKPOINTS = MadrobApp.VERTICAL_BREAKPOINTS

    def __init__(self, pane: HistoryPane | StandingsPane) -> None:
        super().__init__()
        self.pane_screen = PaneScreen(pane)
        self.sent: list[Message] = []

    def get_default_screen(self) -> Screen[None]:
        return self.pane_screen

    def on_runs_pane_opened(self, event: RunsPane.Opened) -> None:
        self.sent.append(event)


@dataclass
class Shown:
    """A pane that has been entered."""

    app: PaneApp
    pilot: Pilot[None]

    async def settle(self) -> None:
        """What is being read is shown."""
        await self.app.workers.wait_for_complete()
        await self.pilot.pause()
        await drawn(self.pilot)

    async def press(self, *keys: str) -> None:
        """Press keys and let the pane follow."""
        await self.pilot.press(*keys)
        await self.settle()

    def rows(self) -> list[str]:
        """The screen as text."""
        width, height = self.app.size
        strips = self.app.screen._compositor.render_strips()
        return [strip.text[:width].rstrip() for strip in strips[:height]]

    @property
    def text(self) -> str:
        return "\n".join(self.rows())

    @property
    def marked(self) -> str:
        """The row under the mark."""
        return next(row for row in self.rows() if row.lstrip().startswith("> "))


@asynccontextmanager
async def showing(
    pane: HistoryPane | StandingsPane, size: tuple[int, int] = PANE
) -> AsyncIterator[Shown]:
    """The pane, entered."""
    app = PaneApp(pane)
    async with app.run_test(size=size) as pilot:
        pane.enter()
        shown = Shown(app, pilot)
        await shown.settle()
        yield shown
