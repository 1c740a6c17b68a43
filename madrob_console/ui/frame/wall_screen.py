"""The screen of the wall display."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen

from madrob_console.archive.history import RunSummary
from madrob_console.errors import MadrobError
from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.frame.console_screen import BUSY_PERIOD
from madrob_console.ui.frame.wall import PAGE_TIME, Wall, WallRuns
from madrob_console.ui.link import EngineSearch

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.ui.link import EngineLink


class WallScreen(Screen[None]):
    """Nothing but the wall display; it takes no key but those that leave.

    Args:
        link: to the engine.
        load: reads all runs; called in a thread.
        monotonic: a clock for the pages, s.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,escape,f10,ctrl+q,ctrl+c", "app.quit", show=False)
    ]
    AUTO_FOCUS = ""

    def __init__(
        self,
        link: EngineLink,
        load: Callable[[], Sequence[RunSummary]],
        monotonic: Callable[[], float],
    ) -> None:
        super().__init__()
        self._link = link
        aside = partial(self.run_worker, thread=True, group="engine")
        self._search = EngineSearch(link, monotonic, aside)
        self._load = load
        self._monotonic = monotonic
        self._turned = monotonic()
        self._read_of: object = None
        self._wall = Wall()

    def compose(self) -> ComposeResult:
        """One widget."""
        yield self._wall

    def begin(self) -> None:
        """Poll the engine from now on."""
        self.set_interval(BUSY_PERIOD, self.poll)
        self.poll()

    def poll(self) -> None:
        """Show the latest snapshot; read all runs again when a result has come or changed."""
        snapshot = self._link.snapshot()
        if snapshot is None:
            return
        if snapshot.pulse.gone:
            self._search.look()
        run = snapshot.run
        if run.active:
            self._wall.page, self._turned = 0, self._monotonic()
        elif (now := self._monotonic()) - self._turned >= PAGE_TIME:
            self._wall.page += 1
            self._turned = now
        seen = (snapshot.result, run.issue, run.closure, snapshot.teams, snapshot.practice)
        if seen != self._read_of:
            self._read_of = seen
            self.run_worker(partial(self._read, snapshot), thread=True, exclusive=True)
        self._wall.show(snapshot)

    def _read(self, snapshot: Snapshot) -> None:
        """In a thread."""
        try:
            runs = self._load()
        except (MadrobError, OSError, MemoryError):
            return  # what was read before stays; the referee's screens say what is wrong
        self._wall.runs = WallRuns.of(runs, snapshot.teams.names, practice=snapshot.practice)
