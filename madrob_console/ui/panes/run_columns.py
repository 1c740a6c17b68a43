"""Columns that the history and the standings share: numbers, names, indicators."""

from __future__ import annotations

from collections.abc import Callable

from madrob_console.ui.cells.columns import Column, Row
from madrob_console.ui.cells.lines import Span, Tone
from scoring.indicator_table import IndicatorName

MISSING = Span("-", Tone.DIM)
"""Where there is no value."""


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


def indicator_column(name: IndicatorName, value: Callable[[Row], float | None]) -> Column[Row]:
    """The column of an indicator.

    Args:
        name: which one.
        value: what a row has of it, in its unit; None = no value.
    """
    spec = name.spec
    width = len(spec.column) + 1

    def cell(row: Row) -> Span:
        found = value(row)
        return MISSING if found is None else Span(number_text(found, spec.decimals, width))

    return Column(
        spec.column,
        f"{name.words} ({spec.unit})",
        cell,
        value,
        width,
        right=True,
        falling=spec.higher_is_better,
    )


def number_text(value: float, decimals: int, width: int) -> str:
    """A number in at most `width` cells: counts as they are, very large ones in powers of ten."""
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    small = value != 0 and abs(value) < 0.5 * 10**-decimals
    return f"{value:.1e}" if small or len(text) > width else text
