"""The live pane: the run as it goes, with its gauges and its log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from textual.containers import Horizontal, VerticalScroll

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.snapshot import (
    DoorView,
    HandleView,
    LatchView,
    LogLine,
    SensorView,
    Snapshot,
    Weight,
)
from madrob_console.referee.checks import Freshness
from madrob_console.referee.journal import Origin
from madrob_console.ui.cells.lines import (
    Line,
    Span,
    Tone,
    Unmarked,
    View,
    column,
    line,
    ruler,
    scale,
)
from madrob_console.ui.look.words import rough_text
from madrob_console.ui.panes.run_status import (
    AllFaults,
    Banner,
    EvidenceLine,
    RunClock,
    RunStatus,
    StepTable,
)
from scoring.protocol import Side
from scoring.result import DOUBTED

# The panel's angle on a scale.


_ROOMY = 34
_LIMIT = math.pi / 2
_DEGREES = (-90, -45, 0, 45, 90)


class DoorGauge(View):
    """Angle, open or closed, latch; a scale with the closed zone and the opening side."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        room = width - 9
        setup = snapshot.run.setup
        opening = None if setup is None else setup.condition.opening_side
        numbers = ruler(room, [(column(math.radians(d), _LIMIT, room), str(d)) for d in _DEGREES])
        return [
            line(
                Span("door ", Tone.STRONG),
                *_door_words(snapshot.door, width),
                *_latch(snapshot.latch),
            ),
            line(
                Span(" CW ", Tone.DIM),
                *_scale(snapshot.door, opening, room),
                Span(" CCW", Tone.DIM),
            ),
            line(Span(f"    {numbers}", Tone.DIM)),
        ]


def _door_words(door: DoorView, width: int) -> Line:
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


# The force on the handle on a scale.


_LIMITS = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)


class HandleGauge(View):
    """Force, zero and maximum; a scale around the zero with the touch threshold."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        handle = snapshot.handle
        room = width - 1
        limit = _limit(handle)
        labels = [
            (0, f"{-limit:g}"),
            (column(0.0, limit, room), f"touch at {handle.touch_force:.2f} N"),
            (room - 1, f"{limit:g}"),
        ]
        return [
            line(Span("handle raw ", Tone.STRONG), *_handle_words(handle, width)),
            scale("-" * room, _marks(handle, limit, room)),
            line(Span(ruler(room, labels), Tone.DIM)),
        ]


def _handle_words(handle: HandleView, width: int) -> Line:
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


# The last lines of the event log.


_TONES = {
    Origin.REFEREE: Tone.STRONG,
    Origin.REMOTE: Tone.STRONG,
    Origin.SENSOR: Tone.PLAIN,
    Origin.CLOCK: Tone.PLAIN,
    Origin.SYSTEM: Tone.DIM,
}
_LOUD = {Weight.NOTICE: Tone.NOTICE, Weight.ALARM: Tone.ALARM}


class LogView(View):
    """As many lines as there is room for, the newest at the bottom."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        rows = self.size.height
        return [log_line(entry) for entry in snapshot.log[-rows:]] if rows else ()


def log_line(entry: LogLine) -> Line:
    """Time since the start, or of day outside a run; who made it happen; what."""
    at = time_of_day(entry.time) if entry.relative is None else f"{entry.relative:+8.2f}"
    return line(
        Span(f"{at:>8} {entry.origin:<8}", Tone.DIM),
        Span(entry.text, _LOUD.get(entry.weight) or _TONES[entry.origin]),
    )


# The ten passage sensors as they hang over the doorway, seen from above.


LEGEND = (
    ("O", "occupied"),
    (".", "clear"),
    ("m", "masked by the panel, clear before"),
    ("M", "masked by the panel, occupied before"),
    ("s", "stale"),
    ("?", "no data"),
)


class Passage(View):
    """CCW side above, CW side below; the hinge on the left."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
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


# What is known before the result, and how many sources deliver, in one line.


_NAMES = {
    "time_to_handle": "to handle",
    "door_occupation_time": "occupation",
    "passage_time": "passage",
}
_SETTLED = "time_to_handle"
"""It is known with the touch; the others follow the last crossing and the last closing."""


class Provisional(View):
    """The time indicators as they become known; what the run can still change is marked."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        spans = [Span("so far ", Tone.STRONG)]
        for name, words in _NAMES.items():
            value = snapshot.provisional.get(name)
            settled = snapshot.result is not None or name == _SETTLED
            text = "-"
            if value is not None:
                text = f"{value:.3f} s" if settled else f"{rough_text(value)} s"
            spans += [Span(f" {words} ", Tone.DIM), Span(text)]
            if snapshot.provisional_doubts.get(name):
                spans.append(Span(DOUBTED, Tone.WARN))
        wanted = [topic for topic in snapshot.topics if not topic.optional]
        silent = [topic for topic in wanted if topic.freshness is not Freshness.FRESH]
        fresh = f"  {len(wanted) - len(silent)} of {len(wanted)} fresh"
        rows = [line(*spans, Span(fresh, Tone.BAD if silent else Tone.GOOD))]
        if snapshot.recorder.problem:
            rows.append(line(Span(snapshot.recorder.problem, Tone.BAD)))
        elif silent:
            words = "  ".join(f"{topic.topic} {topic.freshness}" for topic in silent)
            rows.append(line(Span(words, Tone.BAD)))
        return rows


_SLOW = (Provisional, EvidenceLine, LogView)
"""They cost many bytes and need not be quick: they take the first of `_EVERY` snapshots."""
_EVERY = 3


class LivePane(VerticalScroll, Unmarked):
    """Clock, steps, sensors, what is known so far, faults, log; arrows scroll what is too long."""

    def __init__(self) -> None:
        stands, steps = (RunClock(), RunStatus()), (StepTable(), Passage())
        gauges, below = (DoorGauge(), HandleGauge()), (Provisional(), EvidenceLine(), AllFaults())
        super().__init__(
            Horizontal(*stands, classes="row"),
            banner := Banner(),
            Horizontal(*steps, classes="row"),
            Horizontal(*gauges, classes="row"),
            *below,
            log := LogView(),
            id="live",
        )
        self._views: Sequence[View] = (*stands, banner, *steps, *gauges, *below, log)
        self._count = 0

    def enter(self) -> None:
        """Takes the focus, and shows all at once with the next snapshot."""
        self._count = 0
        self.scroll_home(animate=False)
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        all_of_them = self._count % _EVERY == 0
        self._count += 1
        for view in self._views:
            if all_of_them or not isinstance(view, _SLOW):
                view.show(snapshot)
