"""How good the data are: a row per signal, then remarks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.quality import SignalQuality

_HEAD = (
    f"{'':17}{'samples':>8}{'Hz':>6}{'gap':>8}{'gaps':>5}"
    f"{'jitter':>7}{'skew':>7}{'drop':>5}{'shift':>6}{'none':>5}"
)


class QualityTable(View):
    """Rates, gaps, jitter, skew, dropped and shifted stamps."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The table of the result."""
        if snapshot.result is None:
            return ()
        quality = snapshot.result.quality
        return [
            line(
                Span("data quality", Tone.STRONG),
                Span("  largest gap, jitter and skew in ms", Tone.DIM),
            ),
            line(Span(_HEAD, Tone.DIM)),
            *map(_row, quality.signals),
            *(row for text in quality.remarks for row in paragraph(text, width, Tone.WARN)),
        ]


def _row(q: SignalQuality) -> Line:
    numbers = (
        f"{q.samples:>8}{_number(q.rate, 1):>6}{_number(q.largest_gap, 1000):>8}{q.gaps:>5}"
        f"{_number(q.jitter, 1000):>7}{_number(q.skew, 1000):>7}"
        f"{q.dropped:>5}{q.shifted:>6}{q.no_reading:>5}"
    )
    poor = q.gaps or q.dropped or q.shifted or not q.samples
    return line(f"{q.signal.value:<17}", Span(numbers, Tone.WARN if poor else Tone.PLAIN))


def _number(value: float | None, scale: float) -> str:
    return "-" if value is None else f"{value * scale:.1f}"
