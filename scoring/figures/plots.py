"""The figures of the protocol document for one run, as vector or pixel graphics (section 6).

The document shows its figures 2 to 4 for three runs; for one run, 2 is the whole run, 3 the
opening and 4 the closing. Importing this module loads matplotlib: import it where you draw.
Like matplotlib, it draws in one thread at a time.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scoring.figure_table import FigureName, FigurePart, FigureSpec, Quantity, marked_events
from scoring.figures.drawing import BLUE, ORANGE, Panel, draw_sheet
from scoring.figures.event_labels import Interval
from scoring.indicator_table import IndicatorName, unit_text
from scoring.kinematics import Array
from scoring.protocol import Condition, EventName, Outcome
from scoring.result import Result, value_text
from scoring.rows import Rows

_MARGIN = 0.5
"""What figures 3 and 4 show before and after the movement, s."""

_FAR = 0.95
"""A door counts as opened from this part of its largest angle on."""

_STYLE: dict[str, object] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1,
    "svg.fonttype": "none",  # text stays text: small, and it can be searched and read out
    "svg.hashsalt": "madrob",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """A run with times in s since its start."""

    result: Result
    rows: Rows

    @property
    def door_time(self) -> Array:
        return self.rows.joint_state.time - self.result.start

    def times(self, name: EventName) -> list[float]:
        """When an event took place; it may happen more than once."""
        return [e.since_start for e in self.result.events if e.event is name]

    def series(self, quantity: Quantity) -> tuple[Array, Array]:
        """Times and values of a quantity."""
        time, value = self.rows.series(quantity)
        return time - self.result.start, value

    @property
    def window(self) -> Interval:
        """What a figure of the whole run shows: the run, and all data of it."""
        stop = self.result.stop
        times = [0.0] if stop is None else [0.0, stop - self.result.start]
        for quantity in Quantity:
            series, _ = self.series(quantity)
            times += [float(series[0]), float(series[-1])] if series.size else []
        return min(times), max(times)

    def part(self, part: FigurePart) -> Interval | None:
        """The time of a part of the run; None where that never took place."""
        match part:
            case FigurePart.WHOLE:
                return self.window
            case FigurePart.OPENING:
                return self.opening()
            case FigurePart.CLOSING:
                return self.closing()

    def opening(self) -> Interval | None:
        """From the first opening until the panel is nearly as far as it goes."""
        opened = min(self.times(EventName.DOOR_OPENS), default=None)
        if opened is None:
            return None
        far = self._far(self.door_time >= opened)
        return None if not far.size else self._around(opened, float(far[0]))

    def closing(self) -> Interval | None:
        """From when the panel was last nearly as far as it went until the last closing."""
        closed = max(self.times(EventName.DOOR_CLOSES), default=None)
        if closed is None:
            return None
        far = self._far(self.door_time <= closed)
        return None if not far.size else self._around(float(far[-1]), closed)

    def _far(self, rows: NDArray[np.bool_]) -> Array:
        time, angle = self.door_time[rows], np.abs(self.rows.joint_state.position[rows])
        return time[angle >= _FAR * angle.max()] if angle.size else time

    def _around(self, begin: float, end: float) -> Interval:
        first, last = self.window
        return max(first, begin - _MARGIN), min(last, end + _MARGIN)


def figures_of(result: Result, rows: Rows, condition: Condition) -> dict[FigureName, Figure]:
    """The figures of a run by `FigureName`; `missing_figures` says why one is not there.

    Args:
        result: of the run.
        rows: its pre-processed data.
        condition: its destination side tells the crossing.
    """
    run = _Run(result, rows)
    missing = missing_figures(result, rows)
    with _look():
        return {name: _draw(run, name, condition) for name in FigureName if name not in missing}


def missing_figures(result: Result, rows: Rows) -> Mapping[FigureName, str]:
    """The figures that a run does not have, and why, in words."""
    if result.outcome is Outcome.ABORTED:
        return dict.fromkeys(FigureName, "the run was aborted and is invalid")
    run = _Run(result, rows)
    return {name: why for name in FigureName if (why := _why_missing(run, name.spec)) is not None}


def _why_missing(run: _Run, figure: FigureSpec) -> str | None:
    for quantity in figure.panels:
        if quantity.spec.unrecorded and not np.isfinite(run.series(quantity)[1]).any():
            return quantity.spec.unrecorded
    if run.part(figure.part) is None:
        moved = "opened" if figure.part is FigurePart.OPENING else "closed"
        return f"the door never {moved}"
    return None


def svg(figure: Figure) -> str:
    """A figure as an SVG document; the same figure gives the same text."""
    text = io.StringIO()
    with _look():
        figure.savefig(
            text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type"))
        )
    return text.getvalue()


def png(figure: Figure, resolution: float = 200) -> bytes:
    """A figure as a PNG file, `resolution` in dots an inch."""
    data = io.BytesIO()
    with _look():
        figure.savefig(data, format="png", dpi=resolution, metadata={"Software": None})
    return data.getvalue()


def _look() -> AbstractContextManager[None]:
    """Our look and nobody's settings; matplotlib's own are back afterwards."""
    return style.context(["default", _STYLE])


def _draw(run: _Run, name: FigureName, condition: Condition) -> Figure:
    figure = name.spec
    whole = figure.part is FigurePart.WHOLE
    window = run.part(figure.part) or run.window
    *above, last = figure.panels
    panels = [_panel(run, quantity, ORANGE, window) for quantity in above]
    reason = run.result.indicators[figure.indicator].reason
    panels.append(_panel(run, last, BLUE, window, empty=reason or ""))
    events = marked_events(((e.since_start, e.event) for e in run.result.events), condition)
    finding = _finding(run, figure.indicator) if whole else figure.title
    title = f"Figure {name.number}   {finding}"
    return draw_sheet(title, panels, events, window, run.rows.thresholds.largest_gap)


def _panel(run: _Run, quantity: Quantity, colour: str, window: Interval, empty: str = "") -> Panel:
    spec = quantity.spec
    time, value = run.series(quantity)
    unit = unit_text(spec.unit)
    limits, note = None, spec.filtered
    if spec.clip is not None:
        value = np.abs(value)
        shown = value[(time >= window[0]) & (time <= window[1])]
        largest = float(np.max(shown, initial=0.0))
        if largest > spec.clip:
            note = f"clipped at {spec.clip:g}, largest {value_text(largest)} {unit}"
        value, limits = np.minimum(value, spec.clip), (0.0, spec.clip * 1.02)
    return Panel(
        f"{spec.label}, {unit}",
        colour,
        time,
        value,
        unit_of_maximum=unit if spec.peak else "",
        limits=limits,
        zone=run.rows.thresholds.closed_angle if spec.closed_zone else 0.0,
        note=note,
        empty=empty,
    )


def _finding(run: _Run, name: IndicatorName) -> str:
    indicator = run.result.indicators[name]
    if indicator.value is None:
        return f"{name.words}: none{indicator.sign}"
    return f"{name.words} {unit_text(indicator.text)}"
