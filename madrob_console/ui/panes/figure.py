"""The figures of the protocol document, drawn into cells (protocol section 6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from madrob_console.engine.shown.curves import Curves
from madrob_console.ui.cells.axes import LARGEST, Window
from madrob_console.ui.cells.lines import Line, Span, Tone, line
from madrob_console.ui.cells.plot import BRAILLE, Frame, Ink, Mark, Plot
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

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

KEYS = "left right: in time   up down: zoom   0: all   Tab: next figure"

_LEAST_ROWS = 3
_ROWS_WITH_LEGEND = 15
_ROWS_WITH_KEYS = 17


FIGURES = tuple(name.spec for name in FigureName if name.spec.part is FigurePart.WHOLE)
"""In the document's order, without its parts of a run: those are zoomed to."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One figure of one run, ready to be drawn.

    Attributes:
        number: index into `FIGURES`.
        curves: of the run.
        snapshot: says which run it is, and what it scored.
        window: the time that is shown.
    """

    number: int
    curves: Curves
    snapshot: Snapshot
    window: Window

    def lines(self, width: int, height: int, ink: Ink = BRAILLE) -> list[Line]:
        """Title, plots, time axis and legend; words give way where rows are few.

        Args:
            width: cells.
            height: rows; 13 at least for two plots.
            ink: the characters.
        """
        figure = FIGURES[self.number]
        events = marked_events(self.curves.events, self._condition)
        run = line(Span(what_text(self.snapshot.run), Tone.DIM))
        head = [self._title(width), run, self._finding()]
        foot = [_legend(events)] if height >= _ROWS_WITH_LEGEND else []
        if height >= _ROWS_WITH_KEYS:
            foot.append(line(Span(KEYS, Tone.DIM)))
        axis_rows = 2
        rows = height - len(head) - len(foot) - len(figure.panels) - axis_rows
        heights = _shares(rows, len(figure.panels))
        plots = [self._plot(quantity) for quantity in figure.panels]
        gutter = max(plot.axis(h).gutter for plot, h in zip(plots, heights, strict=True))
        marks = [Mark(time, mark.letter) for mark, times in events.items() for time in times]
        frame = Frame(self.window, width, gutter, marks, ink)
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
            self.curves.of(quantity),
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
        """The indicator that the figure explains, by the ruleset of the result."""
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
        """The quantity, its maximum and where that is."""
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
    """One or two times; of more the first and the last."""
    between = f" .. ({len(times)}) .. " if len(times) > 2 else " "
    return between.join(f"{time:.2f}" for time in dict.fromkeys((times[0], times[-1])))


def _shares(rows: int, parts: int) -> Iterable[int]:
    """The rows divided among the plots, each of which gets its least."""
    share, more = divmod(max(rows, parts * _LEAST_ROWS), parts)
    return [share + (part < more) for part in range(parts)]
