"""Draws curves over time: panels above each other, one time axis, events as labelled lines.

Sizes are in points, and all sheets have the same: side by side they leave no hole, and on a phone,
which shows a sheet as wide as its screen, letters are still larger than 10 pixels. See `plots` for
what is drawn.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from scoring.figure_table import EventMark
from scoring.figures.event_labels import (
    LABEL_SIZE,
    EventLabel,
    Interval,
    inside,
    labels_of,
    rows_of,
    text_width,
)
from scoring.figures.run_drawings import GREY, RED, stretches
from scoring.kinematics import Array

Events = Mapping[EventMark, Sequence[float]]

MOST_POINTS = 600
"""Points of a curve: more cannot be told apart, and make a large file."""

_WIDTH, _HEIGHT, _LEFT, _RIGHT = 300.0, 262.0, 60.0, 10.0
_INNER = _WIDTH - _LEFT - _RIGHT
_TITLE, _GAP, _FOOT = 8.0, 18.0, 36.0
_LINE, _TITLE_WIDTH = 13.0, 48  # of the title: height, and letters
_LABEL_HEIGHT = 12.0
_SIZE = 10.0  # of letters in a panel
_SIZES = {1: (1.0,), 2: (1.0, 1.4), 3: (1.0, 1.2, 1.2)}  # of the panels, from above
_LARGEST = 1e9  # no sensor means more, and the axes' arithmetic must not overflow


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A zone around a line that may slope: `half` to either side, arrays of shape (2,)."""

    time: Array
    centre: Array
    half: float


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One quantity over time, s; values that are not finite are gaps.

    Attributes:
        maximum: words for the largest absolute value, which is marked; empty = not marked.
        mean: where to draw a line for it.
        limits: of the value axis; None = what the values need.
        least: the value axis spans at least this much, so that noise looks like noise.
        zone: shade +-`zone` around 0.
        note: words above the panel.
        empty: why there is no value.
    """

    label: str
    colour: str
    time: Array
    value: Array
    maximum: str = ""
    mean: float | None = None
    limits: Interval | None = None
    least: float = 0.0
    band: Band | None = None
    zone: float = 0.0
    note: str = ""
    empty: str = ""


_DASHES: dict[EventMark, LineStyleType] = {
    EventMark.TOUCH: ":",
    EventMark.OPENING: "--",
    EventMark.CROSSING: "-.",
    EventMark.CLOSING: (0, (7, 2)),
}


def draw_sheet(
    title: str, panels: Sequence[Panel], events: Events, window: Interval, largest_gap: float
) -> Figure:
    """Draw one to three panels; curves are broken at intervals above `largest_gap` s."""
    if window[1] <= window[0]:
        window = (window[0], window[0] + 1.0)
    labels = labels_of(events, window, _INNER, _RIGHT)
    rows = rows_of(labels)
    title = textwrap.fill(title, _TITLE_WIDTH)
    base = _LABEL_HEIGHT if panels[0].note else 0.0
    head = _TITLE + _LINE * (title.count("\n") + 1)
    head += base + _LABEL_HEIGHT * (max(rows, default=-1) + 1)
    sizes = _SIZES[len(panels)]
    room = _HEIGHT - head - _GAP * (len(panels) - 1) - _FOOT
    heights = [room * size / sum(sizes) for size in sizes]
    figure = Figure(figsize=(_WIDTH / 72, _HEIGHT / 72))
    figure.text(4 / _WIDTH, 1 - 4 / _HEIGHT, title, va="top", weight="bold")
    bottom, axes = _HEIGHT - head + _GAP, []
    for panel, height in zip(panels, heights, strict=True):
        bottom -= height + _GAP
        place = (_LEFT / _WIDTH, bottom / _HEIGHT, _INNER / _WIDTH, height / _HEIGHT)
        axes.append(figure.add_axes(place))
        _draw_panel(axes[-1], panel, window, largest_gap)
        _draw_marks(axes[-1], events, window)
        axes[-1].tick_params(labelbottom=panel is panels[-1])
    for label, row in zip(labels, rows, strict=True):
        _draw_label(axes[0], label, base + row * _LABEL_HEIGHT, heights[0])
    axes[-1].set_xlabel("time from the run's start, s", labelpad=2)
    return figure


def largest_at(value: Array) -> int | None:
    finite = np.flatnonzero(np.isfinite(value))
    return int(finite[np.argmax(np.abs(value[finite]))]) if finite.size else None


def _draw_panel(axes: Axes, panel: Panel, window: Interval, largest_gap: float) -> None:
    axes.set_xlim(window)
    name, _, unit = panel.label.partition(", ")
    axes.set_ylabel(f"{name}\n{unit}", va="top", linespacing=1.1)
    axes.yaxis.set_label_coords(-(_LEFT - 3) / _INNER, 0.5)  # off the edge whatever the numbers
    axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes.locator_params(axis="y", nbins=4)
    axes.locator_params(axis="x", nbins=6)
    axes.set_title(panel.note, loc="right", size=LABEL_SIZE, color=panel.colour, pad=2)
    if panel.zone:
        axes.axhspan(-panel.zone, panel.zone, color="0.88", linewidth=0)
    shown = (panel.time >= window[0]) & (panel.time <= window[1])
    value = np.clip(panel.value[shown], -_LARGEST, _LARGEST)
    curve = stretches(panel.time[shown], value, largest_gap, MOST_POINTS)
    if not curve:
        words = textwrap.fill(panel.empty or "no data in this time", 42)
        axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])
        return
    time, value = (_with_gaps(columns) for columns in zip(*curve, strict=True))
    axes.plot(time, value, color=panel.colour, label=panel.label)
    low, high = min(0.0, float(np.nanmin(value))), max(0.0, float(np.nanmax(value)))
    if panel.band is not None:
        low, high = _draw_band(axes, panel.band, low, high)
    if panel.mean is not None:
        axes.axhline(panel.mean, color=RED, linewidth=0.9, label="mean")
    margin = max(0.06 * ((high - low) or 1.0), (panel.least - (high - low)) / 2)
    limits = [low - margin, high + margin]
    if panel.maximum:
        upwards = _draw_maximum(axes, panel, window)
        limits[upwards] += 3 * margin if upwards else -3 * margin  # room for the words
    axes.set_ylim(panel.limits or (limits[0], limits[1]))


def _draw_band(axes: Axes, band: Band, low: float, high: float) -> Interval:
    """Draw the band behind the curve; return the values that the axis has to show with it."""
    below, above = band.centre - band.half, band.centre + band.half
    axes.fill_between(band.time, below, above, color="0.88", linewidth=0, zorder=0, label="band")
    axes.plot(
        band.time, band.centre, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)), label="zero"
    )
    return min(low, float(below.min())), max(high, float(above.max()))


def _with_gaps(parts: Iterable[Array]) -> Array:
    return np.concatenate([piece for part in parts for piece in ([np.nan], part)][1:])


def _draw_maximum(axes: Axes, panel: Panel, window: Interval) -> bool:
    """Mark the largest absolute value; return whether it is positive."""
    place = largest_at(panel.value) or 0
    time, value = float(panel.time[place]), float(panel.value[place])
    height = min(max(value, -_LARGEST), _LARGEST)
    upwards = value >= 0
    axes.axhline(height, color=RED, linewidth=0.6)
    axes.plot([time], [height], "o", color=RED, markersize=4, label="maximum")
    words = f"{panel.maximum}, at {time:.2f} s"
    at = _INNER * (time - window[0]) / (window[1] - window[0])
    left = max(0.0, min(at, _INNER + _RIGHT - text_width(words, _SIZE)))
    axes.annotate(
        words,
        (time, height),
        xytext=(left - at, 5 if upwards else -5),
        textcoords="offset points",
        color=RED,
        va="bottom" if upwards else "top",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
    )
    return upwards


def _draw_marks(axes: Axes, events: Events, window: Interval) -> None:
    finest = (window[1] - window[0]) / (2 * _INNER)  # lines that cannot be told apart
    for mark, every in events.items():
        instants = np.array(inside(every, window))
        times = instants[np.unique(np.round(instants / finest), return_index=True)[1]]
        line = axes.plot(
            np.repeat(times, 3),
            np.tile([0.0, 1.0, np.nan], times.size),
            color=GREY,
            linewidth=0.7,
            zorder=1,
            label=str(mark),
            transform=axes.get_xaxis_transform(),
        )[0]
        line.set_linestyle(_DASHES[mark])


def _draw_label(axes: Axes, label: EventLabel, base: float, height: float) -> None:
    above = 3 + base
    axes.axvline(label.time, 1, 1 + above / height, color=GREY, linewidth=0.5, clip_on=False)
    axes.annotate(
        label.text,
        (label.time, 1),
        xycoords=("data", "axes fraction"),
        xytext=(label.left + 1, height + above),
        textcoords="axes points",
        size=LABEL_SIZE,
        color=GREY,
        annotation_clip=False,
    )
