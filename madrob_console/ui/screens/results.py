"""The results pane: what the run scored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import Container, VerticalScroll

from madrob_console.ui.widgets.indicator_table import IndicatorTable
from madrob_console.ui.widgets.lines import View
from madrob_console.ui.widgets.quality_table import QualityTable
from madrob_console.ui.widgets.result_head import ResultHead
from madrob_console.ui.widgets.run_marks import RunMarks
from madrob_console.ui.widgets.step_table import StepTable

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot


class ResultsPane(VerticalScroll):
    """Outcome, indicators, capability, data quality, marks, files; arrows scroll."""

    def __init__(self) -> None:
        super().__init__(id="results")
        self._shown: tuple[float | None, int] = (None, 0)
        self._views: tuple[View, ...] = (
            ResultHead(),
            IndicatorTable(),
            StepTable(of_result=True),
            QualityTable(),
            RunMarks(),
        )

    def compose(self) -> ComposeResult:
        """Top to bottom; indicators and steps side by side where there is room."""
        head, indicators, steps, quality, marks = self._views
        yield head
        yield Container(indicators, steps, classes="columns")
        yield quality
        yield marks

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot; another result begins at its top."""
        shown = (snapshot.run.start, snapshot.run.issue)
        if shown != self._shown:
            self._shown = shown
            self.scroll_home(animate=False)
        for view in self._views:
            view.show(snapshot)
