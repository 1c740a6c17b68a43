"""The eight indicators: a value with its unit, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from madrob_console.ui.widgets.lines import Line, Span, Tone, View, line
from madrob_console.ui.words import fitted, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.history import RunSummary
    from scoring.result import Indicator

_NAME = 29
_ROOMY = 75

FROM_THE_START = ("execution_time", "time_to_handle")
"""They include the delay of a start made by hand (protocol section 8)."""


class IndicatorTable(View):
    """One row each; a long reason takes more.

    Attributes:
        earlier: runs of the same team in the same condition, to compare with.
    """

    earlier: Sequence[RunSummary] = ()

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header and the indicators."""
        if snapshot.result is None:
            return ()
        against = "against the mean of earlier" if self.earlier else "no earlier run to compare"
        roomy = width >= _ROOMY
        delay = "* with the manual start's delay"
        head = fitted(f"indicators  {delay}", _NAME + 20) if roomy else fitted("indicators", _NAME)
        lines = [line(Span(head[:12], Tone.STRONG), Span(f"{head[12:]}{against}", Tone.DIM))]
        for indicator in snapshot.result.indicators:
            lines += _rows(indicator, self._means(indicator), width)
        return lines if roomy else [*lines, line(Span(delay, Tone.DIM))]

    def _means(self, indicator: Indicator) -> tuple[float, int] | None:
        """Mean of the earlier runs that have a value, and how many have."""
        values = [v for run in self.earlier if (v := run.values.get(indicator.name)) is not None]
        return (fmean(values), len(values)) if values else None


def _rows(indicator: Indicator, mean: tuple[float, int] | None, width: int) -> list[Line]:
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
            Span(f" {indicator.unit:<8}", Tone.DIM),
            _compared(indicator.value, mean),
        )
    ]


def _compared(value: float, mean: tuple[float, int] | None) -> str:
    """The difference to the mean, the mean, and of how many runs it is."""
    if mean is None:
        return ""
    earlier, count = mean
    difference = value - earlier
    text = f"{difference:+.4f}" if abs(difference) < 1e4 else f"{difference:+.2e}"
    return f"{text:>11} to {value_text(earlier)} ({count})"


def value_text(value: float) -> str:
    """Counts as they are, numbers with four decimals, very small or large ones in powers."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.4f}" if value == 0 or 1e-2 <= abs(value) < 1e6 else f"{value:.4e}"
