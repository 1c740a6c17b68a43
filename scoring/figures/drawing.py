"""Draws curves over time: panels above each other, one time axis, events as labelled lines.

Sizes are in points. See `figures.py` for what is drawn.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from scoring.figures.event_labels import Label, Mark, Window, labels_of, rows_of
from scoring.result import value_text

Array = NDArray[np.float64]

ORANGE, BLUE, RED, GREY = "#d95f02", "#1f4e9e", "#c00000", "#555555"

MOST_POINTS = 3000
"""Points of a curve: more cannot be told apart, and make a large file."""

_WIDTH, _LEFT, _RIGHT = 300.0, 50.0, 10.0
_INNER = _WIDTH - _LEFT - _RIGHT
_HEAD, _GAP, _FOOT = 20.0, 17.0, 30.0
_UPPER, _LOWER, _ONLY = 74.0, 110.0, 130.0
_LABEL_HEIGHT, _LABEL_SIZE = 10.0, 7.0
_LARGEST = 1e9  # no sensor means more, and the axes' arithmetic must not overflow


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One quantity over time.

    Attributes:
        label: its name and unit.
        colour: of the curve.
        time: s, shape (n,).
        value: shape (n,); what is not finite is a gap.
        unit_of_maximum: mark the largest absolute value in this unit; empty = do not.
        limits: of the value axis; None = what the values need.
        zone: shade +-`zone` around 0.
        note: words above the panel.
        empty: why there is no value, in words.
    """

    label: str
    colour: str
    time: Array
    value: Array
    unit_of_maximum: str = ""
    limits: Window | None = None
    zone: float = 0.0
    note: str = ""
    empty: str = ""

    @classmethod
    def of_position(cls, time: Array, position: Array, closed_angle: float) -> Panel:
        """The panel angle, rad, with the zone of a closed door."""
        return cls("position, rad", ORANGE, time, position, zone=closed_angle)


_DASHES: dict[str, LineStyleType] = {
    "touch": ":",
    "opening": "--",
    "crossing": "-.",
    "closing": (0, (7, 2)),
}


def draw_sheet(
    title: str, panels: Sequence[Panel], marks: Sequence[Mark], window: Window, largest_gap: float
) -> Figure:
    """Panels above each other.

    Args:
        title: in the head.
        panels: one or two, from above.
        marks: the events; those of the window are drawn.
        window: the time that is shown, s.
        largest_gap: curves are broken at longer intervals, s.
    """
    if window[1] <= window[0]:
        window = (window[0], window[0] + 1.0)
    labels = labels_of(marks, window, _INNER, _RIGHT)
    rows = rows_of(labels)
    heights = [_ONLY] if len(panels) == 1 else [_UPPER, _LOWER]
    head = _HEAD + _LABEL_HEIGHT * (max(rows, default=-1) + 1)
    total = head + sum(heights) + _GAP * (len(panels) - 1) + _FOOT
    figure = Figure(figsize=(_WIDTH / 72, total / 72))
    figure.text(4 / _WIDTH, 1 - 4 / total, title, va="top", weight="bold")
    bottom, axes = total - head + _GAP, []
    for panel, height in zip(panels, heights, strict=True):
        bottom -= height + _GAP
        place = (_LEFT / _WIDTH, bottom / total, _INNER / _WIDTH, height / total)
        axes.append(figure.add_axes(place))
        _draw_panel(axes[-1], panel, window, largest_gap)
        _draw_marks(axes[-1], marks, window)
        axes[-1].tick_params(labelbottom=panel is panels[-1])
    for label, row in zip(labels, rows, strict=True):
        _draw_label(axes[0], label, row, heights[0])
    axes[-1].set_xlabel("time from the run's start, s")
    return figure


def largest_at(value: Array) -> int | None:
    """Where the largest absolute value is; None where no value is finite."""
    finite = np.flatnonzero(np.isfinite(value))
    return int(finite[np.argmax(np.abs(value[finite]))]) if finite.size else None


