"""The indicators: a value with its unit, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import fitted
from scoring.result import value_text

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.indicator_table import IndicatorName
    from scoring.result import Indicator

_NAME = 29
_ROOMY = 75


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
        roomy = width >= _ROOMY
        count = len(self.earlier)
        against = f"against mean of {count} earlier" if count else "no earlier run to compare"
        delay = "* with the manual start's delay"
        head = fitted(f"indicators  {delay}", _NAME + 20) if roomy else fitted("indicators", _NAME)
        lines = [line(Span(head[:12], Tone.STRONG), Span(f"{head[12:]}{against}", Tone.DIM))]
        for name, indicator in snapshot.result.indicators.items():
            lines += _rows(name, indicator, self._means(name), width)
        return lines if roomy else [*lines, line(Span(delay, Tone.DIM))]

    def _means(self, name: IndicatorName) -> tuple[float, int] | None:
        """Mean of the earlier runs that have a value, and how many have."""
        values = [v for run in self.earlier if (v := run.values.get(name)) is not None]
        return (fmean(values), len(values)) if values else None


def _rows(
    name: IndicatorName, indicator: Indicator, mean: tuple[float, int] | None, width: int
) -> list[Line]:
    title = name.words + (" *" if name.spec.with_the_start else "")
    head = line(f"{title:<{_NAME}}")
    if indicator.value is None:
        return paragraph(f"none: {indicator.reason}", width, Tone.WARN, head)
    return [
        line(
            *head,
            Span(f"{value_text(indicator.value):>10}", Tone.STRONG),
            Span(f" {indicator.unit:<8}", Tone.DIM),
            _compared(indicator.value, mean, width >= _ROOMY),
        )
    ]


def _compared(value: float, mean: tuple[float, int] | None, roomy: bool) -> str:
    """The difference to the mean; where there is room the mean, and of how many runs it is."""
    if mean is None:
        return ""
    earlier, count = mean
    difference = value - earlier
    text = f"{difference:+.4f}" if abs(difference) < 1e4 else f"{difference:+.2e}"
    return f"{text:>10} to {value_text(earlier)} ({count})" if roomy else f"{text:>10}"
