"""The figures of the protocol document, drawn into cells (protocol section 6)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from madrob_console.engine.shown.curves import Curve, Curves
from madrob_console.ui.cells.axes import Window
from madrob_console.ui.cells.lines import Line, Span, Tone, line
from madrob_console.ui.cells.plot import BRAILLE, Frame, Ink, Mark, Plot
from madrob_console.ui.look.words import fitted
from madrob_console.ui.panes.run_summary import who_text
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, EventName
from scoring.result import value_text

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

LARGEST_JERK = 2.0
"""Jerk is drawn up to here, as in the document's figures 2 to 4, rad/s^3."""

KEYS = "left right: in time   up down: zoom   0: all   Tab: next figure"

_LEAST_ROWS = 3
_ROWS_WITH_LEGEND = 15
_ROWS_WITH_KEYS = 17


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot of a figure.

    Attributes:
        name: of the quantity, with its unit.
        stretches: where the curve is.
        plot: how it is drawn.
        remark: what else to know, in words.
    """

    name: str
    stretches: Callable[[Curves], tuple[Curve, ...]]
    plot: Plot
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One or two plots over a common time axis.

    Attributes:
        title: what it shows.
        panels: from above.
        indicator: the one that the last plot explains.
        meaning: how it follows from that plot.
    """

    title: str
    panels: tuple[Panel, ...]
    indicator: IndicatorName
    meaning: str


_POSITION = Panel("position, rad", lambda c: c.position, Plot((), 0.1), " (closed zone dotted)")
_ACCELERATION = Panel("low-passed acceleration, rad/s^2", lambda c: c.acceleration, Plot((), 0.1))
_JERK = Panel(
    "abs jerk, rad/s^3",
    lambda c: c.jerk,
    Plot((), LARGEST_JERK, absolute=True, clip=LARGEST_JERK),
    f" (clipped at {LARGEST_JERK:g})",
)
_FORCE = Panel("force, N", lambda c: c.force, Plot((), 1.0), " (as recorded)")

FIGURES = (
    Figure(
        "position and low-passed acceleration",
        (_POSITION, _ACCELERATION),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION,
        "the maximum",
    ),
    Figure(
        f"position and jerk clipped at {LARGEST_JERK:g} rad/s^3",
        (_POSITION, _JERK),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION,
        "10/mean abs jerk",
    ),
    Figure("handle force", (_FORCE,), IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION, "the maximum"),
)
"""In the document's order."""


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
        events = named_events(self.curves, self._condition)
        head = [self._title(width), line(Span(self._run(), Tone.DIM)), self._finding()]
        foot = [_legend(events)] if height >= _ROWS_WITH_LEGEND else []
        if height >= _ROWS_WITH_KEYS:
            foot.append(line(Span(KEYS, Tone.DIM)))
        axis_rows = 2
        rows = height - len(head) - len(foot) - len(figure.panels) - axis_rows
        heights = _shares(rows, len(figure.panels))
        plots = [self._plot(panel) for panel in figure.panels]
        gutter = max(plot.axis(h).gutter for plot, h in zip(plots, heights, strict=True))
        marks = [Mark(time, name[0]) for name, times in events.items() for time in times]
        frame = Frame(self.window, width, gutter, marks, ink)
        body: list[Line] = []
        for panel, plot, h in zip(figure.panels, plots, heights, strict=True):
            body += [self._heading(panel, plot), *frame.plot(plot, h)]
        return [*head, *body, *frame.time_axis(), *foot]

    @property
    def _condition(self) -> Condition | None:
        result = self.snapshot.result
        return None if result is None else result.condition

    def _plot(self, panel: Panel) -> Plot:
        zone = self.snapshot.door.closed_angle if panel is _POSITION else None
        return replace(panel.plot, stretches=panel.stretches(self.curves), zone=zone)

    def _title(self, width: int) -> Line:
        first, last = self.curves.extent
        whole = self.window.start <= first and self.window.end >= last
        text = f"figure {self.number + 1} of {len(FIGURES)}: {FIGURES[self.number].title}"
        part = "all" if whole else "part"
        right = f"  {self.window.start:.2f} to {self.window.end:.2f} s, {part}"
        return line(Span(fitted(text, width - len(right)) + right, Tone.STRONG))

    def _run(self) -> str:
        condition = self._condition
        if condition is None:
            return who_text(self.snapshot.run)
        return (
            f"{who_text(self.snapshot.run)}, condition {condition.number}: "
            f"{condition.benchmark_type}, {condition.way}"
        )

    def _finding(self) -> Line:
        """The indicator that the figure explains, by the ruleset of the result."""
        figure, result = FIGURES[self.number], self.snapshot.result
        name = figure.indicator.words
        if result is None:
            return line(name)
        indicator = result.indicator(figure.indicator)
        begin = f"{result.ruleset}: {name} "
        if indicator.value is None:
            return line(begin, Span(f"none: {indicator.reason}", Tone.WARN))
        value = Span(f"{value_text(indicator.value)} {indicator.unit}", Tone.STRONG)
        return line(begin, value, f" = {figure.meaning}")

    def _heading(self, panel: Panel, plot: Plot) -> Line:
        """The quantity, its maximum and where that is."""
        top = plot.extreme()
        name = Span(panel.name, Tone.STRONG)
        if top is None:
            return line(name, Span("   no data", Tone.WARN))
        largest = "max" if plot.absolute else "max abs"
        where = "" if top.time in self.window else ", not in this part"
        return line(
            name,
            Span(panel.remark, Tone.DIM),
            f"   {largest} {value_text(abs(top.value))} at {top.time:.2f} s{where}",
        )


def named_events(curves: Curves, condition: Condition | None) -> dict[str, list[float]]:
    """When the events that the figures mark took place, s since the start, by name.

    The first letters of the names differ: they mark the events. A crossing is known only with
    the run's condition.
    """
    crossing = None if condition is None else EventName.moves_to(condition.destination_side)
    names = {
        "touch": EventName.HANDLE_IS_TOUCHED,
        "opening": EventName.DOOR_OPENS,
        "x crossing": crossing,
        "closing": EventName.DOOR_CLOSES,
    }
    found = {name: [t for t, event in curves.events if event == of] for name, of in names.items()}
    return {name: times for name, times in found.items() if times}


def _legend(events: dict[str, list[float]]) -> Line:
    if not events:
        return line(Span("no touch, no opening", Tone.DIM))
    spans: list[str | Span] = []
    for name, times in events.items():
        letter, word = name[0], name.removeprefix("x ")
        spans += [Span(letter, Tone.STRONG), f" {word} {_times(times)}  "]
    return line(*spans, "s")


def _times(times: Sequence[float]) -> str:
    """One or two times; of more the first and the last."""
    between = f" .. ({len(times)}) .. " if len(times) > 2 else " "
    return between.join(f"{time:.2f}" for time in dict.fromkeys((times[0], times[-1])))


def _shares(rows: int, parts: int) -> Iterable[int]:
    """The rows divided among the plots, each of which gets its least."""
    share, more = divmod(max(rows, parts * _LEAST_ROWS), parts)
    return [share + (part < more) for part in range(parts)]
