"""How far two computations of one result agree, and by which libraries each (section 11)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields
from enum import StrEnum

from scoring.libraries import Libraries

CLOSEST = 1e-9
"""Relative; libraries that round otherwise stay far below it."""

_NAMES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "pandas": "pandas"}
"""As they call themselves."""


class Grade(StrEnum):
    """How a stored result compares with what its recording gives."""

    SAME = "same digits"
    CLOSE = "equal to 1e-9"
    DIFFERS = "differs"

    @classmethod
    def of(cls, stored: object, now: object) -> Grade:
        """Of one value that was computed: numbers may differ in their last digits, nothing else.

        Args:
            stored: the value that was stored.
            now: what it is now.
        """
        if stored == now:
            return cls.SAME
        numbers = isinstance(stored, float) and isinstance(now, float)
        if numbers and math.isclose(stored, now, rel_tol=CLOSEST):  # type: ignore[arg-type]
            return cls.CLOSE
        return cls.DIFFERS

    @classmethod
    def worst(cls, grades: Iterable[Grade]) -> Grade:
        """Of the parts, that of the whole."""
        return max(grades, key=list(cls).index, default=cls.SAME)


def libraries_told(stored: Libraries | None, now: Libraries) -> str:
    """Which libraries computed a stored result and which compute now, in words.

    Args:
        stored: None = the result does not say, it is of an older version.
        now: those of this process.
    """
    names = [(each.name, _NAMES[each.name]) for each in fields(Libraries)]
    here = ", ".join(f"{name} {getattr(now, key)}" for key, name in names)
    if stored is None:
        return f"the stored result does not name its libraries, now {here}"
    if stored == now:
        return f"the same libraries ({here}): another processor, or a changed file"
    changed = (
        f"{name} {getattr(stored, key)} stored, {getattr(now, key)} now"
        for key, name in names
        if getattr(stored, key) != getattr(now, key)
    )
    return f"libraries differ: {'; '.join(changed)}"
