"""Draws curves over time: panels above each other, one time axis, events as labelled lines.

Sizes are in points. See `plots` for what is drawn.
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
from scoring.figures.event_labels import EventLabel, Interval, inside, labels_of, rows_of
from scoring.figures.stretches import stretches
from scoring.kinematics import Array
from scoring.result import value_text

Events = Mapping[EventMark, Sequence[float]]

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
    limits: Interval | None = None
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
    """Panels above each other.

    Args:
        title: in the head.
        panels: one or two, from above.
        events: when each took place, s; those of the window are drawn.
        window: the time that is shown, s.
        largest_gap: curves are broken at longer intervals, s.
    """
    if window[1] <= window[0]:
        window = (window[0], window[0] + 1.0)
    labels = labels_of(events, window, _INNER, _RIGHT)
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
        _draw_marks(axes[-1], events, window)
        axes[-1].tick_params(labelbottom=panel is panels[-1])
    for label, row in zip(labels, rows, strict=True):
        _draw_label(axes[0], label, row, heights[0])
    axes[-1].set_xlabel("time from the run's start, s")
    return figure


def largest_at(value: Array) -> int | None:
    """Where the largest absolute value is; None where no value is finite."""
    finite = np.flatnonzero(np.isfinite(value))
    return int(finite[np.argmax(np.abs(value[finite]))]) if finite.size else None


def _draw_panel(axes: Axes, panel: Panel, window: Interval, largest_gap: float) -> None:
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
    curve = stretches(panel.time[shown], value, largest_gap, MOST_POINTS)
    if not curve:
        words = textwrap.fill(panel.empty or "no data in this time", 42)
        axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center")
        axes.set_yticks([])
        return
    time, value = (_with_gaps(columns) for columns in zip(*curve, strict=True))
    axes.plot(time, value, color=panel.colour, label=panel.label)
    low, high = min(0.0, float(np.nanmin(value))), max(0.0, float(np.nanmax(value)))
    margin = 0.06 * ((high - low) or 1.0)
    limits = [low - margin, high + margin]
    if panel.unit_of_maximum:
        upwards = _draw_maximum(axes, panel, window)
        limits[upwards] += 3 * margin if upwards else -3 * margin  # room for the words
    axes.set_ylim(panel.limits or (limits[0], limits[1]))


def _with_gaps(parts: Iterable[Array]) -> Array:
    """The parts in one array, with NaN between them."""
    return np.concatenate([piece for part in parts for piece in ([np.nan], part)][1:])


def _draw_maximum(axes: Axes, panel: Panel, window: Interval) -> bool:
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


def _draw_marks(axes: Axes, events: Events, window: Interval) -> None:
    finest = (window[1] - window[0]) / (4 * _INNER)  # lines that cannot be told apart
    for mark, every in events.items():
        times = np.unique(np.round(np.array(inside(every, window)) / finest)) * finest
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


def _draw_label(axes: Axes, label: EventLabel, row: int, height: float) -> None:
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
