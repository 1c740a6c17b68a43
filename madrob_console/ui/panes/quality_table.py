"""How good the data are: a row per signal, then remarks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import date_of

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.quality import SignalQuality

_NAMES = ("samples", "Hz", "gap", "gaps", "jitter", "skew", "drop", "shift", "none")
_WIDTHS = (8, 6, 8, 5, 7, 7, 5, 6, 5)


class QualityTable(View):
    """Rates, gaps, jitter, skew, dropped and shifted stamps."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The table of the result."""
        if snapshot.result is None:
            return ()
        quality = snapshot.result.quality
        told = snapshot.run.remarks()  # they stand among the marks
        return [
            line(
                Span("data quality", Tone.STRONG),
                Span("  largest gap, jitter and skew in ms", Tone.DIM),
            ),
            line(Span(" " * 17 + _aligned(_NAMES), Tone.DIM)),
            *map(_row, quality.signals),
            *(
                row
                for text in quality.remarks
                if text not in told
                for row in paragraph(text, width, Tone.WARN)
            ),
            *_evidence(snapshot, width),
        ]


def _evidence(snapshot: Snapshot, width: int) -> Sequence[Line]:
    """What was recorded beside the testbed's topics; nothing is scored from it."""
    evidence = snapshot.run.evidence
    if evidence is None:
        return ()
    gone = snapshot.run.evidence_removed(date_of)
    words = f"{evidence.words}{f'; {gone}' if gone else ''}"
    head = (Span("evidence ", Tone.STRONG),)
    return [
        *paragraph(words, width, Tone.WARN if gone else Tone.PLAIN, head),
        *(row for text in evidence.remarks() for row in paragraph(text, width, Tone.DIM)),
    ]


def _row(q: SignalQuality) -> Line:
    poor = q.gaps or q.dropped or q.shifted or not q.samples
    tone = Tone.WARN if poor else Tone.PLAIN
    return line(f"{q.signal.value:<17}", Span(_aligned(q.cells()), tone))


def _aligned(cells: Sequence[str]) -> str:
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))
