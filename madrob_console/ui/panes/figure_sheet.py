"""The figures of the protocol document, drawn into cells (protocol section 6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from madrob_console.engine.curves import Curves
from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.axes import LARGEST, Window
from madrob_console.ui.cells.lines import Line, Span, Tone, line, with_keys
from madrob_console.ui.cells.plot import Frame, Mark, Plot
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
from scoring.protocol import Condition
from scoring.result import value_text

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
            zone=self.snapshot.door.closed_angle if quantity is Quantity.POSITION else None,
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
            Span(f" ({panel.remark})" if panel.remark else "", Tone.DIM),
            f"   {largest} {value_text(abs(top.value))} at {top.time:.2f} s{where}",
        )


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
