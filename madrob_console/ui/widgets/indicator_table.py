"""The eight indicators: a value with its unit, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.widgets.lines import Line, Span, Tone, View, line
from madrob_console.ui.words import wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from scoring.result import Indicator

_NAME = 29

FROM_THE_START = ("execution_time", "time_to_handle")
"""They include the delay of a start made by hand (protocol section 8)."""


class IndicatorTable(View):
    """One row each; a long reason takes more."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header and the indicators."""
        if snapshot.result is None:
            return ()
        lines = [
            line(
                Span("indicators", Tone.STRONG), Span("  * with the manual start's delay", Tone.DIM)
            )
        ]
        for indicator in snapshot.result.indicators:
            lines += _rows(indicator, width)
        return lines


def _rows(indicator: Indicator, width: int) -> list[Line]:
    star = " *" if indicator.name in FROM_THE_START else ""
    name = str(indicator.name).replace("_", " ") + star
    if indicator.value is None:
        texts = wrapped(f"none: {indicator.reason}", max(10, width - _NAME))
        first = line(f"{name:<{_NAME}}", Span(texts[0], Tone.WARN))
        return [first, *(line(" " * _NAME, Span(text, Tone.WARN)) for text in texts[1:])]
    return [
        line(
            f"{name:<{_NAME}}",
            Span(f"{value_text(indicator.value):>10}", Tone.STRONG),
            Span(f" {indicator.unit}", Tone.DIM),
        )
    ]


def value_text(value: float) -> str:
    """Counts as they are, numbers with four decimals, very small or large ones in powers."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.4f}" if value == 0 or 1e-2 <= abs(value) < 1e6 else f"{value:.4e}"
