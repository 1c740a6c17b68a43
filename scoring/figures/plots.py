"""The figures of the protocol document for one run, as vector or pixel graphics (section 6).

The document shows its figures 2 to 4 for three runs; for one run, 2 is the whole run, 3 the
opening and 4 the closing. Importing this module loads matplotlib: import it where you draw.
Like matplotlib, it draws in one thread at a time.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scoring.figure_table import (
    EventMark,
    FigureName,
    FigurePart,
    FigureSpec,
    Quantity,
    marked_events,
)
from scoring.figures.drawing import Band, Panel, draw_sheet, largest_at
from scoring.figures.event_labels import Interval, inside
from scoring.figures.run_drawings import BLUE, ORANGE
from scoring.indicator_table import IndicatorName, unit_text
from scoring.kinematics import Array
from scoring.protocol import Condition, EventName, Outcome
from scoring.result import Indicator, Result, value_text
from scoring.rows import Rows

_MARGIN = 0.5
"""What figures 3 and 4 show before and after the movement, s."""

_FAR = 0.95
"""A door counts as opened from this part of its largest angle on."""

_MOST_TOLD = 3

_KEPT = "\N{NO-BREAK SPACE}"
"""Keeps a value and its unit on one line of the title."""

_TAG, _DECIMALS = re.compile("<[^>]*>"), re.compile(r"(\.\d)\d+")
"""More decimals of a point on a sheet cannot be seen; those in its words stay."""

_STYLE: dict[str, object] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 10,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
    "axes.labelpad": 2,
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
        return [e.since_start for e in self.result.events if e.event is name]

    def series(self, quantity: Quantity) -> tuple[Array, Array]:
        time, value = self.rows.series(quantity)
        return time - self.result.start, value

    @property
    def window(self) -> Interval:
        stop = self.result.stop
        times = [0.0] if stop is None else [0.0, stop - self.result.start]
        for quantity in Quantity:
            series, _ = self.series(quantity)
            times += [float(series[0]), float(series[-1])] if series.size else []
        return min(times), max(times)

    def part(self, part: FigurePart) -> Interval | None:
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
    """The figures of a run; `missing_figures` says why one is not there."""
    run = _Run(result, rows)
    missing = missing_figures(result, rows)
    with _look():
        return {name: _draw(run, name, condition) for name in FigureName if name not in missing}


def missing_figures(result: Result, rows: Rows) -> Mapping[FigureName, str]:
    if result.outcome is Outcome.ABORTED:
        return dict.fromkeys(FigureName, "the run was aborted and is invalid")
    run = _Run(result, rows)
    return {name: why for name in FigureName if (why := _why_missing(run, name.spec)) is not None}


def alternatives_of(result: Result, rows: Rows, condition: Condition) -> Mapping[FigureName, str]:
    """Alternative texts of the figures, with this run's numbers."""
    run, missing = _Run(result, rows), missing_figures(result, rows)
    marks = marked_events(((e.since_start, e.event) for e in result.events), condition)
    return {
        name: "; ".join((_heading(run, name), *_described(run, name.spec, marks)))
        for name in FigureName
        if name not in missing
    }


def _described(
    run: _Run, figure: FigureSpec, marks: Mapping[EventMark, list[float]]
) -> Iterator[str]:
    window = run.part(figure.part) or run.window
    for quantity in figure.panels:
        spec, (time, value) = quantity.spec, run.series(quantity)
        shown = (time >= window[0]) & (time <= window[1]) & np.isfinite(value)
        if not shown.any():
            yield f"no {spec.label}"
            continue
        time, value, unit = time[shown], value[shown], unit_text(spec.unit)
        if spec.clip is not None:
            value = np.abs(value)
        largest = np.argmax(np.abs(value))
        yield (
            f"{spec.label} from {value.min():.3g} to {value.max():.3g} {unit}, "
            f"largest at {time[largest]:.2f} s"
        )
        if spec.clip is not None:
            yield f"{100 * np.mean(value > spec.clip):.2g} % above {spec.clip:g} {unit}"
    for mark, times in marks.items():
        if instants := inside(times, window):
            first = ", ".join(f"{time:.2f}" for time in instants[:_MOST_TOLD])
            yield f"{mark} at {first} s" + (", and more" if len(instants) > _MOST_TOLD else "")


def _why_missing(run: _Run, figure: FigureSpec) -> str | None:
    for quantity in figure.panels:
        if quantity.spec.unrecorded and not np.isfinite(run.series(quantity)[1]).any():
            return quantity.spec.unrecorded
    if run.part(figure.part) is not None:
        return None
    if not run.times(EventName.DOOR_OPENS):
        return "the door never opened"
    if figure.part is FigurePart.CLOSING and not run.times(EventName.DOOR_CLOSES):
        return "the door never closed"
    return "no door angle was recorded while the door was open"


