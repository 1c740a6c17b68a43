"""The lines around every pane: top, faults, messages, playback, a tiny terminal's clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from rich.cells import cell_len

from madrob_console.common.formatting import format_size, time_of_day
from madrob_console.common.names import REHEARSAL, SourceKind
from madrob_console.referee.acts import Abort
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.axes import scale
from madrob_console.ui.cells.lines import (
    Line,
    Lines,
    Span,
    Tone,
    View,
    line,
    paragraph,
    width_of,
    with_keys,
)
from madrob_console.ui.look.words import clock_text, fitted, minutes_text, shortened
from madrob_console.ui.panes.notices import BELOW, FAULT, ON_LIVE, banner, notices, short_form
from madrob_console.ui.panes.run_status import clock_span, packed, phase_span, team_text

if TYPE_CHECKING:
    from madrob_console.engine.playback import PlaybackView
    from madrob_console.engine.snapshot import RecorderView, Snapshot


LITTLE_DISK = 2_000_000_000
"""Below this many bytes free the number is marked; the pre-start check decides."""

WATCHING = " WATCHING"
"""Shown on a screen that can do nothing to the run."""

ROOMY = 100
"""With so many cells the disk's free space is shown even if there is plenty."""

_LEAST_WHO = 24
"""Cells of testbed and run that a long label leaves to them."""

_STATES = {"finished": "saved"}


class TopLine(View):
    """Which source, testbed and run, and whether everything is being kept."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.pulse.stale:
            return [_old(snapshot, width)]
        watching = line(Span(WATCHING, Tone.STRONG)) if snapshot.right.only_watches else ()
        right = line(
            *recorder_spans(snapshot.recorder),
            *_disk(snapshot, roomy=width >= ROOMY),
            f" {time_of_day(snapshot.time)}",
        )
        who = f" {_who(snapshot)}"
        least = min(cell_len(who), _LEAST_WHO)  # a long team is cut before what says SIMULATED
        badge = source_badge(snapshot, max(4, width - least - width_of((*watching, *right))))
        room = max(0, width - width_of((badge, *watching, *right)))
        return [line(badge, *watching, Span(fitted(who, room), Tone.STRONG), *right)]


def _who(snapshot: Snapshot) -> str:
    """Testbed, run and team: `Hall A  run 3 of team 7 Taipei`."""
    setup = snapshot.run.setup
    run = "" if setup is None else f"run {setup.run_number} of team {team_text(snapshot.run)}"
    return "  ".join(filter(None, (snapshot.testbed, run)))


def _old(snapshot: Snapshot, width: int) -> Line:
    word = " ENDED " if snapshot.pulse.gone else " SILENT "
    text = f" {snapshot.label}, screen frozen at {time_of_day(snapshot.time)}"
    return line(Span(word, Tone.ALARM), Span(shortened(text, width - len(word)), Tone.DIM))


def source_badge(snapshot: Snapshot, room: int) -> Span:
    """The source's label in at most `room` cells: LIVE and others differ in word and mark."""
    label = snapshot.label
    may_count = not (snapshot.practice or snapshot.rehearsal) and snapshot.simulated is None
    if snapshot.source_kind is SourceKind.ROS and may_count:
        return Span(f" {shortened(label, max(1, room - 2))} ", Tone.LIVE)
    return Span(f" ~~ {shortened(label, max(1, room - 8))} ~~ ", Tone.NOTICE)


def recorder_spans(recorder: RecorderView) -> Line:
    if recorder.state == "closed":
        return line(Span(" not recording", Tone.DIM))
    recording = recorder.state == "recording"
    tone = Tone.BAD if recorder.problem or recorder.state == "failed" else Tone.PLAIN
    name = "REC" if recording else _STATES.get(recorder.state, f"rec {recorder.state}")
    dropped = f" {recorder.dropped} dropped" if recorder.dropped else ""
    return line(
        Span(f" {name}", Tone.GOOD if recording and tone is Tone.PLAIN else tone),
        f" {format_size(recorder.size)}",
        Span(dropped, Tone.ALARM),
    )


def _disk(snapshot: Snapshot, *, roomy: bool) -> Line:
    free = snapshot.disk_free
    if snapshot.playback is not None:  # nothing is written
        return ()
    if free is None:
        return line(Span(" disk ?", Tone.WARN))
    if free < LITTLE_DISK:
        return line(Span(f" {format_size(free)} free", Tone.WARN))
    return line(Span(f" {format_size(free)} free", Tone.DIM)) if roomy else ()


class FaultLine(View):
    """The faults, one a row; the last row counts the rest. `whole_below`: the pane has them all."""

    def __init__(self) -> None:
        super().__init__()
        self.whole_below = False

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        above = notices(snapshot, width)
        if not snapshot.all_faults:
            where = fitted(snapshot.competition, min(cell_len(snapshot.competition), width - 10))
            left = fitted("no faults", width - cell_len(where))
            return above or [line(Span(left + where, Tone.DIM))]
        rows = short_form(snapshot, width, BELOW if self.whole_below else ON_LIVE).rows
        marks = [FAULT] + [" " * len(FAULT)] * (len(rows) - 1)
        return above + [
            line(Span(mark, Tone.ALARM), Span(row, Tone.BAD))
            for mark, row in zip(marks, rows, strict=True)
        ]


