"""How much of the competition's plan is done, as far as this screen knows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from madrob_console.engine.shown.requests import GivePlan
from madrob_console.errors import MadrobError
from madrob_console.referee.competition_plan import PlanProgress
from madrob_console.ui.panes.runs_pane import results_state

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.ui.link import EngineLink


class PlanReader:
    """Asks the engine again when the plan, or the result of a run, has changed.

    Args:
        link: to the engine.

    Attributes:
        progress: the latest answer.
        problem: why there is no later one, in words; empty = this is the latest.
        version: counts the answers.
    """

    def __init__(self, link: EngineLink) -> None:
        self._link = link
        self._seen: object = None
        self._asked = 0
        self._answered = 0
        self._wanted = 0
        self.progress = PlanProgress()
        self.problem = ""
        self.version = 0

    def is_old(self, snapshot: Snapshot) -> bool:
        """Whether to read again; says so once for each change."""
        seen = (snapshot.plan, results_state(snapshot))
        old, self._seen = seen != self._seen, seen
        if old:
            self._wanted = self._asked + 1
        return old

    @property
    def behind(self) -> bool:
        """Whether something has changed since the latest answer."""
        return self._answered < self._wanted

    async def read(self) -> None:
        """Ask; the answer to the latest question counts."""
        self._asked += 1
        number = self._asked
        progress, problem = self.progress, ""
        try:
            progress = await self._link.answer(GivePlan())
        except MadrobError as error:
            problem = str(error)
        if number > self._answered:
            self._answered = number
            self.progress, self.problem = progress, problem
            self.version += 1
