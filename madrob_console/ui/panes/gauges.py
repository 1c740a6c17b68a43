"""Door angle and handle force, live: in numbers, and their course."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.engine.curves import Curve
from madrob_console.referee.topic_health import Freshness
from madrob_console.ui.cells.axes import Window, joined
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.cells.plot import Frame, Mark, Plot
from scoring.figure_table import Quantity, marked_events

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import HandleView, LatchView, Recent, Snapshot

SPAN = 20
"""So much of the course is always shown, s."""

_ROOMY = 34


def _door_words(snapshot: Snapshot, width: int) -> Line:
    door = snapshot.door
    name, latch = Span("door ", Tone.STRONG), _latch(snapshot.latch)
    if door.angle is None:
        return line(name, Span(f"no angle: {door.freshness}", Tone.BAD), *latch)
    state = "open" if door.is_open else "closed"
    degrees = f" {math.degrees(door.angle):+6.1f} deg" if width >= _ROOMY else ""
    text = f"{door.angle:+.3f} rad{degrees} "
    stale = door.freshness is not Freshness.FRESH
    tone = Tone.WARN if door.is_open else Tone.GOOD
    word = Span(str(door.freshness) if stale else state, Tone.BAD if stale else tone)
    return line(name, text, word, *latch)


def _latch(latch: LatchView) -> Line:
    if latch.freshness is Freshness.NEVER:
        return ()
    if latch.engaged is None:
        return line(Span(f" latch {latch.freshness}", Tone.BAD))
    return line(f" {'locked' if latch.engaged else 'unlocked'}")


def _handle_words(handle: HandleView, width: int) -> Line:
    name = Span("handle raw ", Tone.STRONG)
    most = "" if handle.maximum is None else f" max {handle.maximum:.1f}"
    zero = f" zero {handle.zero:+.1f}" if width >= _ROOMY else ""
    rest = Span(f"{most}{zero} N", Tone.DIM)
    if handle.force is None:
        return line(name, Span(f"no force: {handle.freshness}", Tone.BAD), rest)
    stale = handle.freshness is not Freshness.FRESH
    tone = Tone.BAD if stale else Tone.WARN if _touched(handle) else Tone.PLAIN
    mark = f" {handle.freshness}" if stale else ""
    return line(name, Span(f"{handle.force:+.2f}{mark}", tone), rest)


def _touched(handle: HandleView) -> bool:
    return handle.force is not None and abs(handle.force - handle.zero) > handle.touch_force


class DoorGauge(View):
    """Angle, open or closed, latch; their course below."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        door = snapshot.door
        label = f"open at {door.closed_angle:g} rad "
        course = _bars(snapshot, door.recent, 0.0, door.closed_angle, math.pi / 2, label, width)
        return [_door_words(snapshot, width), course]


class HandleGauge(View):
    """Force, zero and maximum; their course below."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        handle = snapshot.handle
        touch, zero = handle.touch_force, handle.zero
        full, label = max(4 * touch, handle.maximum or 0.0), f"touch at {touch:.2f} N "
        course = _bars(snapshot, handle.recent, zero, touch, full, label, width)
        return [_handle_words(handle, width), course]


_BARS = "▁▂▃▄▅▆▇█"


def _shown(snapshot: Snapshot) -> tuple[float, Window]:
    """What times count from, s since the epoch, and the window: it moves on once a second.

    They count from the start, without one or while it is held from the window's end.
    """
    start = snapshot.run.start if snapshot.run.held is None else None
    origin = float(math.ceil(snapshot.time)) if start is None else start
    end = math.ceil(snapshot.time - origin)
    return origin, Window(end - SPAN - 1, end)


def _bars(
    snapshot: Snapshot,
    recent: Recent,
    zero: float,
    threshold: float,
    full: float,
    label: str,
    width: int,
) -> Line:
    """The farthest from `zero` by time, in one row; blank where nothing came.

    What is beyond the threshold stands out; the highest bar begins at `full`.
    """
    origin, window = _shown(snapshot)
    cells = [Span(" ")] * (width - len(label) - 1)
    tops: dict[int, float] = {}
    for extent in (extent for stretch in recent for extent in stretch):
        cell = window.column(extent.time - origin, len(cells))
        tops[cell] = max(tops.get(cell, 0.0), extent.high - zero, zero - extent.low)
    for cell, top in tops.items():
        if 0 <= cell < len(cells):
            bar = _BARS[min(len(_BARS) - 1, int(top / full * len(_BARS)))]
            cells[cell] = Span(bar, Tone.WARN if top >= threshold else Tone.DIM)
    return joined([Span(label, Tone.DIM), *cells])


class StripChart(View):
    """Both over one time axis with the events; the bands below their thresholds are dotted."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        return strip_chart(snapshot, width, self.room.height)


def strip_chart(snapshot: Snapshot, width: int, height: int) -> list[Line]:
    """The chart in `width` x `height` cells, in 10 rows at least."""
    door, handle = snapshot.door, snapshot.handle
    origin, window = _shown(snapshot)
    angles, forces = _curves(door.recent, origin, 0.0), _curves(handle.recent, origin, handle.zero)
    opened, touched = f"open at {door.closed_angle:g} rad", f"touch at {handle.touch_force:.2f} N"
    panels = (
        (
            line(Span("door, rad", Tone.STRONG), Span(f"   dotted: {opened}", Tone.DIM)),
            Plot(angles, Quantity.POSITION.spec.least, zone=door.closed_angle),
        ),
        (
            line(Span("handle less zero, N", Tone.STRONG), Span(f"   dotted: {touched}", Tone.DIM)),
            Plot(forces, 4 * handle.touch_force, zone=handle.touch_force),
        ),
    )
    rows = max(6, height - 4)
    heights = rows - rows // 2, rows // 2
    gutter = max(plot.axis(h).gutter for (_, plot), h in zip(panels, heights, strict=True))
    setup = snapshot.run.setup
    events = [(event.time - origin, event.name) for event in snapshot.events]
    marked = marked_events(events, None if setup is None else setup.condition)
    marks = [Mark(time, mark.letter) for mark, times in marked.items() for time in times]
    frame = Frame(window, width, gutter, marks)
    drawn: list[Line] = []
    for (head, plot), h in zip(panels, heights, strict=True):
        drawn += [head, *frame.plot(plot, h)]
    return [*drawn, *frame.time_axis()]


def _curves(recent: Recent, origin: float, zero: float) -> tuple[Curve, ...]:
    curves = []
    for stretch in recent:
        points, last = list[tuple[float, float]](), stretch[0].low
        for extent in stretch:  # the nearer end first: a slope stays thin
            low, high = extent.low, extent.high
            near, last = (low, high) if 2 * last < low + high else (high, low)
            points += [(extent.time - origin, near - zero), (extent.time - origin, last - zero)]
        curves.append(Curve(*zip(*points, strict=True)))
    return tuple(curves)
