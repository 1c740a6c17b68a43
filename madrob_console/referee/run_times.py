"""Times of a run as people read and type them."""

from __future__ import annotations

import math


def relative_text(at: float | None, start: float | None) -> str:
    """A time since the start, s with three decimals, with one where it is long; `-` for none."""
    if at is None or start is None:
        return "-"
    return f"{at - start:.3f}" if abs(at - start) < 900 else f"{at - start:.1f}"


def seconds_of(text: str) -> float | None:
    """Seconds that somebody typed: `12.5`, `6.5 s`, `-3`, `1:05.2`; None for anything else."""
    minutes, colon, rest = text.strip().removesuffix("s").rpartition(":")
    sign = -1.0 if minutes.startswith("-") else 1.0
    try:
        whole = abs(int(minutes)) if colon else 0
        typed = sign * (60.0 * whole + float(rest))
    except (ValueError, OverflowError):
        return None
    return typed if math.isfinite(typed) else None