_LEAST_GAUGE = 10


class PlaybackBar(View):
    """One row; none for anything but a replay."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        playback = snapshot.playback
        return () if playback is None else [playback_line(playback, width)]


_position = partial(clock_text, decimals=2)
"""From the start of the run: a step of one sample can be seen."""


def playback_line(playback: PlaybackView, width: int) -> Line:
    """The bar in `width` cells; the scale goes first if there is little room."""
    words = line(
        Span(" REPLAY ", Tone.NOTICE),
        " ",
        state_span(playback),
        f"  {_position(playback.position)} / {_position(playback.end)}",
    )
    room = width - width_of(words) - 4
    if room < _LEAST_GAUGE:
        return words
    return (*words, Span("  ["), *_scale(playback, room), Span("]"))


def state_span(playback: PlaybackView) -> Span:
    if playback.jumping_to is not None:
        return Span(f"jumping to {_position(playback.jumping_to)}", Tone.WARN)
    if playback.ended:
        return Span("at its end", Tone.STRONG)
    speed = speed_text(playback.speed)
    if playback.paused:
        return Span(f"PAUSED {speed}", Tone.WARN)
    return Span(f"playing {speed}", Tone.GOOD)


def speed_text(speed: float) -> str:
    """`1x`, `1/2x`, `max`."""
    if speed == 0:
        return "max"
    return "1/2x" if speed == 0.5 else f"{speed:g}x"


def _scale(playback: PlaybackView, width: int) -> Line:
    length = max(1e-9, playback.end - playback.begin)

    def cell(at: float) -> int:
        return min(width - 1, max(0, round((at - playback.begin) / length * (width - 1))))

    played = cell(playback.position)
    marks = [(number, "=", Tone.STRONG) for number in range(played)]
    start = [(cell(0.0), "|", Tone.STRONG)] if playback.begin <= 0.0 <= playback.end else []
    return scale("-" * width, [*marks, *start, (played, "●", Tone.WARN)])


_GRAVE = (Tone.BAD, Tone.WARN)


class StatusLine(Lines):
    """A message; if there is none, the hint.

    `wall` gives the time in s since the epoch.
    """

    def __init__(self, hint: str, wall: Callable[[], float] = time.time) -> None:
        super().__init__(id="status-line")
        self._wall = wall
        self._said = ""
        self._at = 0.0
        self.hint = hint
        self.tone = Tone.DIM

    @property
    def text(self) -> str:
        """The message without its time, or the hint."""
        return self._said or self.hint

    @property
    def grave(self) -> bool:
        """Whether the message is a refusal or a warning: only a key ends it."""
        return bool(self._said) and self.tone in _GRAVE

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        self._said, self.tone = text, tone if text else Tone.DIM
        self._at = self._wall()
        self.redraw()

    def go(self) -> None:
        """A key was pressed: what was said is about what was before."""
        if self._said:
            self.say("")

    def pass_on(self) -> None:
        """Something else is shown: only what is grave still matters."""
        if not self.grave:
            self.go()

    def lines(self, width: int) -> Sequence[Line]:
        if not self._said:
            return with_keys(paragraph(self.hint, width, Tone.DIM))
        head = line(Span(f"{time_of_day(self._at)} ", Tone.DIM))
        return with_keys(paragraph(self._said, width, self.tone, head))


class TinyClock(View):
    """Phase, clock and abort, and as much else as there is room for."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        return tiny_lines(snapshot, width)[: self.room.height]


def tiny_lines(snapshot: Snapshot, width: int) -> list[Line]:
    """The most important first."""
    run, left = snapshot.run, snapshot.remaining
    text, tone = banner(snapshot)
    urgent = tone in (Tone.ALARM, Tone.NOTICE)
    spans = (
        phase_span(run, snapshot.result),
        clock_span(snapshot),
        _abort(snapshot),
        Span(text if urgent else "", tone),
        Span(REHEARSAL if snapshot.rehearsal else "", Tone.NOTICE),
        Span("PRACTICE" if snapshot.practice else "", Tone.NOTICE),
        Span(next(iter(snapshot.all_faults), snapshot.notice or ""), Tone.BAD),
        Span(f"{minutes_text(left or 0.0)} left" if run.phase is Phase.RUNNING else ""),
        Span(text if run.active and not urgent else "", tone),
        Span("60x18 shows all", Tone.DIM),
    )
    return packed((span for span in spans if span.text), width, "  ")


def _abort(snapshot: Snapshot) -> Span:
    """The key, or why it does nothing; a replay says that it is one."""
    if snapshot.playback is not None:
        return Span(f"REPLAY {state_span(snapshot.playback).text}", Tone.NOTICE)
    refused = snapshot.refusal(Abort.name)
    return Span(f"F8 abort: {refused}", Tone.DIM) if refused else Span("F8 ABORT", Tone.CAP)
