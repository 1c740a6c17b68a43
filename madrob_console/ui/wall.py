"""`madrob watch --big`: the wall display, seen from far away."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.screen import Screen

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.run import Phase
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Span, Tone, View, line, width_of
from madrob_console.ui.frame.console_screen import BUSY_PERIOD
from madrob_console.ui.frame.frame_lines import WATCHING, source_badge
from madrob_console.ui.look.words import fitted, minutes_text, shortened
from madrob_console.ui.panes.notices import banner
from madrob_console.ui.panes.run_status import (
    clock_span,
    condition_text,
    phase_span,
    step_time,
    team_text,
    who_text,
)
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED, StepRecord

PAUSED = "PAUSED - technical problem"
"""What the hall reads while the engine is away."""

_BANDS = {
    Tone.GOOD: Tone.LIVE,
    Tone.WARN: Tone.NOTICE,
    Tone.BAD: Tone.ALARM,
    Tone.STRONG: Tone.CAP,
}
_FILLED = (*_BANDS.values(),)

_ROWS_A_BAND, _ROWS_A_BOX = 20, 9
"""With so many rows of the screen a band is higher by one above and below, a box by one."""

_FRAMED = 16
"""With fewer rows the boxes have no frames."""

_LEAST_BOX = 12
"""Cells of a box: with fewer there are two rows of them."""


class Wall(View):
    """The run from top to bottom: band, team, clock and level in large digits, steps, notice."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        head = _head(snapshot, width)
        size = Size(width, max(1, self.room.height - len(head)))
        run, result = snapshot.run, snapshot.result
        text, tone = banner(snapshot)
        clock = clock_span(snapshot)
        level: float | None = sum(record.done for record in snapshot.steps)
        if result is not None:
            level = result.indicators[IndicatorName.CAPABILITY_LEVEL].value
        what = f"run {run.setup.run_number}, {condition_text(run)}" if run.setup else who_text(run)
        figures = (
            (Span(clock.text.removesuffix(".?"), clock.tone), _clock_words(snapshot)),
            (Span("-" if level is None else f"{level:.0f}", Tone.STRONG), "of 6 steps"),
        )
        state = Span(PAUSED, Tone.BAD) if snapshot.pulse.stale else phase_span(run, result)
        every = (
            _band(state, size),
            _texts((Span(team_text(run), Tone.STRONG), Span(what)), width),
            _figures(figures, width),
            _boxes([step_box(snapshot, record) for record in snapshot.steps], size),
            _texts([Span(text if tone is not Tone.PLAIN else "", tone)], width),
        )
        parts = [part for part in every if part]
        spare = max(0, size.height - sum(map(len, parts)))
        between = [line()] * (spare // len(parts))
        rows = [row for part in parts for row in (*part, *between)]
        return [*head, *rows[: size.height]]


def _head(snapshot: Snapshot, width: int) -> list[Line]:
    head = line(source_badge(snapshot, max(4, width - 22)), Span(WATCHING, Tone.STRONG))
    clock = time_of_day(snapshot.time).rjust(max(0, width - width_of(head) - 1))
    words = snapshot.pulse.words
    if snapshot.pulse.stale:
        words = f"{PAUSED}. What you see is of {time_of_day(snapshot.time)}."
    fault = [line(Span(fitted(f" {words}", width), Tone.ALARM))] if words else []
    return [line(*head, Span(clock, Tone.DIM)), *fault]


def _clock_words(snapshot: Snapshot) -> str:
    if snapshot.remaining is None:
        return "time"
    if snapshot.run.phase is Phase.COUNTDOWN:
        return "to the start"
    return f"{minutes_text(snapshot.remaining)} left"


def step_box(snapshot: Snapshot, record: StepRecord) -> tuple[Span, str]:
    """A step's name, and its time, s from the start, which is marked if it may still change."""
    name = f"{record.step} {record.step.name.lower()}"
    pending = next((other.step for other in snapshot.steps if not other.done), None)
    if record.done:
        rough = snapshot.result is None and record.step in UNSETTLED
        return Span(name, Tone.LIVE), step_time(record.final, snapshot.run.start, rough=rough)
    if record.denied:
        return Span(name, Tone.ALARM), "denied"
    if snapshot.run.phase is Phase.RUNNING and record.step is pending:
        return Span(name, Tone.WARN), "next"
    return Span(name, Tone.DIM), ""


def _band(state: Span, size: Size) -> list[Line]:
    tone = _BANDS[state.tone]
    above = [_row(size.width, Span(" ", tone))] * min(2, size.height // _ROWS_A_BAND)
    return [*above, *_texts([Span(state.text, tone)], size.width), *above]


def _row(width: int, *spans: Span) -> Line:
    """Spans in the middle; a band fills the width."""
    blank = max(0, width - width_of(spans))
    tone = spans[0].tone if spans[0].tone in _FILLED else Tone.PLAIN
    return line(Span(" " * (blank // 2), tone), *spans, Span(" " * (blank - blank // 2), tone))


def _texts(spans: Iterable[Span], width: int) -> list[Line]:
    """A row each; a long one is cut, whatever its script."""
    return [_row(width, Span(shortened(text, width), tone)) for text, tone in spans if text]


def _figures(shown: Sequence[tuple[Span, str]], width: int) -> list[Line]:
    """Numbers in large digits beside each other."""
    groups = []
    for (text, tone), caption in shown:
        rows = digit_rows(text)
        cells = max(len(row) for row in (*rows, caption))
        lines = (*((row, tone) for row in rows), (caption, Tone.DIM))
        groups.append([Span(f"   {row:^{cells}}   ", of) for row, of in lines])
    return [_row(width, *spans) for spans in zip(*groups, strict=True)]


def _boxes(shown: Sequence[tuple[Span, str]], size: Size) -> list[Line]:
    """The steps in a row of boxes, or in two; what is done is filled."""
    columns = 6 if size.width >= 6 * _LEAST_BOX else 3
    width, inner = size.width // columns - 1, size.height // _ROWS_A_BOX
    rows: list[Line] = []
    for begin in range(0, len(shown), columns):
        boxes = [
            _box(name, state, width, inner)
            if size.height >= _FRAMED
            else [Span(fitted(f"{name.text[2:]} {state}", width), name.tone)]
            for name, state in shown[begin : begin + columns]
        ]
        rows += [
            _row(size.width, *(part for span in spans for part in (Span(" "), span)))
            for spans in zip(*boxes, strict=True)
        ]
    return rows


def _box(name: Span, state: str, width: int, inner: int) -> Sequence[Span]:
    above = (inner - 2) // 2
    texts = [*[""] * above, name.text, state, *[""] * (inner - 2 - above)]
    upper, side, lower = ("   ", " ", "   ") if name.tone in _FILLED else ("┌─┐", "│", "└─┘")
    framed = [f"{side}{text:^{width - 2}}{side}" for text in texts]
    ends = [f"{end[0]}{end[1] * (width - 2)}{end[2]}" for end in (upper, lower)]
    return [Span(row, name.tone) for row in (ends[0], *framed, ends[1])]


class WallScreen(Screen[None]):
    """The screen of the wall display; what it shows is its app's."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES


class WallApp(MadrobApp, inherit_bindings=False):
    """The console's look and engine link, as a spectator; its only keys leave."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,escape,f10,ctrl+q,ctrl+c", "quit", show=False)
    ]
    COMMANDS = set()  # noqa: RUF012  textual's declaration
    ENABLE_COMMAND_PALETTE = False

    def get_default_screen(self) -> Screen[None]:
        return WallScreen()

    def compose(self) -> ComposeResult:
        yield Wall()

    async def show_engine(self) -> None:
        self.query_one(Wall).set_interval(BUSY_PERIOD, self.poll)  # it ends with the wall
        self.poll()

    def poll(self) -> None:
        snapshot = self._link.snapshot()
        assert snapshot is not None
        if snapshot.pulse.gone:
            self._link.look_for_engine(partial(self.run_worker, thread=True, group="engine"))
        self.query_one(Wall).show(snapshot)
