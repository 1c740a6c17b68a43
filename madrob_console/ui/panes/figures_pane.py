"""The figures pane: the curves behind a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.message import Message

from madrob_console.errors import MadrobError
from madrob_console.ui.cells.axes import Window
from madrob_console.ui.cells.lines import Line, Lines, Tone, paragraph
from madrob_console.ui.cells.plot import ASCII, BRAILLE
from madrob_console.ui.panes.figure import FIGURES, Sheet
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.shown.curves import Curves
    from madrob_console.engine.shown.snapshot import Snapshot

SHORTEST_WINDOW = 0.2
"""The least time that is shown, s."""

READING = "reading the curves ..."
NO_RESULT = "no result yet: the figures come with it"

_ZOOM = 1.5
_STEP = 0.25


class FigureView(Lines):
    """One figure, or a message, in all the room there is."""

    content: Sheet | tuple[str, Tone] = (READING, Tone.DIM)

    def lines(self, width: int) -> Sequence[Line]:
        """What fits."""
        if isinstance(self.content, Sheet):
            ink = ASCII if self.ascii_only else BRAILLE
            return self.content.lines(width, self.room.height, ink)
        text, tone = self.content
        return paragraph(text, width, tone)


class FiguresPane(Vertical, can_focus=True):
    """One figure at a time, zoomable in time.

    Args:
        load: gives the curves of the run with a result; None without one. May take a while and
            is called in a thread.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1)", show=False),
        Binding("right", "move(1)", show=False),
        Binding("up,plus,equals_sign", "zoom(1)", show=False),
        Binding("down,minus", "zoom(-1)", show=False),
        Binding("0,home", "show_all", show=False),
        Binding("tab,space,right_square_bracket", "turn(1)", show=False),
        Binding("shift+tab,left_square_bracket", "turn(-1)", show=False),
    ]

    @dataclass
    class Loaded(Message):
        """What the thread has read; `number` says for which request."""

        number: int
        curves: Curves | None
        trouble: str = ""

    def __init__(self, load: Callable[[], Curves | None]) -> None:
        super().__init__(id="figures")
        self._load = load
        self._view = FigureView()
        self._snapshot: Snapshot | None = None
        self._shown: tuple[float | None, int] | None = None
        self._loaded: FiguresPane.Loaded | None = None
        self._requests = 0
        self._figure = 0
        self._window: Window | None = None

    def compose(self) -> ComposeResult:
        """All of it."""
        yield self._view

    def enter(self) -> None:
        """Take the focus and read the curves again."""
        self.focus()
        self._request()

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot; the curves are read again where the result is another one."""
        shown = (snapshot.run.start, snapshot.run.issue)
        if shown == self._shown:
            return
        if self._shown is None or shown[0] != self._shown[0]:
            self._window = self._loaded = None
        self._snapshot, self._shown = snapshot, shown
        self._request()

    def _request(self) -> None:
        self._requests += 1
        number = self._requests
        self.run_worker(lambda: self._read(number), thread=True)
        self._redraw()

    def _read(self, number: int) -> None:
        """In the thread: it must not wait for the screens."""
        try:
            loaded = self.Loaded(number, self._load())
        except (MadrobError, OSError, MemoryError) as error:
            loaded = self.Loaded(number, None, str(error) or "no memory")
        self.post_message(loaded)

    def on_figures_pane_loaded(self, event: Loaded) -> None:
        """Draw what the latest request brought."""
        if event.number == self._requests:
            self._loaded = event
            self._redraw()

    def action_move(self, way: int) -> None:
        """Earlier or later, by a quarter of what is shown."""
        if (window := self._window) is not None:
            self._look(window.middle + way * _STEP * window.width, window.width)

    def action_zoom(self, way: int) -> None:
        """Into the middle of what is shown, or out of it."""
        window = self._window or self._whole()
        self._look(window.middle, window.width / _ZOOM**way)

    def action_show_all(self) -> None:
        """The whole run."""
        self._window = None
        self._redraw()

    def action_turn(self, way: int) -> None:
        """The next or previous figure."""
        self._figure = (self._figure + way) % len(FIGURES)
        self._redraw()

    def _whole(self) -> Window:
        curves = None if self._loaded is None else self._loaded.curves
        first, last = (0.0, 0.0) if curves is None else curves.extent
        return Window(first, max(last, first + SHORTEST_WINDOW))

    def _look(self, middle: float, width: float) -> None:
        """Show `width` s around `middle`, as far as there is that much."""
        whole = self._whole()
        width = max(SHORTEST_WINDOW, width)
        if width >= whole.width:
            self._window = None
        else:
            start = min(max(middle - width / 2, whole.start), whole.end - width)
            self._window = Window(start, start + width)
        self._redraw()

    def _redraw(self) -> None:
        self._view.content = self._content()
        self._view.redraw()

    def _content(self) -> Sheet | tuple[str, Tone]:
        loaded, snapshot = self._loaded, self._snapshot
        if loaded is None or snapshot is None:
            return READING, Tone.DIM
        if loaded.trouble:
            return loaded.trouble, Tone.BAD
        if loaded.curves is None:
            return NO_RESULT, Tone.DIM
        if loaded.curves.empty:
            return _nothing(snapshot), Tone.WARN
        return Sheet(self._figure, loaded.curves, snapshot, self._window or self._whole())


def _nothing(snapshot: Snapshot) -> str:
    """Why there is nothing to draw."""
    if snapshot.run.outcome is Outcome.ABORTED:
        return "no figures: the run was aborted and is invalid"
    return "no figures: nothing was recorded of door and handle during the run"
