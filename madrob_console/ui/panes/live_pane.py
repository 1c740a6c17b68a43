"""The live pane: the run as it goes, with its gauges and its log."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from textual.containers import Horizontal, VerticalScroll

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.snapshot import LogLine, Snapshot, Weight
from madrob_console.referee.journal import Origin
from madrob_console.referee.topic_health import Freshness
from madrob_console.ui.cells.lines import Line, Span, Tone, Unmarked, View, line, paragraph
from madrob_console.ui.look.words import rough_text
from madrob_console.ui.panes.gauges import DoorGauge, HandleGauge, StripChart
from madrob_console.ui.panes.notices import AllFaults, Banner, EvidenceLine
from madrob_console.ui.panes.run_status import RunClock, RunStatus, StepTable, Tenths
from madrob_console.ui.panes.top_view import Doorway, symbol
from scoring.protocol import Side
from scoring.result import DOUBTED

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
        height, rows = self.size.height, list[Line]()
        for entry in reversed(snapshot.log[-height:]):
            before = log_lines(entry, width)
            if rows and len(before) + len(rows) > height:
                break  # it would begin in the middle of a sentence
            rows = [*before, *rows]
        return rows[:height]


def log_lines(entry: LogLine, width: int) -> list[Line]:
    """Time since the start, or of day outside a run; who made it happen; what."""
    at = time_of_day(entry.time) if entry.relative is None else f"{entry.relative:+8.2f}"
    head = line(Span(f"{at:>8} {entry.origin:<8}", Tone.DIM))
    return paragraph(entry.text, width, _LOUD.get(entry.weight) or _TONES[entry.origin], head)


class Passage(View):
    """CCW side above, CW side below; the hinge on the left, from which sensors count down."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Seven rows of at least 27 cells."""
        rows = {side: [Span(f"{side.upper():<6}", Tone.STRONG)] for side in Side}
        for sensor in sorted(snapshot.passage, key=lambda sensor: -sensor.index):
            rows[sensor.side] += [symbol(sensor), Span("   ")]
        return [
            line(Span("passage sensors", Tone.STRONG)),
            line(Span("      4   3   2   1   0", Tone.DIM)),
            line(*rows[Side.CCW]),
            line(Span("hinge ", Tone.DIM), Span("═" * 17, Tone.PLAIN), Span(" ║", Tone.DIM)),
            line(*rows[Side.CW]),
            line(Span("O occupied  . clear", Tone.DIM)),
            line(Span("m masked s stale ? no data", Tone.DIM)),
        ]


_NAMES = {
    "time_to_handle": "to handle",
    "door_occupation_time": "occupation",
    "passage_time": "passage",
}
_SETTLED = "time_to_handle"
"""Final at the touch; the others change until the last crossing and the last closing."""


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
        silent = sum(topic.freshness is not Freshness.FRESH for topic in wanted)
        words = f"{silent} of {len(wanted)} sensor topics silent" if silent else "all sensors live"
        rows = [line(*spans, Span(f"  {words}", Tone.BAD if silent else Tone.GOOD))]
        if snapshot.recorder.problem:
            rows.append(line(Span(snapshot.recorder.problem, Tone.BAD)))
        return rows


_PERIODS: Mapping[type[View], float] = {
    **dict.fromkeys((Provisional, EvidenceLine, LogView), 0.3),
    Doorway: 0.5,
    StripChart: 1.0,
}
"""They cost bytes and need not be quick, s: while time stands still they show every snapshot."""


class LivePane(VerticalScroll, Unmarked):
    """The whole run; arrows scroll what is too long. Its style says which views there is room for.

    In a large terminal the course of door and handle, with the doorway from above, takes the place
    of the gauges and of the log, which then stands beside the steps.
    """

    def __init__(self) -> None:
        stands, banner = (RunClock(), Tenths(), RunStatus()), Banner()
        steps = StepTable(), Passage(), LogView(classes="beside")
        gauges, below = (DoorGauge(), HandleGauge()), (Provisional(), EvidenceLine(), AllFaults())
        course, log = (StripChart(), Doorway()), LogView(classes="below")
        super().__init__(
            Horizontal(*stands, classes="row"),
            banner,
            Horizontal(*steps, classes="row"),
            Horizontal(*gauges, classes="row"),
            *below,
            Horizontal(*course, id="course"),
            log,
            id="live",
        )
        self._views: Sequence[View] = (*stands, banner, *steps, *gauges, *below, *course, log)
        self._drawn: dict[View, float] = {}
        self._time = -math.inf

    def enter(self) -> None:
        """Takes the focus, and shows all at once with the next snapshot."""
        self._drawn = {}
        self.scroll_home(animate=False)
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        stands, self._time = snapshot.time == self._time, snapshot.time
        for view in self._views:
            age = snapshot.time - self._drawn.get(view, -math.inf)
            if not view.display:
                view.forget()
                self._drawn.pop(view, None)
            elif stands or not 0 <= age < _PERIODS.get(type(view), 0.0):
                self._drawn[view] = snapshot.time
                view.show(snapshot)
