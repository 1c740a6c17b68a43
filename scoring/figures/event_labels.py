"""The labels of events above a figure, placed in rows so that none overlaps; in points."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scoring.figure_table import EventMark

Interval = tuple[float, float]
"""From and to, s."""

LABEL_SIZE = 9.5

_LETTER = 0.586  # a letter's width on average, and a bit more, of its size


@dataclass(frozen=True, slots=True)
class EventLabel:
    """A label above the panels; its line and left end are measured from the axes' left."""

    text: str
    time: float
    line: float
    left: float

    @property
    def right(self) -> float:
        return self.left + text_width(self.text)


def labels_of(
    events: Mapping[EventMark, Sequence[float]], window: Interval, width: float, beyond: float
) -> list[EventLabel]:
    """One label for each kind of event in the window: of its first time, or a last closing.

    Times are in s; `beyond` is the room for words to the right of the axes' `width`.
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
        labels.append(
            EventLabel(text, time, line, min(line, width + beyond - text_width(text) - 2))
        )
    return labels


def inside(times: Sequence[float], window: Interval) -> list[float]:
    return sorted(time for time in times if window[0] <= time <= window[1])


def rows_of(labels: Sequence[EventLabel]) -> tuple[int, ...]:
    """The row of each label, so that no label or line runs through another one."""

    def cost(rows: tuple[int, ...]) -> tuple[int, int, int]:
        pairs = list(itertools.permutations(zip(labels, rows, strict=True), 2))
        overlaps = sum(r == s and a.left < b.right and b.left < a.right for (a, r), (b, s) in pairs)
        crossings = sum(r > s and b.left < a.line < b.right for (a, r), (b, s) in pairs)
        return overlaps, crossings, sum(rows)

    count = len(labels)
    return min(itertools.product(range(count), repeat=count), key=cost)


def text_width(text: str, size: float = LABEL_SIZE) -> float:
    """At most what a text takes in letters of a size."""
    return _LETTER * size * len(text)
