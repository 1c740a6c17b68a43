"""The figures of the protocol document for one run, as vector or pixel graphics (section 6).

The document shows its figures 2 to 4 for three runs; for one run, 2 is the whole run, 3 the
opening and 4 the closing. Importing this module loads matplotlib: import it where you draw.
Like matplotlib, it draws in one thread at a time.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scoring.figures.drawing import BLUE, Panel, draw_sheet
from scoring.figures.event_labels import Mark, Window
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import EventName, Outcome
from scoring.result import Indicator, Result, value_text
from scoring.rows import Rows

Array = NDArray[np.float64]

LARGEST_JERK = 2.0
"""Jerk is drawn up to here, as in the document, rad/s^3."""

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


class FigureName(StrEnum):
    """The figures in the document's order, named like their files."""

    ACCELERATION = "figure_1_acceleration"
    JERK = "figure_2_jerk"
    JERK_OF_THE_OPENING = "figure_3_jerk_of_the_opening"
    JERK_OF_THE_CLOSING = "figure_4_jerk_of_the_closing"
    FORCE = "figure_5_force"

    @property
    def number(self) -> int:
        """As the document counts, 1..5."""
        return list(FigureName).index(self) + 1


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
        return [e.time - self.result.start for e in self.result.events if e.name is name]

    @property
    def window(self) -> Window:
        """What a figure of the whole run shows: the run, and all data of it."""
        stop = self.result.ending.stop
        times = [0.0] if stop is None else [0.0, stop - self.result.start]
        for series in (self.door_time, self.rows.force_time - self.result.start):
            times += [float(series[0]), float(series[-1])] if series.size else []
        return min(times), max(times)

    def opening(self) -> Window | None:
        """From the first opening until the panel is nearly as far as it goes."""
        opened = min(self.times(EventName.DOOR_OPENS), default=None)
        if opened is None:
            return None
        far = self._far(self.door_time >= opened)
        return None if not far.size else self._around(opened, float(far[0]))

    def closing(self) -> Window | None:
        """From when the panel was last nearly as far as it went until the last closing."""
        closed = max(self.times(EventName.DOOR_CLOSES), default=None)
        if closed is None:
            return None
        far = self._far(self.door_time <= closed)
        return None if not far.size else self._around(float(far[-1]), closed)

    def _far(self, rows: NDArray[np.bool_]) -> Array:
        time, angle = self.door_time[rows], np.abs(self.rows.joint_state.position[rows])
        return time[angle >= _FAR * angle.max()] if angle.size else time

    def _around(self, begin: float, end: float) -> Window:
        first, last = self.window
        return max(first, begin - _MARGIN), min(last, end + _MARGIN)


def figures_of(result: Result, rows: Rows) -> dict[FigureName, Figure]:
    """The figures of a run by `FigureName`; `missing_figures` says why one is not there.

    Args:
        result: of the run.
        rows: its pre-processed data.
    """
    run = _Run(result, rows)
    missing = missing_figures(result, rows)
    with _look():
        return {name: _draw(run, name) for name in FigureName if name not in missing}


def missing_figures(result: Result, rows: Rows) -> Mapping[FigureName, str]:
    """The figures that a run does not have, and why, in words."""
    if result.ending.outcome is Outcome.ABORTED:
        return dict.fromkeys(FigureName, "the run was aborted and is invalid")
    run = _Run(result, rows)
    missing: dict[FigureName, str] = {}
    if not run.door_time.size:
        missing = dict.fromkeys(FigureName, "no door angle was recorded during the run")
        del missing[FigureName.FORCE]
    else:
        if run.opening() is None:
            missing[FigureName.JERK_OF_THE_OPENING] = "the door never opened"
        if run.closing() is None:
            missing[FigureName.JERK_OF_THE_CLOSING] = "the door never closed"
    if not np.isfinite(rows.force).any():
        missing[FigureName.FORCE] = "no handle force was recorded during the run"
    return missing


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


def _draw(run: _Run, name: FigureName) -> Figure:
    smoothness = run.result.indicator(IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION)
    match name:
        case FigureName.ACCELERATION:
            return _acceleration(run)
        case FigureName.JERK:
            return _jerk(run, name, _finding(smoothness), run.window)
        case FigureName.JERK_OF_THE_OPENING:
            return _jerk(run, name, "jerk while the door opens", run.opening() or run.window)
        case FigureName.JERK_OF_THE_CLOSING:
            return _jerk(run, name, "jerk while the door closes", run.closing() or run.window)
        case FigureName.FORCE:
            return _force(run)


def _acceleration(run: _Run) -> Figure:
    indicator = run.result.indicator(IndicatorName.UNSAFETY_OF_DOOR_OPERATION)
    signal = Panel(
        "acceleration, rad/s²",
        BLUE,
        run.door_time,
        run.rows.low_passed,
        unit_of_maximum="rad/s²",
        note="low-passed",
        empty=indicator.reason or "",
    )
    return _sheet(run, FigureName.ACCELERATION, _finding(indicator), run.window, signal)


def _jerk(run: _Run, name: FigureName, finding: str, window: Window) -> Figure:
    time, jerk = run.rows.jerk_time - run.result.start, np.abs(run.rows.jerk)
    shown = jerk[(time >= window[0]) & (time <= window[1])]
    largest = float(np.max(shown, initial=0.0))
    clipped = f"clipped at {LARGEST_JERK:g}, largest {value_text(largest)} rad/s³"
    signal = Panel(
        "abs jerk, rad/s³",
        BLUE,
        time,
        np.minimum(jerk, LARGEST_JERK),
        limits=(0.0, LARGEST_JERK * 1.02),
        note=clipped if largest > LARGEST_JERK else "",
        empty=run.result.indicator(IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION).reason or "",
    )
    return _sheet(run, name, finding, window, signal)


def _force(run: _Run) -> Figure:
    indicator = run.result.indicator(IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION)
    time = run.rows.force_time - run.result.start
    signal = Panel("force, N", BLUE, time, run.rows.force, unit_of_maximum="N")
    title = _title(FigureName.FORCE, _finding(indicator))
    return draw_sheet(title, [signal], _marks(run), run.window, run.rows.thresholds.largest_gap)


def _sheet(run: _Run, name: FigureName, finding: str, window: Window, signal: Panel) -> Figure:
    """The position above a signal of the panel."""
    position = Panel.of_position(
        run.door_time, run.rows.joint_state.position, run.rows.thresholds.closed_angle
    )
    gap = run.rows.thresholds.largest_gap
    return draw_sheet(_title(name, finding), [position, signal], _marks(run), window, gap)


def _title(name: FigureName, finding: str) -> str:
    return f"Figure {name.number}   {finding}"


def _finding(indicator: Indicator) -> str:
    words = indicator.name.words
    if indicator.value is None:
        return f"{words}: none"
    return f"{words} {value_text(indicator.value)} {unit_text(indicator.unit)}"


def _marks(run: _Run) -> Sequence[Mark]:
    crossing = EventName.moves_to(run.result.condition.destination_side)
    marks = (
        Mark("touch", run.times(EventName.HANDLE_IS_TOUCHED)),
        Mark("opening", run.times(EventName.DOOR_OPENS)),
        Mark("crossing", run.times(crossing)),
        Mark("closing", run.times(EventName.DOOR_CLOSES), last_counts=True),
    )
    return [mark for mark in marks if mark.times]
