"""The ten passage sensors as they hang over the doorway, seen from above."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from scoring.protocol import Side

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import SensorView, Snapshot

LEGEND = (
    ("O", "occupied"),
    (".", "clear"),
    ("m", "masked by the panel, clear before"),
    ("M", "masked by the panel, occupied before"),
    ("s", "stale"),
    ("?", "no data"),
)
"""What the symbols mean, for the help."""


class Passage(View):
    """CCW side above, CW side below; the hinge on the left."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Seven rows of at least 27 cells."""
        return [
            line(Span("passage sensors", Tone.STRONG)),
            line(Span("      4   3   2   1   0", Tone.DIM)),
            _row("CCW ", _of_side(snapshot.passage, Side.CCW)),
            line(Span("hinge ", Tone.DIM), Span("═" * 17, Tone.PLAIN), Span(" ║", Tone.DIM)),
            _row("CW  ", _of_side(snapshot.passage, Side.CW)),
            line(Span("O occupied  . clear", Tone.DIM)),
            line(Span("m masked s stale ? no data", Tone.DIM)),
        ]


def symbol(sensor: SensorView) -> Span:
    """One letter for the state of a sensor."""
    if sensor.freshness is Freshness.STALE:
        return Span("s", Tone.WARN)
    if sensor.freshness is not Freshness.FRESH or sensor.occupied is None:
        return Span("?", Tone.BAD)
    if sensor.masked:
        return Span("M" if sensor.occupied else "m", Tone.DIM)
    return Span("O", Tone.NOTICE) if sensor.occupied else Span(".")


def _of_side(sensors: Iterable[SensorView], side: Side) -> list[SensorView]:
    """The side's sensors from the hinge outwards."""
    return sorted((s for s in sensors if s.side is side), key=lambda s: -s.index)


def _row(name: str, sensors: Iterable[SensorView]) -> Line:
    spans: list[str | Span] = [Span(name, Tone.STRONG)]
    for sensor in sensors:
        spans += ["  " if len(spans) == 1 else "   ", symbol(sensor)]
    return line(*spans)
