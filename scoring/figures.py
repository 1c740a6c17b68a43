"""The figures of the protocol document for one run, drawn by matplotlib (section 6).

The document shows its figures 2 to 4 for three runs; for one run, 2 is the whole run, 3 the
opening and 4 the closing. Importing this module loads matplotlib: import it where you draw.
Like matplotlib, it draws in one thread at a time.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import AbstractContextManager

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from scoring.figure_table import (
    LARGEST_JERK,
    EventMark,
    FigureName,
    FigurePart,
    Quantity,
    marked_events,
)
from scoring.indicator_table import unit_text
from scoring.kinematics import Array
from scoring.protocol import Condition, EventName, Outcome
from scoring.result import Result
from scoring.rows import Rows

ORANGE = "#d95f02"  # position
BLUE = "#1f4e9e"  # derived quantities
RED = "#c00000"  # the data of the indicator
GREY = "#555555"  # all the rest
BAND = "#e0e0e0"

_MARGIN = 0.5  # s, before and after an opening or a closing
_WIDE_OPEN = 0.95  # of the largest angle
_LARGEST = 1e9  # no sensor means more, and the axes' arithmetic must not overflow

_DASHES: Mapping[EventMark, LineStyleType] = {
    EventMark.TOUCH: ":",
    EventMark.OPENING: "--",
    EventMark.CROSSING: "-.",
    EventMark.CLOSING: (0, (7, 2)),
}

_LOOK: Mapping[str, object] = {
    "figure.figsize": (4.2, 3.7),  # inches: readable letters on a phone of 360 pixels
    "figure.constrained_layout.use": True,
    "figure.titlesize": 10,
    "figure.titleweight": "bold",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 10,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "hatch.linewidth": 0.5,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.borderpad": 0.0,
    "lines.linewidth": 1,
    "path.simplify_threshold": 0.5,  # pixels: a long run makes no large file
    "svg.fonttype": "none",  # text stays text: small, and it can be searched and read out
    "svg.hashsalt": "madrob",
}


def figures_of(result: Result, rows: Rows, condition: Condition) -> dict[FigureName, Figure]:
    """Draw the figures of a run.

    `missing_figures` says why one is not there.
    """
    missing = missing_figures(result, rows)
    with look():
        return {
            name: _draw(result, rows, condition, name) for name in FigureName if name not in missing
        }


def missing_figures(result: Result, rows: Rows) -> dict[FigureName, str]:
    """Say in words why figures of a run cannot be drawn."""
    if result.outcome is Outcome.ABORTED:
        return dict.fromkeys(FigureName, "the run was aborted and is invalid")
    happened = {event.event for event in result.events}
    reasons = {}
    for name in FigureName:
        part = name.spec.part
        if Quantity.FORCE in name.spec.panels:
            if not np.isfinite(rows.force).any():
                reasons[name] = "no handle force was recorded during the run"
        elif not np.isfinite(rows.joint_state.position).any():
            reasons[name] = "no door angle was recorded during the run"
        elif part is not FigurePart.WHOLE and EventName.DOOR_OPENS not in happened:
            reasons[name] = "the door never opened"
        elif part is FigurePart.CLOSING and EventName.DOOR_CLOSES not in happened:
            reasons[name] = "the door never closed"
    return reasons


def svg(figure: Figure) -> str:
    """Return a figure as an SVG document.

    The same figure gives the same text.
    """
    text = io.StringIO()
    with look():
        metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(text, format="svg", metadata=metadata)
    return text.getvalue()


def look() -> AbstractContextManager[None]:
    """Use the settings of these figures, whatever matplotlib's are, and restore those."""
    return style.context(["default", dict(_LOOK)])


def draw_frame(figure: Figure, title: str, lowest: Axes) -> None:
    """Draw the title, the time axis and the legend of what was drawn in the lowest panel."""
    figure.suptitle(title, x=0.01, ha="left", wrap=True)
    lowest.set_xlabel("time from the run's start, s")
    handles, labels = lowest.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)


def draw_events(axes: Axes, result: Result, condition: Condition) -> None:
    """Draw a line through the panel for each event that figures mark."""
    events = [(event.since_start, event.event) for event in result.events]
    for mark, times in marked_events(events, condition).items():
        for number, time in enumerate(times):
            line = axes.axvline(time, color=GREY, linewidth=0.8, linestyle=_DASHES[mark], zorder=1)
            if number == 0:
                line.set_label(mark)


