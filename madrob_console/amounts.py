"""Amounts, as people say them."""

from __future__ import annotations

from collections.abc import Sequence

_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))


def size_words(size: float) -> str:
    """Bytes, in the unit that says something: `1.5 GB`, `730 kB`, `12 B`."""
    for unit, factor in _UNITS:
        if size >= 0.9995 * factor:
            number = size / factor
            return f"{number:.0f} {unit}" if number >= 99.95 else f"{number:.1f} {unit}"
    return f"{size:.0f} B"


def listed(names: Sequence[str], most: int = 2) -> str:
    """Names, the first ones of many: `/a, /b and 3 more`."""
    more = len(names) - most
    return f"{', '.join(names[:most])}{f' and {more} more' if more > 0 else ''}"


def counted(number: int, noun: str) -> str:
    """How many of something there are: `1 topic`, `2 topics`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
