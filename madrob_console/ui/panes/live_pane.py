"""The live pane: the run as it goes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import Horizontal, VerticalScroll

from madrob_console.ui.cells.lines import View
from madrob_console.ui.panes.all_faults import AllFaults
from madrob_console.ui.panes.banner import Banner
from madrob_console.ui.panes.door_gauge import DoorGauge
from madrob_console.ui.panes.evidence_line import EvidenceLine
from madrob_console.ui.panes.handle_gauge import HandleGauge
from madrob_console.ui.panes.log_view import LogView
from madrob_console.ui.panes.passage import Passage
from madrob_console.ui.panes.provisional import Provisional
from madrob_console.ui.panes.run_clock import RunClock, RunTenths
from madrob_console.ui.panes.run_status import RunStatus
from madrob_console.ui.panes.step_table import StepTable

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_SLOW = 3
"""Every third snapshot reaches what costs many bytes and need not be quick."""


class LivePane(VerticalScroll):
    """Clock, steps, sensors, what is known so far, faults, log; arrows scroll what is too long."""

    def __init__(self) -> None:
        super().__init__(id="live")
        self._quick: tuple[View, ...] = (
            RunClock(),
            RunTenths(),
            RunStatus(),
            Banner(),
            StepTable(),
            Passage(),
            DoorGauge(),
            HandleGauge(),
            AllFaults(),
        )
        self._slow: tuple[View, ...] = (Provisional(), EvidenceLine(), LogView())
        self._count = 0

    def compose(self) -> ComposeResult:
        """Top to bottom."""
        clock, tenths, summary, banner, steps, passage, door, handle, faults = self._quick
        so_far, evidence, log = self._slow
        yield Horizontal(clock, tenths, summary, classes="row")
        yield banner
        yield Horizontal(steps, passage, classes="row")
        yield Horizontal(door, handle, classes="row")
        yield so_far
        yield evidence
        yield faults
        yield log

    def enter(self) -> None:
        """No field has the focus: the letters are keys, arrows scroll."""
        self.scroll_home(animate=False)
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot."""
        for view in self._quick:
            view.show(snapshot)
        if self._count % _SLOW == 0:
            for view in self._slow:
                view.show(snapshot)
        self._count += 1
