"""The panel's angle on a scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.ui.cells.gauge import column, ruler, scale
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from scoring.protocol import Side

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import DoorView, LatchView, Snapshot

_ROOMY = 34
_LIMIT = math.pi / 2
_DEGREES = (-90, -45, 0, 45, 90)


class DoorGauge(View):
    """Angle, open or closed, latch; a scale with the closed zone and the opening side."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Three rows."""
        room = width - 9
        setup = snapshot.run.setup
        opening = None if setup is None else setup.condition.opening_side
        numbers = ruler(room, [(column(math.radians(d), _LIMIT, room), str(d)) for d in _DEGREES])
        return [
            line(
                Span("door ", Tone.STRONG), *_words(snapshot.door, width), *_latch(snapshot.latch)
            ),
            line(
                Span(" CW ", Tone.DIM),
                *_scale(snapshot.door, opening, room),
                Span(" CCW", Tone.DIM),
            ),
            line(Span(f"    {numbers}", Tone.DIM)),
        ]


def _words(door: DoorView, width: int) -> Line:
    if door.angle is None:
        return line(Span(f"no angle: {door.freshness}", Tone.BAD))
    state = "open" if door.is_open else "closed"
    degrees = f" {math.degrees(door.angle):+6.1f} deg" if width >= _ROOMY else ""
    text = f"{door.angle:+.3f} rad{degrees} "
    stale = door.freshness is not Freshness.FRESH
    tone = Tone.WARN if door.is_open else Tone.GOOD
    return line(text, Span(str(door.freshness) if stale else state, Tone.BAD if stale else tone))


def _latch(latch: LatchView) -> Line:
    if latch.freshness is Freshness.NEVER:
        return ()
    if latch.engaged is None:
        return line(Span(f" latch {latch.freshness}", Tone.BAD))
    return line(f" {'locked' if latch.engaged else 'unlocked'}")


def _scale(door: DoorView, opening: Side | None, width: int) -> Line:
    middle = column(0.0, _LIMIT, width)
    cw, ccw = ("=" if side is opening else "-" for side in (Side.CW, Side.CCW))
    track = cw * middle + "|" + ccw * (width - middle - 1)
    zone = max(1, round(door.closed_angle / _LIMIT * (width - 1) / 2))
    marks = [(middle - zone, "[", Tone.PLAIN), (middle + zone, "]", Tone.PLAIN)]
    if door.angle is not None:
        cell = column(door.angle, _LIMIT, width)
        if abs(door.angle) < door.closed_angle:
            marks.append((middle, "●", Tone.GOOD))
        else:  # an open door never shows inside the brackets
            outside = max(cell, marks[1][0] + 1) if door.angle > 0 else min(cell, marks[0][0] - 1)
            marks.append((outside, "●", Tone.WARN))
    return scale(track, marks)
