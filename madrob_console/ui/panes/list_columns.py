"""Columns that lists share: numbers, texts, indicators."""

from __future__ import annotations

from collections.abc import Callable

from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.columns import Column, Row
from madrob_console.ui.cells.lines import Span, Tone
from scoring.indicator_table import IndicatorName
from scoring.result import Uncertainty, value_text

MISSING = Span("-", Tone.DIM)

_LARGE = 1e4
"""From here on a number is shown by its power of ten instead of all its digits."""


def number_column(
    title: str, meaning: str, value: Callable[[Row], int | None], width: int
) -> Column[Row]:
    def cell(row: Row) -> Span:
        content = value(row)
        return MISSING if content is None else Span(str(content))

    return Column(title, meaning, cell, value, width, right=True)


def text_column(
    title: str,
    meaning: str,
    value: Callable[[Row], str],
    width: int,
    *,
    ample: int = 0,
) -> Column[Row]:
    """The column of a text, sorted without regard to case; an empty one comes last."""
    return Column(
        title,
        meaning,
        lambda row: Span(value(row)),
        lambda row: value(row).casefold() or None,
        width,
        ample,
    )


def indicator_column(name: IndicatorName) -> Column[RunSummary]:
    spec, width = name.spec, len(name.spec.column) + 1

    def cell(run: RunSummary) -> Span:
        value, sign = run.values.get(name), run.sign(name)
        if value is None:
            return Span(f"{MISSING.text}{sign:<1}", MISSING.tone)
        text = number_text(value, spec.decimals, width - 1, run.uncertainties.get(name))
        return Span(f"{text}{sign:<1}", Tone.WARN if sign else Tone.PLAIN)

    return Column(
        spec.column,
        f"{name.words} ({spec.unit})",
        cell,
        lambda run: run.values.get(name),
        width,
        right=True,
        falling=spec.higher_is_better,
    )


def number_text(
    value: float, decimals: int, width: int, uncertainty: Uncertainty | None = None
) -> str:
    """A number in at most `width` cells: counts as they are, very large ones in powers of ten.

    It shows no digit below its uncertainty, and fewer decimals if there is no room.
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
