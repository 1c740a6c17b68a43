"""The results pane: what the run scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import Container, VerticalScroll

from madrob_console.archive.history import earlier_runs
from madrob_console.errors import MadrobError
from madrob_console.ui.cells.lines import View
from madrob_console.ui.panes.quality_table import QualityTable
from madrob_console.ui.panes.result_head import ResultHead
from madrob_console.ui.panes.result_indicators import IndicatorTable
from madrob_console.ui.panes.run_marks import RunMarks
from madrob_console.ui.panes.step_table import StepTable

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.referee.run import RunSetup


class ResultsPane(VerticalScroll):
    """Outcome, indicators, capability, data quality, marks, files; arrows scroll.

    Args:
        load: all runs of the competition; may take a moment.
    """

    def __init__(self, load: Callable[[], Sequence[RunSummary]]) -> None:
        super().__init__(id="results")
        self._load = load
        self._shown: tuple[float | None, int] = (None, 0)
        self._indicators = IndicatorTable()
        self._views: tuple[View, ...] = (
            ResultHead(),
            self._indicators,
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

    def enter(self) -> None:
        """Arrows scroll."""
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot; another result begins at its top."""
        result = snapshot.result
        shown = (None if result is None else result.start, snapshot.run.issue)
        if shown != self._shown:
            self._shown = shown
            self.scroll_home(animate=False)
            self._indicators.earlier = ()
            official = snapshot.result is not None and snapshot.playback is None
            if official and snapshot.run.setup is not None:
                self._compare(snapshot, snapshot.run.setup)
        for view in self._views:
            view.show(snapshot)

    def _compare(self, snapshot: Snapshot, setup: RunSetup) -> None:
        """Look up the team's earlier runs in the same condition, off the loop."""
        result, source = snapshot.result, snapshot.result_source
        assert result is not None

        def look_up() -> None:
            try:
                runs = earlier_runs(
                    self._load(),
                    setup.subject,
                    setup.condition.number,
                    result.start,
                    source=source,
                    ruleset=result.ruleset,
                )
            except MadrobError:
                return  # the history says what is wrong with the folder
            self.call_later(self._show_earlier, result.start, runs)

        self.run_worker(look_up, thread=True, exclusive=True)

    def _show_earlier(self, start: float, runs: Sequence[RunSummary]) -> None:
        if start == self._shown[0]:
            self._indicators.earlier = runs
            self._indicators.redraw()
