"""The indicators: a value with its unit, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import fitted
from scoring.indicator_table import IndicatorName
from scoring.result import value_text

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.result import Indicator, Result

_NAME = 28
_ROOMY = 75
_WITH_WORDS = 62
"""Cells with which a difference says whether it is better."""


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
        head = fitted(f"indicators  {delay}", _NAME + 18) if roomy else fitted("indicators", _NAME)
        lines = [line(Span(head[:12], Tone.STRONG), Span(f"{head[12:]}{against}", Tone.DIM))]
        for name, indicator in snapshot.result.indicators.items():
            lines += _rows(name, indicator, self._means(name), count, width)
            if name is IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION:
                lines += _drift(snapshot.result, snapshot.handle.touch_force)
        return lines if roomy else [*lines, line(Span(delay, Tone.DIM))]

    def _means(self, name: IndicatorName) -> tuple[float, int] | None:
        """Mean of the earlier runs that have a value, and how many have."""
        values = [v for run in self.earlier if (v := run.values.get(name)) is not None]
        return (fmean(values), len(values)) if values else None


def _rows(
    name: IndicatorName,
    indicator: Indicator,
    mean: tuple[float, int] | None,
    count: int,
    width: int,
) -> list[Line]:
    title = name.words + (" *" if name.spec.with_the_start else "")
    head = line(f"{title:<{_NAME}}")
    if indicator.value is None:
        return paragraph(f"none: {indicator.reason}", width, Tone.WARN, line(*head, " "))
    return [
        line(
            *head,
            Span(f"{value_text(indicator.value):>10}", Tone.STRONG),
            Span(f" {indicator.unit:<7}", Tone.DIM),
            *compared(name, indicator.value, mean, count, width),
        )
    ]


def _drift(result: Result, touch_force: float) -> list[Line]:
    """How far the handle came to rest from its zero, where that is too far (section 11)."""
    rest = result.rest
    if rest is None or rest.drift is None or not rest.drifted(touch_force):
        return []
    head = line(Span(f"{'  at rest after, from zero':<{_NAME}}", Tone.WARN))
    return [line(*head, Span(f"{rest.drift:>+10.2f} N", Tone.WARN))]


def compared(
    name: IndicatorName, value: float, mean: tuple[float, int] | None, count: int, width: int
) -> Line:
    """The difference to the mean, and whether it is better; with room, the mean.

    Beside that stands of how many runs it is, where not all of the `count` have a value.
    """
    if mean is None:
        return ()
    earlier, having = mean
    difference = value - earlier
    text = f"{difference:+.4f}" if abs(difference) < 1e3 else f"{difference:+.2e}"
    better = (difference > 0) is name.spec.higher_is_better
    word, tone = ("better", Tone.GOOD) if better else ("worse", Tone.WARN)
    if difference == 0:
        word, tone = "equal", Tone.PLAIN
    parts = [Span(f"{text:>9}", tone)]
    if width >= _WITH_WORDS:
        parts.append(Span(f" {word:<6}", tone))
    if width >= _ROOMY:
        of = "" if having == count else f" ({having})"
        parts.append(Span(f" {value_text(earlier)}{of}", Tone.DIM))
    return tuple(parts)
