"""The scale of an indicator in drawings of many runs: which values are shown, and where."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from scoring.figures.event_labels import Interval
from scoring.figures.fluid import ticks

FAILED = "\N{MULTIPLICATION SIGN}"
"""The mark of a run that was not completed."""

_ROOM = 0.08
"""Beyond the smallest and the largest value, as a part of what lies between."""


def shown_values(leading: Sequence[float], others: Iterable[float] = ()) -> Interval:
    """The values that a drawing shows, with room at both ends.

    Args:
        leading: they are all shown.
        others: shown where they fit; they decide only where there are no leading ones.
    """
    values = leading or tuple(others) or (0.0, 1.0)
    low, high = min(values), max(values)
    room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
    return low - room, high + room


def few_ticks(window: Interval, most: int) -> list[float]:
    """Round values within a window, not many more than `most`."""
    found = ticks(window)
    return found[:: max(1, round(len(found) / most))]
