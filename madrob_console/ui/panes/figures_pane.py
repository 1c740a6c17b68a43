"""The figures pane: the curves behind a result."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType

from madrob_console.common.errors import MadrobError
from madrob_console.engine.curves import Curves
from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line, paragraph, with_keys
from madrob_console.ui.cells.plot import LARGEST, Frame, Mark, Plot, Window
from madrob_console.ui.look.words import fitted
from madrob_console.ui.panes.run_status import what_text
from scoring.figure_table import (
    EventMark,
    FigureName,
    FigurePart,
    PanelSpec,
    Quantity,
    marked_events,
)
from scoring.protocol import Condition, Outcome
from scoring.result import value_text

# The figures of the protocol document, drawn into cells (protocol section 6).


KEYS = {
    "left": "left",
    "right: in time": "right",
    "up": "up",
    "down: zoom": "down",
    "0: all": "0",
    "Space: next figure": "space",
}

_LEAST_ROWS = 3
_ROWS_WITH_LEGEND = 15
_ROWS_WITH_KEYS = 17


FIGURES = tuple(name.spec for name in FigureName if name.spec.part is FigurePart.WHOLE)
"""In the document's order, without its parts of a run: those are zoomed to."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One figure of one run, ready to be drawn; `number` is an index into `FIGURES`."""

    number: int
    curves: Curves
    snapshot: Snapshot
    window: Window

    def lines(self, width: int, height: int) -> list[Line]:
        """Title, plots, time axis and legend; words give way if rows are few, 13 for two plots."""
        figure = FIGURES[self.number]
        events = marked_events(self.curves.events, self._condition)
        run = line(Span(what_text(self.snapshot.run), Tone.DIM))
        head = [self._title(width), run, self._finding()]
        foot = [_legend(events)] if height >= _ROWS_WITH_LEGEND else []
        if height >= _ROWS_WITH_KEYS:
            foot += with_keys([line(Span("   ".join(KEYS), Tone.DIM))], KEYS)
        axis_rows = 2
        rows = height - len(head) - len(foot) - len(figure.panels) - axis_rows
        heights = _shares(rows, len(figure.panels))
        plots = [self._plot(quantity) for quantity in figure.panels]
        gutter = max(plot.axis(h).gutter for plot, h in zip(plots, heights, strict=True))
        marks = [Mark(time, mark.letter) for mark, times in events.items() for time in times]
        frame = Frame(self.window, width, gutter, marks)
        body: list[Line] = []
        for quantity, plot, h in zip(figure.panels, plots, heights, strict=True):
            body += [self._heading(quantity.spec, plot), *frame.plot(plot, h)]
        return [*head, *body, *frame.time_axis(), *foot]

    @property
    def _condition(self) -> Condition | None:
        setup = self.snapshot.run.setup
        return None if self.snapshot.result is None or setup is None else setup.condition

    def _plot(self, quantity: Quantity) -> Plot:
        spec = quantity.spec
        return Plot(
            self.curves.curves_of(quantity),
            spec.least,
            absolute=spec.clip is not None,
            clip=spec.clip or LARGEST,
            zone=self.snapshot.door.closed_angle if spec.closed_zone else None,
        )

    def _title(self, width: int) -> Line:
        first, last = self.curves.extent
        whole = self.window.start <= first and self.window.end >= last
        text = f"figure {self.number + 1} of {len(FIGURES)}: {FIGURES[self.number].title}"
        part = "all" if whole else "part"
        right = f"  {self.window.start:.2f} to {self.window.end:.2f} s, {part}"
        return line(Span(fitted(text, width - len(right)) + right, Tone.STRONG))

    def _finding(self) -> Line:
        figure, result = FIGURES[self.number], self.snapshot.result
        name = figure.indicator.words
        if result is None:
            return line(name)
        indicator = result.indicators[figure.indicator]
        begin = f"{result.ruleset}: {name} "
        if indicator.value is None:
            return line(begin, Span(indicator.text, Tone.WARN))
        return line(begin, Span(indicator.text, Tone.STRONG), f" = {figure.meaning}")

    def _heading(self, panel: PanelSpec, plot: Plot) -> Line:
        top = plot.extreme()
        name = Span(f"{panel.filtered} {panel.label}, {panel.unit}".lstrip(), Tone.STRONG)
        if top is None:
            return line(name, Span("   no data", Tone.WARN))
        largest = "max" if plot.absolute else "max abs"
        where = "" if top.time in self.window else ", not in this part"
        return line(
            name,
            Span(_remark(panel), Tone.DIM),
            f"   {largest} {value_text(abs(top.value))} at {top.time:.2f} s{where}",
        )


def _remark(panel: PanelSpec) -> str:
    clipped = f"clipped at {panel.clip:g}" if panel.clip is not None else ""
    remark = panel.remark or clipped or ("closed zone dotted" if panel.closed_zone else "")
    return f" ({remark})" if remark else ""


def _legend(events: Mapping[EventMark, Sequence[float]]) -> Line:
    if not events:
        return line(Span("no touch, no opening", Tone.DIM))
    spans: list[str | Span] = []
    for mark, times in events.items():
        spans += [Span(mark.letter, Tone.STRONG), f" {mark} {_times(times)}  "]
    return line(*spans, "s")


def _times(times: Sequence[float]) -> str:
    between = f" .. ({len(times)}) .. " if len(times) > 2 else " "
    return between.join(f"{time:.2f}" for time in dict.fromkeys((times[0], times[-1])))


def _shares(rows: int, parts: int) -> Iterable[int]:
    share, more = divmod(max(rows, parts * _LEAST_ROWS), parts)
    return [share + (part < more) for part in range(parts)]


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
