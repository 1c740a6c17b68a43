"""The eight indicators as columns of a table."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from madrob_console.ui.cells.columns import Column, Row
from madrob_console.ui.cells.lines import Span, Tone
from scoring.result import UNITS, IndicatorName

MISSING = Span("-", Tone.DIM)
"""Where there is no value."""


class _Style(NamedTuple):
    title: str
    width: int
    decimals: int
    falling: bool = False


_STYLES = {
    IndicatorName.EXECUTION_TIME: _Style("exec s", 7, 2),
    IndicatorName.TIME_TO_HANDLE: _Style("hand s", 7, 2),
    IndicatorName.DOOR_OCCUPATION_TIME: _Style("occup s", 8, 2),
    IndicatorName.PASSAGE_TIME: _Style("pass s", 7, 2),
    IndicatorName.UNSAFETY_OF_DOOR_OPERATION: _Style("unsafe", 7, 3),
    IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: _Style("smooth", 7, 3, falling=True),
    IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: _Style("rough N", 8, 2),
    IndicatorName.CAPABILITY_LEVEL: _Style("cap", 4, 2, falling=True),
}


def indicator_column(name: IndicatorName, value: Callable[[Row], float | None]) -> Column[Row]:
    """The column of an indicator.

    Args:
        name: which one.
        value: what a row has of it, in its unit; None = no value.
    """
    style = _STYLES[name]

    def cell(row: Row) -> Span:
        found = value(row)
        return MISSING if found is None else Span(number_text(found, style.decimals, style.width))

    meaning = f"{name.replace('_', ' ')} ({UNITS[name]})"
    return Column(style.title, meaning, cell, value, style.width, right=True, falling=style.falling)


def number_text(value: float, decimals: int, width: int) -> str:
    """A number in at most `width` cells: counts as they are, very large ones in powers of ten."""
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    small = value != 0 and abs(value) < 0.5 * 10**-decimals
    return f"{value:.1e}" if small or len(text) > width else text
