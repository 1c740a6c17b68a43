"""Columns that the history and the standings share: numbers, names, indicators."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from madrob_console.ui.cells.columns import Column, Row
from madrob_console.ui.cells.lines import Span, Tone
from scoring.indicator_table import IndicatorName
from scoring.result import DOUBTED, Uncertainty, value_text

MISSING = Span("-", Tone.DIM)
"""Where there is no value."""

_LARGE = 1e4
"""Of such a number the power of ten is told rather than all its digits."""


def number_column(
    title: str, meaning: str, value: Callable[[Row], int | None], width: int
) -> Column[Row]:
    """The column of a whole number."""

    def cell(row: Row) -> Span:
        found = value(row)
        return MISSING if found is None else Span(str(found))

    return Column(title, meaning, cell, value, width, right=True)


def text_column(
    title: str,
    meaning: str,
    value: Callable[[Row], str],
    width: int,
    *,
    ample: int = 0,
    comfort: bool = False,
) -> Column[Row]:
    """The column of a text, sorted without regard to case; an empty one comes last."""
    return Column(
        title,
        meaning,
        lambda row: Span(value(row)),
        lambda row: value(row).casefold() or None,
        width,
        ample,
        comfort=comfort,
    )


class Shown(NamedTuple):
    """What a row has of an indicator.

    Attributes:
        value: in its unit; None = no value.
        uncertainty: of the value; None = not known.
        signs: what stands directly behind it.
    """

    value: float | None
    uncertainty: Uncertainty | None = None
    signs: str = ""


def indicator_column(
    name: IndicatorName, shown: Callable[[Row], Shown], signs: Callable[[], int] = lambda: 1
) -> Column[Row]:
    """The column of an indicator.

    Args:
        name: which one.
        shown: what a row has of it.
        signs: the most that stand behind a value now; all values leave room for them.
    """
    spec = name.spec
    width = len(spec.column) + 1

    def cell(row: Row) -> Span:
        found = shown(row)
        behind = f"{found.signs:<{signs()}}"
        if found.value is None:
            return Span(f"{MISSING.text}{behind}", MISSING.tone)
        text = number_text(found.value, spec.decimals, width - len(behind), found.uncertainty)
        return Span(f"{text}{behind}", Tone.WARN if DOUBTED in behind else Tone.PLAIN)

    return Column(
        spec.column,
        f"{name.words} ({spec.unit})",
        cell,
        lambda row: shown(row).value,
        width,
        right=True,
        falling=spec.higher_is_better,
    )


def number_text(
    value: float, decimals: int, width: int, uncertainty: Uncertainty | None = None
) -> str:
    """A number in at most `width` cells: counts as they are, very large ones in powers of ten.

    It has no digit that its uncertainty does not leave, and less decimals where there is no room.
    """
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    if uncertainty is not None and uncertainty.expanded:
        text = min(text, value_text(value, uncertainty), key=len)
    while len(text) > width and "." in text and "e" not in text and abs(value) < _LARGE:
        decimals -= 1
        text = f"{value:.{decimals}f}"
    small = value != 0 and abs(value) < 0.5 * 10**-decimals
    if not small and len(text) <= width:
        return text
    powers = f"{value:.1e}"
    return powers if len(powers) <= width else f"{value:.0e}"
