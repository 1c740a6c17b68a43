"""Amounts, as people say them."""

from __future__ import annotations

_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))


def size_words(size: float) -> str:
    """Bytes, in the unit that says something: `1.5 GB`, `730 kB`, `12 B`."""
    for unit, factor in _UNITS:
        if size >= 0.9995 * factor:
            number = size / factor
            return f"{number:.0f} {unit}" if number >= 99.95 else f"{number:.1f} {unit}"
    return f"{size:.0f} B"


def counted(number: int, noun: str) -> str:
    """How many of something there are: `1 topic`, `2 topics`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
