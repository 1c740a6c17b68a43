"""Curves as stretches without gaps, thinned for those who draw them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoring.kinematics import Array


def stretches(
    time: Array, value: Array, largest_gap: float, most: int
) -> list[tuple[Array, Array]]:
    """The finite values, thinned so that no extreme is lost.

    Args:
        time: s, shape (n,).
        value: shape (n,); what is not finite ends a stretch.
        largest_gap: a longer interval between two rows ends one, too, s.
        most: points that all stretches may have together.

    Returns:
        Times and values of each stretch, none of them empty.
    """
    finite = np.flatnonzero(np.isfinite(time) & np.isfinite(value))
    if not finite.size:
        return []
    time, value = time[finite], value[finite]
    broken = (np.diff(time) > largest_gap) | (np.diff(finite) > 1)
    stretch = np.concatenate(([0], np.cumsum(broken)))
    kept = _extremes(value, most)
    time, value, stretch = time[kept], value[kept], stretch[kept]
    borders = np.flatnonzero(np.diff(stretch)) + 1
    return list(zip(np.split(time, borders), np.split(value, borders), strict=True))


def _extremes(value: Array, most: int) -> NDArray[np.intp]:
    """The rows that stay: all of few, else the smallest and the largest of each part."""
    if value.size <= most:
        return np.arange(value.size)
    parts = most // 2
    size, longer = divmod(value.size, parts)
    border = longer * (size + 1)  # the first parts have one row more
    kept = []
    for begin, rows, width in ((0, value[:border], size + 1), (border, value[border:], size)):
        table = rows.reshape(-1, width)
        if table.size:
            first = begin + np.arange(len(table)) * width
            kept += [first + table.argmin(axis=1), first + table.argmax(axis=1)]
    return np.unique(np.concatenate(kept))
