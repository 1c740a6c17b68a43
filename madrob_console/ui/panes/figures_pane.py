"""The figures pane: the curves behind a result."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType

from madrob_console.common.errors import MadrobError
from madrob_console.engine.curves import Curves
from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.axes import Window
from madrob_console.ui.cells.lines import Line, Lines, Tone, paragraph
from madrob_console.ui.panes.figure_sheet import FIGURES, Sheet
from scoring.protocol import Outcome

SHORTEST_WINDOW = 0.2
"""The least time that is shown, s."""

READING = "reading the curves ..."
NO_RESULT = "no result yet: the figures come with it"

_ZOOM = 1.5
_STEP = 0.25


class FiguresPane(Lines, can_focus=True):
    """One figure at a time, zoomable in time; `load` may take a while."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1)", show=False),
        Binding("right", "move(1)", show=False),
        Binding("up,plus,equals_sign", "zoom(1)", show=False),
        Binding("down,minus", "zoom(-1)", show=False),
        Binding("0,home", "show_all", show=False),
        Binding("space,right_square_bracket", "turn(1)", show=False),
        Binding("left_square_bracket", "turn(-1)", show=False),
    ]

    def __init__(self, load: Callable[[], Awaitable[Curves | None]]) -> None:
        super().__init__(id="figures")
        self._load = load
        self._snapshot: Snapshot | None = None
        self._shown: tuple[float | None, int] | None = None
        self._loaded: Curves | str | None = READING
        self._figure = 0
        self._window: Window | None = None

    def enter(self) -> None:
        self.focus()
        self._request()

    def show(self, snapshot: Snapshot) -> None:
        shown = (snapshot.run.start, snapshot.run.issue)
        if shown == self._shown:
            return
        if self._shown is None or shown[0] != self._shown[0]:
            self._window, self._loaded = None, READING
        self._snapshot, self._shown = snapshot, shown
        self._request()

    def _request(self) -> None:
        self._read()
        self.redraw()

    @work(exclusive=True)
    async def _read(self) -> None:
        try:
            self._loaded = await self._load()
        except (MadrobError, OSError, MemoryError) as error:
            self._loaded = str(error) or "no memory"
        self.redraw()

    def action_move(self, way: int) -> None:
        if (window := self._window) is not None:
            self._look(window.middle + way * _STEP * window.width, window.width)

    def action_zoom(self, way: int) -> None:
        window = self._window or self._whole()
        self._look(window.middle, window.width / _ZOOM**way)

    def action_show_all(self) -> None:
        self._window = None
        self.redraw()

    def action_turn(self, way: int) -> None:
        self._figure = (self._figure + way) % len(FIGURES)
        self.redraw()

    def _whole(self) -> Window:
        curves = self._loaded
        first, last = curves.extent if isinstance(curves, Curves) else (0.0, 0.0)
        return Window(first, max(last, first + SHORTEST_WINDOW))

    def _look(self, middle: float, width: float) -> None:
        """Shows `width` s around `middle`, as far as there is that much."""
        whole = self._whole()
        width = max(SHORTEST_WINDOW, width)
        if width >= whole.width:
            self._window = None
        else:
            start = min(max(middle - width / 2, whole.start), whole.end - width)
            self._window = Window(start, start + width)
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        loaded, snapshot = self._loaded, self._snapshot
        if loaded == READING or snapshot is None:
            return paragraph(READING, width, Tone.DIM)
        if isinstance(loaded, str):
            return paragraph(loaded, width, Tone.BAD)
        if loaded is None:
            return paragraph(NO_RESULT, width, Tone.DIM)
        if loaded.empty:
            return paragraph(_nothing(snapshot), width, Tone.WARN)
        sheet = Sheet(self._figure, loaded, snapshot, self._window or self._whole())
        return sheet.lines(width, self.room.height)


def _nothing(snapshot: Snapshot) -> str:
    if snapshot.run.outcome is Outcome.ABORTED:
        return "no figures: the run was aborted and is invalid"
    return "no figures: nothing was recorded of door and handle during the run"
