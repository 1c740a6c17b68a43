"""The panes, made once the first screen can be seen: they are most of the program's imports."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.archive.history import History
from madrob_console.engine.requests import GiveCurves
from madrob_console.ui.link import ConsoleDefaults, EngineLink
from madrob_console.ui.panes.figures_pane import FiguresPane
from madrob_console.ui.panes.help_pane import HelpPane
from madrob_console.ui.panes.history_pane import HistoryPane
from madrob_console.ui.panes.live_pane import LivePane
from madrob_console.ui.panes.plan_pane import PlanPane, PlanReader
from madrob_console.ui.panes.result_pane import ResultsPane
from madrob_console.ui.panes.setup_pane import SetupPane
from madrob_console.ui.panes.standings_pane import StandingsPane

Pane = (
    SetupPane
    | LivePane
    | ResultsPane
    | FiguresPane
    | HistoryPane
    | PlanPane
    | StandingsPane
    | HelpPane
)


class Panes:
    """One of each, by name."""

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults) -> None:
        history = History(defaults.results)
        plan = PlanReader(link)
        self.setup = SetupPane(link, defaults, plan)
        self.live = LivePane()
        self.results = ResultsPane(history.refresh)
        self.figures = FiguresPane(lambda: link.answer(GiveCurves()))
        self.history = HistoryPane(history.refresh)
        self.plan = PlanPane(plan)
        self.standings = StandingsPane(history.refresh, defaults.best_runs)
        self.help = HelpPane()

    def __getitem__(self, name: str) -> Pane:
        pane: Pane = getattr(self, name)
        return pane

    def __iter__(self) -> Iterator[Pane]:
        return iter(vars(self).values())