def _draw(result: Result, rows: Rows, condition: Condition, name: FigureName) -> Figure:
    figure = Figure()
    panels = figure.subplots(len(name.spec.panels), sharex=True, squeeze=False)[:, 0]
    for axes, quantity in zip(panels, name.spec.panels, strict=True):
        _draw_quantity(axes, result, rows, quantity)
        draw_events(axes, result, condition)
    lowest = panels[-1]
    if name.spec.part is not FigurePart.WHOLE:
        lowest.set_xlim(_window(result, rows, name.spec.part))
    draw_frame(figure, _title(result, name), lowest)
    return figure


def _title(result: Result, name: FigureName) -> str:
    if name.spec.part is not FigurePart.WHOLE:
        return f"Figure {name.number}: {name.spec.title}"
    value = unit_text(result.indicators[name.spec.indicator].text)
    return f"Figure {name.number}: {name.spec.indicator.words}\n{value}"


def _window(result: Result, rows: Rows, part: FigurePart) -> tuple[float, float]:
    """Return from and to of the first opening or of the last closing, s since the start."""
    time = rows.joint_state.time - result.start
    angle = np.abs(rows.joint_state.position)
    opens = part is FigurePart.OPENING
    name = EventName.DOOR_OPENS if opens else EventName.DOOR_CLOSES
    edges = [event.since_start for event in result.events if event.event is name]
    edge = min(edges) if opens else max(edges)
    moves = time >= edge if opens else time <= edge
    wide_open = angle >= _WIDE_OPEN * angle[moves].max(initial=0.0)
    times = [edge, *time[moves & wide_open]]
    far = times[1:2] if opens else times[-1:]
    first, last = min([edge, *far]), max([edge, *far])
    return first - _MARGIN, last + _MARGIN


def _draw_quantity(axes: Axes, result: Result, rows: Rows, quantity: Quantity) -> None:
    spec = quantity.spec
    axes.set_ylabel(f"{spec.label}\n{unit_text(spec.unit)}")
    axes.locator_params(axis="y", nbins=4)
    time, value = rows.series(quantity)
    time = time - result.start
    value = np.clip(value, -_LARGEST, _LARGEST)
    if spec.clip is not None:
        value = np.abs(value)
    if not np.isfinite(value).any():
        axes.text(0.5, 0.5, "no data in this time", transform=axes.transAxes, ha="center")
        return

    # The time axis begins with the run, and noise at rest does not fill the panel.
    axes.update_datalim(((0.0, -spec.least / 2), (0.0, spec.least / 2)))

    # A gap in the data is a gap in the curve.
    gaps = np.flatnonzero(np.diff(time) > rows.thresholds.largest_gap) + 1
    colour = ORANGE if quantity is Quantity.POSITION else BLUE
    broken = np.insert(value, gaps, np.nan)
    axes.plot(np.insert(time, gaps, np.nan), broken, color=colour, gid=spec.name)
    match quantity:
        case Quantity.POSITION:
            axes.axhspan(-rows.thresholds.closed_angle, rows.thresholds.closed_angle, color=BAND)
        case Quantity.ACCELERATION:
            _mark_maximum(axes, time, value)
        case Quantity.JERK:
            _mark_mean(axes, value)
        case Quantity.FORCE:
            zero = result.handle_zero
            touch = rows.thresholds.touch_force
            axes.axhspan(zero - touch, zero + touch, color=BAND)
            axes.axhline(zero, color=GREY, linewidth=0.8, linestyle="--")
            _mark_maximum(axes, time, value)


def _mark_maximum(axes: Axes, time: Array, value: Array) -> None:
    top = np.nanargmax(np.abs(value))
    axes.axhline(value[top], color=RED, linewidth=0.6)
    label = f"maximum, {time[top]:.2f} s"
    axes.plot(time[top], value[top], "o", color=RED, markersize=4, label=label)


def _mark_mean(axes: Axes, value: Array) -> None:
    """Mark the mean, and say how much of the curve is beyond the axis."""
    mean = float(value.mean())
    beyond = 100 * float((value > LARGEST_JERK).mean())
    label = f"mean {mean:.3g} ({beyond:.2g} % above {LARGEST_JERK:g})"
    axes.axhline(mean, color=RED, linewidth=0.9, label=label)
    axes.set_ylim(0.0, 1.02 * LARGEST_JERK)