def svg(figure: Figure) -> str:
    """A figure as an SVG document; the same figure gives the same text."""
    text = io.StringIO()
    with _look():
        figure.savefig(
            text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type"))
        )
    return _TAG.sub(lambda tag: _DECIMALS.sub(r"\1", tag[0]), text.getvalue())


def _look() -> AbstractContextManager[None]:
    """Use our matplotlib settings, and restore the others afterwards."""
    return style.context(["default", _STYLE])


def _draw(run: _Run, name: FigureName, condition: Condition) -> Figure:
    figure = name.spec
    window = run.part(figure.part) or run.window
    *above, last = figure.panels
    panels = [_panel(run, quantity, ORANGE, window) for quantity in above]
    indicator = run.result.indicators[figure.indicator]
    panels.append(_panel(run, last, BLUE, window, indicator))
    if (whole_jerk := _unclipped(panels[-1], run, last, window, indicator)) is not None:
        panels.append(whole_jerk)
    events = marked_events(((e.since_start, e.event) for e in run.result.events), condition)
    return draw_sheet(_heading(run, name), panels, events, window, run.rows.thresholds.largest_gap)


def _panel(
    run: _Run,
    quantity: Quantity,
    colour: str,
    window: Interval,
    indicator: Indicator | None = None,
) -> Panel:
    spec = quantity.spec
    time, value = run.series(quantity)
    limits, note, mean, maximum = None, spec.filtered, None, ""
    if spec.clip is not None:
        value = np.abs(value)
        mean = _mean(value)
        if part := 100 * _cut_off(run, quantity, window):
            note = f"{part:.{0 if part >= 10 else 1}f} % of the samples lie outside"
        value, limits = np.minimum(value, spec.clip), (0.0, spec.clip * 1.02)
    elif spec.peak and indicator is not None and (peak := largest_at(value)) is not None:
        maximum = f"maximum {_number(abs(value[peak]), indicator)} {unit_text(spec.unit)}"
    uncertainty = indicator.uncertainty if indicator else None
    return Panel(
        f"{spec.label}, {unit_text(spec.unit)}",
        colour,
        time,
        value,
        maximum=maximum,
        mean=mean,
        limits=limits,
        least=max(spec.least, 4 * uncertainty.expanded if uncertainty else 0.0),
        band=_touch_band(run) if quantity is Quantity.FORCE else None,
        zone=run.rows.thresholds.closed_angle if spec.closed_zone else 0.0,
        note=note,
        empty=(indicator.reason if indicator else None) or "",
    )


def _cut_off(run: _Run, quantity: Quantity, window: Interval) -> float:
    """The part of the samples in a window beyond the quantity's clip; 0 without one."""
    clip, (time, value) = quantity.spec.clip, run.series(quantity)
    shown = value[(time >= window[0]) & (time <= window[1]) & np.isfinite(value)]
    return 0.0 if clip is None or not shown.size else float(np.mean(np.abs(shown) > clip))


def _unclipped(
    panel: Panel, run: _Run, quantity: Quantity, window: Interval, indicator: Indicator
) -> Panel | None:
    """The panel without its clip, to stand below it; None where nothing is cut off."""
    if panel.mean is None or not _cut_off(run, quantity, window):
        return None
    note = f"unclipped; the run's mean {panel.mean:.3g}"
    if indicator.value is not None:
        note += f", 10/mean {_number(indicator.value, indicator)}"
    value = np.abs(run.series(quantity)[1])
    return replace(panel, value=value, limits=None, note=note)


def _mean(value: Array) -> float | None:
    finite = value[np.isfinite(value)]
    with np.errstate(over="ignore"):
        mean = float(np.mean(finite)) if finite.size else math.nan
    return mean if math.isfinite(mean) else None


def _number(value: float, indicator: Indicator) -> str:
    return value_text(float(value), indicator.uncertainty)


def _touch_band(run: _Run) -> Band | None:
    """The handle's force at rest, and how far it may be off without being a touch."""
    time = run.rows.force_time
    if not time.size:
        return None
    centre = np.full(2, run.result.handle_zero)
    ends = time[np.array([0, -1])] - run.result.start
    return Band(ends, centre, run.rows.thresholds.touch_force)


def _heading(run: _Run, name: FigureName) -> str:
    whole = name.spec.part is FigurePart.WHOLE
    finding = _finding(run, name.spec.indicator) if whole else name.spec.title
    return f"Figure {name.number}   {finding}"


def _finding(run: _Run, name: IndicatorName) -> str:
    indicator = run.result.indicators[name]
    if indicator.value is None:
        return f"{name.words}: none{indicator.sign}"
    value = unit_text(indicator.text).replace(" ", _KEPT)
    return f"{name.words} {value}"
