"""Drawings over time that are as wide as the place they stand in, as SVG without matplotlib.

Across, everything is in percent of the width; letters and heights are in pixels and stay as they
are, on a phone and on a wide screen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape, quoteattr

from scoring.figures.event_labels import Interval

LETTERS = 11
"""Height of letters, px."""

TICK_ROOM = 20
"""What a time axis needs below a drawing, px."""

_LETTER = 0.6 * LETTERS
_NARROWEST = 230.0  # px: on a phone, beside the names of the lanes
_MOST_TICKS = 6
_STEPS = (1, 2, 5, 10)


def across(time: float, window: Interval) -> float:
    """Where a time stands, percent of the width; beyond the window at its end."""
    part = (time - window[0]) / (window[1] - window[0])
    return round(100 * min(max(part, 0.0), 1.0), 3)


def bars(spans: Iterable[Interval], window: Interval, top: float, height: float) -> str:
    """A bar for each span that touches the window, s; `top` and `height` in px."""
    drawn = []
    for begin, end in spans:
        if begin < window[1] and end > window[0]:
            left = across(begin, window)
            width = max(round(across(end, window) - left, 3), 0.15)  # a short one is seen, too
            drawn.append(
                f'<rect x="{left:g}%" y="{top:g}" width="{width:g}%" height="{height:g}"/>'
            )
    return "".join(drawn)


def line(time: float, window: Interval, top: float, bottom: float) -> str:
    """An upright line, from `top` to `bottom` in px."""
    left = across(time, window)
    return f'<line x1="{left:g}%" x2="{left:g}%" y1="{top:g}" y2="{bottom:g}"/>'


def words(time: float, window: Interval, baseline: float, text: str) -> str:
    """Words at a time that stay within the drawing and hide lines, on a baseline in px."""
    left = across(time, window)
    anchor, aside = ("start", 2) if left <= 50 else ("end", -2)
    return (
        f'<text x="{left:g}%" dx="{aside}" y="{baseline:g}" text-anchor="{anchor}" '
        'style="stroke: #ffffff; stroke-width: 3; paint-order: stroke">'
        f"{escape(text)}</text>"
    )


def rows_of_words(marks: Sequence[tuple[float, str]], window: Interval) -> list[int]:
    """In which row each of some words stands, so that none meets another one on a phone either.

    Args:
        marks: times and words, by time.
        window: the time that is shown, s.
    """
    ends: list[list[Interval]] = []
    rows = []
    for time, text in marks:
        left, width = across(time, window) / 100 * _NARROWEST, _LETTER * len(text) + 4
        begin = left if left <= _NARROWEST / 2 else left - width
        taken = (begin, begin + width)
        free = (
            row
            for row, others in enumerate(ends)
            if all(taken[1] <= a or b <= taken[0] for a, b in others)
        )
        row = next(free, len(ends))
        if row == len(ends):
            ends.append([])
        ends[row].append(taken)
        rows.append(row)
    return rows


def ticks(window: Interval) -> list[float]:
    """Round times within a window, at most seven."""
    span = (window[1] - window[0]) / _MOST_TICKS
    power = 10.0 ** math.floor(math.log10(span))
    step = next(n * power for n in _STEPS if n * power >= span * (1 - 1e-9))
    first, last = math.ceil(window[0] / step - 1e-9), math.floor(window[1] / step + 1e-9)
    return [round(n * step, 9) + 0.0 for n in range(first, last + 1)]


def axis(window: Interval, top: float) -> str:
    """A time axis with its numbers, s; `top` in px."""
    drawn = [f'<line x1="0" x2="100%" y1="{top:g}" y2="{top:g}"/>']
    for tick in ticks(window):
        left = across(tick, window)
        anchor = "start" if left < 4 else "end" if left > 96 else "middle"
        drawn.append(
            f'<line x1="{left:g}%" x2="{left:g}%" y1="{top:g}" y2="{top + 4:g}"/>'
            f'<text stroke="none" x="{left:g}%" y="{top + 16:g}" text-anchor="{anchor}">'
            f"{tick:g}</text>"
        )
    return "".join(drawn)


def drawing(parts: Iterable[str], height: float, alternative: str) -> str:
    """The parts as one SVG element.

    Args:
        parts: from behind to the front.
        height: px.
        alternative: what it shows, for those who cannot see it.
    """
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="100%" height="{height:g}" role="img" '
        f'aria-label={quoteattr(alternative)} style="font: {LETTERS}px sans-serif">'
        f"{''.join(parts)}</svg>"
    )
