"""Where the names of events stand above a figure, so that none runs into another one.

Lengths are in points.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scoring.figure_table import EventMark

Interval = tuple[float, float]
"""From and to, s."""

LABEL_SIZE = 9.5
"""Of their letters."""

_LETTER = 0.586 * LABEL_SIZE  # a letter's width on average, and a bit more


@dataclass(frozen=True, slots=True)
class EventLabel:
    """A label above the panels: the place of its line and of its left end, from the axes' left."""

    text: str
    time: float
    line: float
    left: float

    @property
    def right(self) -> float:
        """Where the words end."""
        return self.left + _width(self.text)


def labels_of(
    events: Mapping[EventMark, Sequence[float]], window: Interval, width: float, beyond: float
) -> list[EventLabel]:
    """One label for each kind of event in the window: of its first time, or a last closing.

    Args:
        events: when each took place, s.
        window: the time that is shown, s.
        width: of the axes.
        beyond: how far to their right there is room for words.
    """
    labels = []
    for mark, times in events.items():
        shown = inside(times, window)
        if not shown:
            continue
        time = shown[-1 if mark is EventMark.CLOSING else 0]
        text = str(mark)
        if len(times) > 1:
            text = f"{mark} {sorted(times).index(time) + 1} of {len(times)}"
        line = width * (time - window[0]) / (window[1] - window[0])
        labels.append(EventLabel(text, time, line, min(line, width + beyond - _width(text) - 2)))
    return labels


def inside(times: Sequence[float], window: Interval) -> list[float]:
    """The times that lie in a window, in order."""
    return sorted(time for time in times if window[0] <= time <= window[1])


def rows_of(labels: Sequence[EventLabel]) -> tuple[int, ...]:
    """In which row each label stands, so that no label or line runs through another one."""

    def cost(rows: tuple[int, ...]) -> tuple[int, int, int]:
        pairs = list(itertools.permutations(zip(labels, rows, strict=True), 2))
        overlaps = sum(r == s and a.left < b.right and b.left < a.right for (a, r), (b, s) in pairs)
        crossings = sum(r > s and b.left < a.line < b.right for (a, r), (b, s) in pairs)
        return overlaps, crossings, sum(rows)

    count = len(labels)
    return min(itertools.product(range(count), repeat=count), key=cost)


def _width(text: str) -> float:
    return _LETTER * len(text)