def stretches(time: Array, value: Array, largest_gap: float) -> tuple[Array, Array]:
    """The finite values, thinned so that no extreme is lost, with NaN where there is a gap."""
    finite = np.flatnonzero(np.isfinite(time) & np.isfinite(value))
    time, value = time[finite], value[finite]
    broken = (np.diff(time) > largest_gap) | (np.diff(finite) > 1)
    stretch = np.concatenate(([0], np.cumsum(broken))) if finite.size else finite
    kept = _extremes(value)
    time, value, stretch = time[kept], value[kept], stretch[kept]
    borders = np.flatnonzero(np.diff(stretch)) + 1
    return np.insert(time, borders, np.nan), np.insert(value, borders, np.nan)


def _extremes(value: Array) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each part."""
    rows = np.arange(value.size)
    if value.size <= MOST_POINTS:
        return rows
    parts = np.array_split(rows, MOST_POINTS // 2)
    kept = [part[found(value[part])] for part in parts for found in (np.argmin, np.argmax)]
    return np.unique(kept)


def _draw_panel(axes: Axes, panel: Panel, window: Window, largest_gap: float) -> None:
    axes.set_xlim(window)
    axes.set_ylabel(panel.label, size=7.5)
    axes.yaxis.set_label_coords(-(_LEFT - 10) / _INNER, 0.5)  # off the edge whatever the numbers
    axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes.locator_params(axis="y", nbins=5)
    axes.set_title(panel.note, loc="right", size=_LABEL_SIZE, color=panel.colour, pad=2)
    if panel.zone:
        axes.axhspan(-panel.zone, panel.zone, color="0.88", linewidth=0)
    shown = (panel.time >= window[0]) & (panel.time <= window[1])
    value = np.clip(panel.value[shown], -_LARGEST, _LARGEST)
    time, value = stretches(panel.time[shown], value, largest_gap)
    if not value.size:
        words = textwrap.fill(panel.empty or "no data in this time", 42)
        axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])
        return
    axes.plot(time, value, color=panel.colour, label=panel.label)
    low, high = min(0.0, float(np.nanmin(value))), max(0.0, float(np.nanmax(value)))
    margin = 0.06 * ((high - low) or 1.0)
    limits = [low - margin, high + margin]
    if panel.unit_of_maximum:
        upwards = _draw_maximum(axes, panel, window)
        limits[upwards] += 3 * margin if upwards else -3 * margin  # room for the words
    axes.set_ylim(panel.limits or (limits[0], limits[1]))


def _draw_maximum(axes: Axes, panel: Panel, window: Window) -> bool:
    """Mark the largest absolute value; returns whether it is positive."""
    place = largest_at(panel.value) or 0
    time, value = float(panel.time[place]), float(panel.value[place])
    height = min(max(value, -_LARGEST), _LARGEST)
    upwards = value >= 0
    axes.axhline(height, color=RED, linewidth=0.6)
    axes.plot([time], [height], "o", color=RED, markersize=4, label="maximum")
    left_half = time < (window[0] + window[1]) / 2
    axes.annotate(
        f"maximum {value_text(abs(value))} {panel.unit_of_maximum}, at {time:.2f} s",
        (time, height),
        xytext=(0, 5 if upwards else -5),
        textcoords="offset points",
        color=RED,
        ha="left" if left_half else "right",
        va="bottom" if upwards else "top",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
    )
    return upwards


def _draw_marks(axes: Axes, marks: Sequence[Mark], window: Window) -> None:
    finest = (window[1] - window[0]) / (4 * _INNER)  # lines that cannot be told apart
    for mark in marks:
        times = np.unique(np.round(np.array(mark.inside(window)) / finest)) * finest
        line = axes.plot(
            np.repeat(times, 3),
            np.tile([0.0, 1.0, np.nan], times.size),
            color=GREY,
            linewidth=0.7,
            zorder=1,
            label=mark.name,
            transform=axes.get_xaxis_transform(),
        )[0]
        line.set_linestyle(_DASHES.get(mark.name, "-"))


def _draw_label(axes: Axes, label: Label, row: int, height: float) -> None:
    """The words, and a line down to the event's own."""
    above = 3 + row * _LABEL_HEIGHT
    axes.axvline(label.time, 1, 1 + above / height, color=GREY, linewidth=0.5, clip_on=False)
    axes.annotate(
        label.text,
        (label.time, 1),
        xycoords=("data", "axes fraction"),
        xytext=(label.left + 1, height + above),
        textcoords="axes points",
        size=_LABEL_SIZE,
        color=GREY,
        annotation_clip=False,
    )
