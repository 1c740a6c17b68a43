"""The figures of the protocol document for one run, drawn by matplotlib (section 6).

The document shows its figures 2 to 4 for three runs; for one run, 2 is the whole run, 3 the
opening and 4 the closing. Importing this module loads matplotlib: import it where you draw.
Like matplotlib, it draws in one thread at a time.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping
from contextlib import AbstractContextManager

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from scoring.figure_table import EventMark, FigureName, FigurePart, Quantity, marked_events
from scoring.indicator_table import unit_text
from scoring.kinematics import Array
from scoring.protocol import Condition, EventName, Outcome
from scoring.result import Result
from scoring.rows import Rows
from scoring.run_drawings import BAND, BLUE, GREY, ORANGE, RED, Interval, stretches

MOST_POINTS = 600
"""Points of a curve: more cannot be told apart, and make a large file."""

_WIDTH, _HEIGHT = 4.2, 3.7  # inches: letters of 10 points are readable on a phone of 360 pixels
_TITLE = 48  # letters a line
_MARGIN = 0.5  # s, before and after an opening or a closing
_FAR = 0.95  # of its largest angle: the door is opened
_LARGEST = 1e9  # no sensor means more, and the axes' arithmetic must not overflow

_KEPT = "\N{NO-BREAK SPACE}"
"""Keeps a value and its unit on one line of the title."""

_DASHES: Mapping[EventMark, LineStyleType] = {
    EventMark.TOUCH: ":",
    EventMark.OPENING: "--",
    EventMark.CROSSING: "-.",
    EventMark.CLOSING: (0, (7, 2)),
}

_STYLE: dict[str, object] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 10,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.borderpad": 0.0,
    "lines.linewidth": 1,
    "svg.fonttype": "none",  # text stays text: small, and it can be searched and read out
    "svg.hashsalt": "madrob",
}


def figures_of(result: Result, rows: Rows, condition: Condition) -> dict[FigureName, Figure]:
    """Draw the figures of a run; `missing_figures` says why one is not there."""
    missing = missing_figures(result, rows)
    with _look():
        return {
            name: _draw(result, rows, condition, name) for name in FigureName if name not in missing
        }


def missing_figures(result: Result, rows: Rows) -> dict[FigureName, str]:
    """Why figures of a run cannot be drawn, in words."""
    if result.outcome is Outcome.ABORTED:
        return dict.fromkeys(FigureName, "the run was aborted and is invalid")
    reasons = {}
    for name in FigureName:
        unrecorded = [
            quantity.spec.unrecorded
            for quantity in name.spec.panels
            if quantity.spec.unrecorded and not np.isfinite(rows.series(quantity)[1]).any()
        ]
        if unrecorded:
            reasons[name] = unrecorded[0]
        elif _window(result, rows, name.spec.part) is None:
            opened = EventName.DOOR_OPENS in {event.event for event in result.events}
            reasons[name] = "the door never closed" if opened else "the door never opened"
    return reasons


def heading(result: Result, name: FigureName) -> str:
    """The title of a figure: its number, and the value that it shows."""
    indicator = result.indicators[name.spec.indicator]
    if name.spec.part is not FigurePart.WHOLE:
        return f"Figure {name.number}: {name.spec.title}"
    value = "none"
    if indicator.value is not None:
        value = unit_text(indicator.text).replace(" ", _KEPT)
    return f"Figure {name.number}: {name.spec.indicator.words} {value}"


def svg(figure: Figure) -> str:
    """A figure as an SVG document; the same figure gives the same text."""
    text = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with _look():
        figure.savefig(text, format="svg", metadata=nothing)
    return text.getvalue()


def _look() -> AbstractContextManager[None]:
    """Use our matplotlib settings, and restore the others afterwards."""
    return style.context(["default", _STYLE])


def _window(result: Result, rows: Rows, part: FigurePart) -> Interval | None:
    """What a figure shows, s since the start; None = the door did not do that."""
    times = [0.0] if result.stop is None else [0.0, result.stop - result.start]
    for quantity in Quantity:
        series = rows.series(quantity)[0] - result.start
        times += series[[0, -1]].tolist() if series.size else []
    if part is FigurePart.WHOLE:
        return min(times), max(*times, min(times) + 1.0)
    opens = part is FigurePart.OPENING
    event = EventName.DOOR_OPENS if opens else EventName.DOOR_CLOSES
    instants = [one.since_start for one in result.events if one.event is event]
    if not instants:
        return None
    edge = min(instants) if opens else max(instants)
    door = rows.joint_state.time - result.start
    moving = door >= edge if opens else door <= edge
    angle = np.abs(rows.joint_state.position[moving])
    if not angle.size:
        return None
    far = door[moving][angle >= _FAR * angle.max()][0 if opens else -1]
    first, last = min(edge, far), max(edge, far)
    return max(min(times), first - _MARGIN), min(max(times), last + _MARGIN)


def _draw(result: Result, rows: Rows, condition: Condition, name: FigureName) -> Figure:
    window = _window(result, rows, name.spec.part)
    assert window is not None
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    title = textwrap.fill(heading(result, name), _TITLE)
    figure.suptitle(title, x=0.01, ha="left", weight="bold", size=10)
    panels = name.spec.panels
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, quantity in zip(every, panels, strict=True):
        axes.set_xlim(window)
        axes.set_ylabel(f"{quantity.spec.label}\n{unit_text(quantity.spec.unit)}")
        axes.locator_params(axis="y", nbins=4)
        _draw_quantity(axes, result, rows, quantity, is_last=quantity is panels[-1])
        _draw_events(axes, result, condition)
    every[-1].set_xlabel("time from the run's start, s")
    handles, labels = every[-1].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _draw_quantity(
    axes: Axes, result: Result, rows: Rows, quantity: Quantity, *, is_last: bool
) -> None:
    spec = quantity.spec
    time, value = rows.series(quantity)
    value = np.clip(value, -_LARGEST, _LARGEST)
    if spec.clip is not None:
        value = np.abs(value)
    if spec.closed_zone:
        axes.axhspan(-rows.thresholds.closed_angle, rows.thresholds.closed_angle, color=BAND)
    if quantity is Quantity.FORCE:
        zero, touch = result.handle_zero, rows.thresholds.touch_force
        axes.axhspan(zero - touch, zero + touch, color=BAND)
        axes.axhline(zero, color=GREY, linewidth=0.8, linestyle="--")
    curve = stretches(time - result.start, value, rows.thresholds.largest_gap, MOST_POINTS)
    if not curve:
        axes.text(0.5, 0.5, "no data in this time", transform=axes.transAxes, ha="center")
        return
    columns = [_with_gaps(parts) for parts in zip(*curve, strict=True)]
    axes.plot(*columns, color=BLUE if is_last else ORANGE, gid=spec.name)
    low, high = min(0.0, np.nanmin(columns[1])), max(0.0, np.nanmax(columns[1]))
    margin = max(0.06 * (high - low), (spec.least - (high - low)) / 2)
    axes.set_ylim(low - margin, high + margin)
    if spec.clip is not None:
        _draw_mean(axes, value[np.isfinite(value)], spec.clip)
    elif spec.peak and is_last:
        top = int(np.nanargmax(np.abs(value)))
        at = float(time[top]) - result.start
        axes.axhline(value[top], color=RED, linewidth=0.6)
        axes.plot([at], [value[top]], "o", color=RED, markersize=4, label=f"maximum, {at:.2f} s")


def _draw_mean(axes: Axes, value: Array, clip: float) -> None:
    """Mark the mean; what is beyond the clip is told, not drawn."""
    beyond = 100 * float((value > clip).mean())
    words = f"mean {value.mean():.3g}" + (f" ({beyond:.2g} % above {clip:g})" if beyond else "")
    axes.axhline(float(value.mean()), color=RED, linewidth=0.9, label=words)
    axes.set_ylim(0.0, 1.02 * clip)


def _draw_events(axes: Axes, result: Result, condition: Condition) -> None:
    events = ((event.since_start, event.event) for event in result.events)
    for mark, times in marked_events(events, condition).items():
        axes.vlines(
            times,
            0.0,
            1.0,
            transform=axes.get_xaxis_transform(),
            color=GREY,
            linewidth=0.8,
            linestyles=_DASHES[mark],
            label=str(mark),
            zorder=1,
        )


def _with_gaps(parts: tuple[Array, ...]) -> Array:
    return np.concatenate([piece for part in parts for piece in ([np.nan], part)][1:])
