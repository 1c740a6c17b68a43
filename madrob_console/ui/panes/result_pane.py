"""The results pane: what the run scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from textual import events
from textual.app import ComposeResult
from textual.containers import Container, VerticalScroll

from madrob_console.archive.folders import PICTURES_FOLDER, pictures_in
from madrob_console.archive.history import earlier_runs
from madrob_console.errors import MadrobError
from madrob_console.ui.cells.lines import View, plain
from madrob_console.ui.panes.quality_table import QualityTable
from madrob_console.ui.panes.result_head import ResultHead
from madrob_console.ui.panes.result_indicators import IndicatorTable
from madrob_console.ui.panes.run_marks import RunMarks
from madrob_console.ui.panes.step_table import StepTable
from scoring.protocol import Condition

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.referee.run_setup import RunSetup

_BESIDE = 114
"""Cells that indicators and steps take beside each other, with what is between them."""


_LOOKS_EVERY = 3.0  # s
_COPIED = 100
"""Columns of the result as text."""

_Shown = tuple[float | None, int, tuple[int, Condition] | None]
"""Start and issue of a result, and as which subject and condition it counts."""


class ResultsPane(VerticalScroll):
    """Outcome, indicators, capability, marks, files, data quality; arrows scroll.

    Args:
        load: all runs of the competition; may take a moment.
    """

    def __init__(self, load: Callable[[], Sequence[RunSummary]]) -> None:
        super().__init__(id="results")
        self._load = load
        self._shown: _Shown = (None, 0, None)
        self._indicators = IndicatorTable()
        self._marks = RunMarks()
        self._folder = ""
        self._looking = False
        self._views: tuple[View, ...] = (
            ResultHead(),
            self._indicators,
            StepTable(of_result=True),
            self._marks,
            QualityTable(),
        )

    def compose(self) -> ComposeResult:
        """Top to bottom; indicators and steps side by side where there is room."""
        head, indicators, steps, marks, quality = self._views
        yield head
        yield Container(indicators, steps, classes="columns")
        yield marks
        yield quality

    def on_mount(self) -> None:
        """A report is made some time after the result, and its pictures with it."""
        self.set_interval(_LOOKS_EVERY, self._look_for_pictures)

    @property
    def pictures(self) -> str:
        """The folder with what the cameras saw of the run that is shown; empty = there is none."""
        return f"{self._folder}/{PICTURES_FOLDER}" if self._marks.pictures else ""

    def on_resize(self, _event: events.Resize) -> None:
        """Side by side only where both tables are whole."""
        self.set_class(self.scrollable_content_region.width >= _BESIDE, "-beside")

    def enter(self) -> None:
        """Arrows scroll."""
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot; another result begins at its top."""
        result = snapshot.result
        run, setup = snapshot.run, snapshot.run.setup
        series = None if setup is None else (setup.subject, setup.condition)
        shown = (None if result is None else result.start, run.issue, series)
        if shown != self._shown:
            self._shown = shown
            self.scroll_home(animate=False)
            self._indicators.earlier = ()
            official = snapshot.result is not None and snapshot.playback is None
            if official and setup is not None:
                self._compare(snapshot, setup)
        folder = "" if result is None else snapshot.folder or ""
        if folder != self._folder:
            self._folder, self._marks.pictures = folder, 0
            self._look_for_pictures()
        for view in self._views:
            view.show(snapshot)

    @property
    def copied(self) -> str:
        """All of it as text."""
        return "\n\n".join(filter(None, (plain(view.lines(_COPIED)) for view in self._views)))

    def _compare(self, snapshot: Snapshot, setup: RunSetup) -> None:
        """Look up the team's earlier runs in the same condition, off the loop."""
        result, practice, shown = snapshot.result, snapshot.practice, self._shown
        assert result is not None

        def look_up() -> None:
            try:
                runs = earlier_runs(
                    self._load(),
                    setup.subject,
                    setup.condition.number,
                    result.start,
                    competition=setup.competition,
                    practice=practice,
                    ruleset=result.ruleset,
                )
            except (MadrobError, OSError, MemoryError):
                return  # the history says what is wrong with the folder
            self.call_later(self._show_earlier, shown, runs)

        self.run_worker(look_up, thread=True, exclusive=True)

    def _look_for_pictures(self) -> None:
        """Off the loop: a disk may hang. Then nobody looks again."""
        folder = self._folder
        if not folder or self._looking:
            return
        self._looking = True

        def look() -> None:
            self.call_later(self._show_pictures, folder, pictures_in(folder))

        self.run_worker(look, thread=True, group="pictures")

    def _show_pictures(self, folder: str, count: int) -> None:
        self._looking = False
        if folder == self._folder and count != self._marks.pictures:
            self._marks.pictures = count
            self._marks.redraw()

    def _show_earlier(self, of: _Shown, runs: Sequence[RunSummary]) -> None:
        if of == self._shown:
            self._indicators.earlier = runs
            self._indicators.redraw()
