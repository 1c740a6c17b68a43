"""The one screen: panes between what is always visible."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import Screen
from textual.widgets import ContentSwitcher

from madrob_console.ui.questions import Ask
from madrob_console.ui.screens.help import HelpPane
from madrob_console.ui.screens.live import LivePane
from madrob_console.ui.screens.results import ResultsPane
from madrob_console.ui.screens.setup import SetupPane
from madrob_console.ui.widgets.dialog import Dialog
from madrob_console.ui.widgets.fault_line import FaultLine
from madrob_console.ui.widgets.key_line import KeyLine
from madrob_console.ui.widgets.label import Label
from madrob_console.ui.widgets.lines import TONE_CLASSES, Tone
from madrob_console.ui.widgets.top_line import TopLine

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.defaults import ConsoleDefaults
    from madrob_console.ui.link import EngineLink

TOP_LINE_EVERY = 4
"""Every fourth snapshot reaches the top line: its counters change with every one."""


class ConsoleScreen(Screen[None]):
    """Top line, faults, one pane, status, keys; dialogs over the lower part of the pane.

    Attributes:
        pane: the name of the pane shown.
        dialogs: those that are open, the front one last.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    AUTO_FOCUS = ""

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults) -> None:
        super().__init__()
        self._top = TopLine(defaults.competition)
        self._faults = FaultLine()
        self.setup = SetupPane(link, defaults)
        self._panes: dict[str, SetupPane | LivePane | ResultsPane | HelpPane] = {
            "setup": self.setup,
            "live": LivePane(),
            "results": ResultsPane(),
            "help": HelpPane(),
        }
        self._switcher = ContentSwitcher(*self._panes.values(), initial="setup")
        self._status = Label("F1 lists the keys.", id="status-line")
        self._keys = KeyLine()
        self._latest: Snapshot | None = None
        self._count = 0
        self._was_active = False
        self._was_written = False
        self._behind_help = "setup"
        self.pane = "setup"
        self.dialogs: list[Dialog] = []

    def compose(self) -> ComposeResult:
        """Top to bottom."""
        yield self._top
        yield self._faults
        yield Container(self._switcher, id="body")
        yield self._status
        yield self._keys

    @property
    def status(self) -> str:
        """The message shown."""
        return self._status.text

    def show(self, snapshot: Snapshot, trouble: str | None = None) -> None:
        """Show a newer snapshot; `trouble` says why it cannot be trusted."""
        self._follow(snapshot)
        self._latest = snapshot
        self._faults.trouble = trouble
        self._faults.show(snapshot)
        self._keys.show(snapshot)
        if self._count % TOP_LINE_EVERY == 0:
            self._top.show(snapshot)
        self._count += 1
        self._panes[self.pane].show(snapshot)
        if self.pane != "setup":
            self.setup.follow(snapshot)

    def show_pane(self, name: str) -> None:
        """Switch to a pane; the help goes back to where it came from."""
        if name == self.pane == "help":
            name = self._behind_help
        elif name == "help":
            self._behind_help = self.pane
        self._switcher.current = self.pane = name
        self._keys.pane = name
        self.take_focus()
        if self._latest is not None:
            self._panes[name].show(self._latest)
            self._keys.show(self._latest)

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Show a message until the next one."""
        self._status.say(text, tone)

    def take_focus(self) -> None:
        """Give the focus to what is in front."""
        if self.dialogs:
            self.dialogs[-1].take_focus()
        elif self.pane == "setup":
            self.setup.enter()
        elif self.pane == "live":
            self.set_focus(None)
        else:
            self.set_focus(self._panes[self.pane])

    async def open(self, name: str, ask: Ask) -> None:
        """Open a dialog in front of everything."""
        dialog = Dialog(name, ask)
        self.dialogs.append(dialog)
        await self.query_one("#body").mount(dialog)
        dialog.take_focus()

    async def close(self, dialog: Dialog) -> None:
        """Close a dialog; the focus goes to what was behind it."""
        if dialog in self.dialogs:
            self.dialogs.remove(dialog)
            await dialog.remove()
            self.take_focus()

    def _follow(self, now: Snapshot) -> None:
        """Live when a countdown begins, results when one is written; not under a dialog."""
        if self.dialogs:
            return
        active, written = now.run.active, now.result is not None
        attached = self._latest is None
        if active and not self._was_active:
            self.show_pane("live")
        elif written and not self._was_written and (attached or self.pane == "live"):
            self.show_pane("results")
            if self._status.tone is not Tone.BAD:  # a refusal is the greater news
                self.say("The result is written: f finalises it, x the next run, PgDn shows more.")
        self._was_active, self._was_written = active, written
