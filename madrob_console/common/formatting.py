"""Amounts, times and lists in words: what screens, pages, messages and files say alike."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

_WHOLE_MINUTES = 5  # from here on seconds say nothing


def counted(number: int, noun: str) -> str:
    """A number with its noun: `1 topic`, `2 topics`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(names: Sequence[str], most: int = 2) -> str:
    """The first of many names: `/a, /b and 3 more`."""
    more = len(names) - most
    return f"{', '.join(names[:most])}{f' and {more} more' if more > 0 else ''}"


def format_size(size: float) -> str:
    """Bytes in a fitting unit: `12 B`, `730 kB`, `1.5 GB`."""
    units = iter(("B", "kB", "MB", "GB"))
    unit = next(units)
    while size >= 999.5 and unit != "TB":
        size, unit = size / 1000, next(units, "TB")
    return f"{size:.0f} {unit}" if unit == "B" or size >= 99.95 else f"{size:.1f} {unit}"


def format_span(span: float) -> str:
    """A span, s, rounded down but never to nothing: `8 s`, `1 min 8 s`, `1 h 05 min`, `3 days`."""
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


def format_duration(duration: float) -> str:
    """A duration that is estimated, s, in one unit: `90 s`, `15 min`, `11 h`, `5 days`."""
    if duration >= 100 * 3600:
        return f"{min(duration / 86400, 9999):.0f} days"
    if duration >= 2 * 3600:
        return f"{duration / 3600:.0f} h"
    return f"{duration:.0f} s" if duration < 120 else f"{duration / 60:.0f} min"


def relative_text(at: float | None, start: float | None) -> str:
    """A time since the start, s with three decimals, with one where it is long; `-` for none."""
    if at is None or start is None:
        return "-"
    return f"{at - start:.3f}" if abs(at - start) < 900 else f"{at - start:.1f}"


def seconds_of(text: str) -> float | None:
    """Parses typed seconds: `12.5`, `6.5 s`, `-3`, `1:05.2`; None for anything else."""
    minutes, colon, rest = text.strip().removesuffix("s").rpartition(":")
    sign = -1.0 if minutes.startswith("-") else 1.0
    try:
        whole = abs(int(minutes)) if colon else 0
        typed = sign * (60.0 * whole + float(rest))
    except (ValueError, OverflowError):
        return None
    return typed if math.isfinite(typed) else None


def time_of_day(at: float) -> str:
    """Local: `14:28:05`."""
    return time.strftime("%H:%M:%S", time.localtime(at))


def time_words(at: float) -> str:
    """Local: `21 Nov 14:28`."""
    return time.strftime("%d %b %H:%M", time.localtime(at))


def date_of(at: float) -> str:
    """Local: `2026-11-21 14:28:05`."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at))


def utc_text(at: float) -> str:
    """`2026-11-21 13:28:05 UTC`."""
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(at))
