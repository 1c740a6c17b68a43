"""Amounts, as people say them."""

from __future__ import annotations

from collections.abc import Sequence

_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))
_WHOLE_MINUTES = 5  # from here on seconds say nothing


def size_words(size: float) -> str:
    """Bytes, in the unit that says something: `1.5 GB`, `730 kB`, `12 B`."""
    for unit, factor in _UNITS:
        if size >= 0.9995 * factor:
            number = size / factor
            return f"{number:.0f} {unit}" if number >= 99.95 else f"{number:.1f} {unit}"
    return f"{size:.0f} B"


def span_words(span: float) -> str:
    """A time that has passed, or is left, s: `8 s`, `1 min 8 s`, `12 min`, `1 h 05 min`, `3 days`.

    Of the smallest unit that is told only whole ones count; a span is never told as nothing.
    """
    seconds = max(1, int(span))
    minutes, rest = divmod(seconds, 60)
    if not minutes:
        return f"{rest} s"
    if minutes < _WHOLE_MINUTES:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if not hours:
        return f"{minutes} min"
    return f"{hours} h {minutes:02d} min" if hours < 48 else f"{hours // 24} days"


def duration_words(duration: float) -> str:
    """A time, s, as people say it: `11 h`, `40 min`, `90 s`."""
    if duration >= 100 * 3600:
        return f"{min(duration / 86400, 9999):.0f} days"
    if duration >= 2 * 3600:
        return f"{duration / 3600:.0f} h"
    if duration < 120:
        return f"{duration:.0f} s"
    return f"{duration / 60:.0f} min"


def listed(names: Sequence[str], most: int = 2) -> str:
    """Names, the first ones of many: `/a, /b and 3 more`."""
    more = len(names) - most
    return f"{', '.join(names[:most])}{f' and {more} more' if more > 0 else ''}"


def counted(number: int, noun: str) -> str:
    """How many of something there are: `1 topic`, `2 topics`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
