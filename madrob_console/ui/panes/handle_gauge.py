"""The force on the handle on a scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.ui.cells.gauge import column, ruler, scale
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import HandleView, Snapshot

_ROOMY = 34
_LIMITS = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)


class HandleGauge(View):
    """Force, zero and maximum; a scale around the zero with the touch threshold."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows; the scale counts from the zero."""
        handle = snapshot.handle
        room = width - 1
        limit = _limit(handle)
        labels = [
            (0, f"{-limit:g}"),
            (column(0.0, limit, room), f"touch at {handle.touch_force:.2f} N"),
            (room - 1, f"{limit:g}"),
        ]
        return [
            line(Span("handle raw ", Tone.STRONG), *_words(handle, width)),
            scale("-" * room, _marks(handle, limit, room)),
            line(Span(ruler(room, labels), Tone.DIM)),
        ]


def _words(handle: HandleView, width: int) -> Line:
    most = "-" if handle.maximum is None else f"{handle.maximum:.1f}"
    zero = f" zero {handle.zero:+.2f}" if width >= _ROOMY else ""
    rest = f"{zero} max {most}N"
    if handle.force is None:
        return line(Span(f"no force: {handle.freshness}", Tone.BAD), Span(rest, Tone.DIM))
    stale = handle.freshness is not Freshness.FRESH
    tone = Tone.BAD if stale else Tone.WARN if _touched(handle) else Tone.PLAIN
    mark = f" {handle.freshness}" if stale else ""
    return line(Span(f"{handle.force:+.2f}{mark}", tone), Span(rest, Tone.DIM))


def _touched(handle: HandleView) -> bool:
    return handle.force is not None and abs(handle.force - handle.zero) > handle.touch_force


def _limit(handle: HandleView) -> float:
    """The smallest scale that holds threshold and maximum."""
    most = max(4 * handle.touch_force, (handle.maximum or 0.0) + abs(handle.zero))
    return next((limit for limit in _LIMITS if limit >= most), _LIMITS[-1])


def _marks(handle: HandleView, limit: float, width: int) -> list[tuple[int, str, Tone]]:
    middle = column(0.0, limit, width)
    marks: list[tuple[int, str, Tone]] = []
    if handle.force is not None:
        end = column(handle.force - handle.zero, limit, width)
        tone = Tone.WARN if _touched(handle) else Tone.GOOD
        marks = [(cell, "█", tone) for cell in range(min(end, middle), max(end, middle) + 1)]
    for threshold in (-handle.touch_force, handle.touch_force):
        marks.append((column(threshold, limit, width), "!", Tone.STRONG))
    marks.append((middle, "|", Tone.STRONG))
    return marks
