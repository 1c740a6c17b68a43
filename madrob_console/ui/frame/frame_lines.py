"""The lines around every pane: top, faults, status, keys, playback, and a tiny terminal's clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, cast

from rich.cells import cell_len
from textual import events
from textual.keys import _character_to_key

from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import Abort
from madrob_console.referee.checks import Freshness
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import (
    Line,
    Lines,
    Span,
    Target,
    Tone,
    View,
    line,
    paragraph,
    scale,
    width_of,
)
from madrob_console.ui.keys.key_table import (
    FINDS_BY_ITSELF,
    FUNCTION_KEYS,
    KEYS,
    LETTER_KEYS,
    PLAYBACK_KEYS,
    Key,
)
from madrob_console.ui.look.words import (
    fitted,
    minutes_text,
    shortened,
    size_text,
    time_of_day,
    wrapped,
)
from madrob_console.ui.panes.all_faults import BELOW, FAULT, ON_LIVE, banner, notices, short_form
from madrob_console.ui.panes.run_status import clock_span, phase_span

if TYPE_CHECKING:
    from madrob_console.engine.requests import PlaybackView
    from madrob_console.engine.snapshot import RecorderView, Snapshot, TopicView
    from madrob_console.ui.keys.console_app import ConsoleApp

LITTLE_DISK = 2_000_000_000
"""Below this many bytes free the number is marked; the pre-start check decides."""

WATCHING = " WATCHING"
"""Shown on a screen that can do nothing to the run."""

_LEAST_LABEL = 18
ROOMY = 100
"""With fewer cells the row below shows competition and machine."""

_STATES = {"finished": "done"}


class TopLine(View):
    """Which source, which competition (`where`), and whether everything is being kept."""

    def __init__(self, where: str) -> None:
        super().__init__(id="top-line")
        self._where = where

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.pulse.stale:
            return [_old(snapshot, width)]
        clock = f" {time_of_day(snapshot.time)}"
        recorder = recorder_spans(snapshot.recorder)
        age = Span(f" {_oldest(snapshot.topics)}", _age_tone(snapshot.topics))
        disk = () if snapshot.playback else _disk(snapshot.disk_free)  # nothing is written
        rights = (
            line(*recorder, age, *disk, clock),
            line(*recorder, age, clock),
            line(*recorder, clock),
            line(*recorder),
        )
        right = next((r for r in rights if width_of(r) + _LEAST_LABEL <= width), rights[-1])
        reserved = width_of(right) + (len(WATCHING) if snapshot.right.only_watches else 0)
        badge = source_badge(snapshot, max(4, width - reserved))
        watching = line(Span(WATCHING, Tone.STRONG)) if snapshot.right.only_watches else ()
        room = max(0, width - width_of((badge, *watching)) - width_of(right))
        where = f" {self._where}" if width >= ROOMY else ""
        return [line(badge, *watching, Span(fitted(where, room), Tone.STRONG), *right)]


def _old(snapshot: Snapshot, width: int) -> Line:
    word = " ENDED " if snapshot.pulse.gone else " SILENT "
    text = f" {snapshot.label}, as it was at {time_of_day(snapshot.time)}"
    return line(Span(word, Tone.ALARM), Span(shortened(text, width - len(word)), Tone.DIM))


def source_badge(snapshot: Snapshot, room: int) -> Span:
    """The source's label in at most `room` cells: LIVE and others differ in word and mark."""
    label = snapshot.label
    may_count = not snapshot.practice and snapshot.simulated is None
    if snapshot.source_kind is SourceKind.ROS and may_count:
        return Span(f" {shortened(label, max(1, room - 2))} ", Tone.LIVE)
    return Span(f" ~~ {shortened(label, max(1, room - 8))} ~~ ", Tone.NOTICE)


def recorder_spans(recorder: RecorderView) -> Line:
    if recorder.state == "closed":
        return line(Span(" rec closed", Tone.DIM))
    recording = recorder.state == "recording"
    tone = Tone.BAD if recorder.problem or recorder.state == "failed" else Tone.PLAIN
    name = "REC" if recording else f"rec {_STATES.get(recorder.state, recorder.state)}"
    return line(
        Span(f" {name}", Tone.GOOD if recording and tone is Tone.PLAIN else tone),
        f" {recorder.messages} {size_text(recorder.size)} ",
        Span(f"{recorder.dropped} drop", Tone.ALARM if recorder.dropped else Tone.DIM),
    )


def _oldest(topics: Sequence[TopicView]) -> str:
    needed = [topic for topic in topics if not topic.optional]
    if not needed or any(topic.age is None for topic in needed):
        return "no data"
    oldest = max(topic.age or 0.0 for topic in needed)
    return "age <0.5s" if oldest <= 0.5 else f"age {oldest:.1f}s" if oldest < 60 else "age >1min"


def _age_tone(topics: Sequence[TopicView]) -> Tone:
    fresh = all(t.freshness is Freshness.FRESH for t in topics if not t.optional)
    return Tone.DIM if topics and fresh else Tone.BAD


def _disk(free: int | None) -> Line:
    if free is None:
        return line(Span(" disk ?", Tone.WARN))
    tone = Tone.WARN if free < LITTLE_DISK else Tone.DIM
    return line(Span(f" {size_text(free)}", tone))


# Faults of now; each stays until it is gone.


class FaultLine(View):
    """The faults, one a row; the last row counts the rest. `whole_below`: the pane has them all."""

    def __init__(self, where: str = "") -> None:
        super().__init__()
        self.whole_below = False
        self._where = where

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        told = notices(snapshot, width)
        if not snapshot.all_faults and told:
            return told
        if not snapshot.all_faults:
            room = 0 if width >= ROOMY else min(cell_len(self._where), width - 10)
            where = fitted(self._where, room)  # the top line has no room for it
            left = fitted("no faults", width - cell_len(where))
            return [line(Span(left + where, Tone.DIM))]
        rows = short_form(snapshot, width, BELOW if self.whole_below else ON_LIVE).rows
        marks = [FAULT] + [" " * len(FAULT)] * (len(rows) - 1)
        return told + [
            line(Span(mark, Tone.ALARM), Span(row, Tone.BAD))
            for mark, row in zip(marks, rows, strict=True)
        ]


# The footer: every key, bright where it works now, dim where it does not.


_ROOMY = 100
_ALWAYS_NAMED = ("start", "abort", "timeout", "leave")
"""Keys that keep their names if there is no room for all."""
_PLAYBACK_NAMES = tuple(key.name for key in PLAYBACK_KEYS)


class KeyLine(View):
    """Two rows; a key with a refusal is dim and not reversed. A spectator sees none of an act."""

    pane = "setup"
    typing = False

    def on_click(self, event: events.Click) -> None:
        if (hit := self.clicked(event)) is None:
            return
        key = KEYS[hit[0]]
        pressed = key.keys.split(",")
        under = _character_to_key(hit[1])
        which = len(pressed) > 1 and all(len(name) == 1 for name in pressed)  # as of the steps
        if under in pressed or not which:
            name = under if under in pressed else pressed[0]
            self.app.call_later(cast("ConsoleApp", self.app).action_press, key.name, name)

    def lines(self, width: int) -> Sequence[Line]:
        """Function keys and letters; all dim before there is an engine."""
        return [self._named(FUNCTION_KEYS, width, _ALWAYS_NAMED), self._letters(width)]

    def _letters(self, width: int) -> Line:
        if self.typing and not (self._snapshot is not None and self._snapshot.pulse.gone):
            return line(
                Span("letters type: ", Tone.STRONG),
                Span("Enter, Tab, arrows move on; F keys and ", Tone.DIM),
                Target("^P", Tone.CAP, KEYS["menu"].name),
                Span(" work"),
            )
        keys: tuple[Key, ...] = LETTER_KEYS
        snapshot = self._snapshot
        if snapshot is not None and snapshot.pulse.gone:
            if snapshot.right.only_watches:
                return line(Span(FINDS_BY_ITSELF, Tone.STRONG))
            again = KEYS["engine"]
            cap = Target(again.cap, Tone.CAP, again.name)
            return line(cap, Target(f" {again.help}", Tone.STRONG, again.name))
        if snapshot is not None and snapshot.playback is not None:
            played = (key for key in PLAYBACK_KEYS if self.pane in key.where)
            keys = (*played, *(key for key in LETTER_KEYS if not key.act))
        row = self._row(keys, width)
        if width_of(row) <= width:
            return row
        here = [key for key in keys if not key.where or self.pane in key.where]
        return self._named(here, width, _PLAYBACK_NAMES)

    def _named(self, keys: Sequence[Key], width: int, most: Sequence[str]) -> Line:
        """The keys with their names; without room the last lose theirs, except those in `most`."""
        named = [key.name for key in keys]
        losing = [name for name in named if name not in most]
        row = self._row(keys, width)
        while width_of(row) > width and losing:
            named.remove(losing.pop())
            row = self._row(keys, width, named)
        return row

    def _row(self, keys: Sequence[Key], width: int, named: Sequence[str] | None = None) -> Line:
        roomy = width >= _ROOMY
        spans: list[Span] = []
        watches = self._snapshot is not None and self._snapshot.right.only_watches
        for key in keys:
            if watches and key.act:
                continue  # nobody here can ever act
            if spans:
                spans.append(Span("  " if roomy else " "))
            label = key.label if named is None or key.name in named else ""
            space = " " if roomy and not label.startswith(" ") else ""
            if self._snapshot is None or key.refusal(self._snapshot) is not None:
                spans.append(Target(f"{key.cap}{space}{label}", Tone.DIM, key.name))
                continue
            tone = Tone.STRONG if key.pane and key.pane == self.pane else Tone.PLAIN
            spans.append(Target(key.cap, Tone.CAP, key.name))
            spans.append(Target(f"{space}{label}", tone, key.name))
        return tuple(spans)


# The position of a replay, above every pane, so that nobody takes it for a live run.


_LEAST_GAUGE = 10


class PlaybackBar(View):
    """One row; none for anything but a replay."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        playback = snapshot.playback
        return () if playback is None else [playback_line(playback, width)]


def playback_line(playback: PlaybackView, width: int) -> Line:
    """The bar in `width` cells; the scale goes first if there is little room."""
    words = line(
        Span(" REPLAY ", Tone.NOTICE),
        " ",
        state_span(playback),
        f"  {position_text(playback.position)} / {position_text(playback.end)}",
    )
    room = width - width_of(words) - 4
    if room < _LEAST_GAUGE:
        return words
    return (*words, Span("  ["), *_scale(playback, room), Span("]"))


def state_span(playback: PlaybackView) -> Span:
    if playback.jumping_to is not None:
        return Span(f"jumping to {position_text(playback.jumping_to)}", Tone.WARN)
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


def position_text(seconds: float) -> str:
    """Minutes, seconds and hundredths from the start of the run: a step can be seen."""
    hundredths = round(abs(seconds) * 100)
    sign = "-" if seconds < 0 and hundredths else ""
    return f"{sign}{hundredths // 6000}:{hundredths // 100 % 60:02d}.{hundredths % 100:02d}"


def _scale(playback: PlaybackView, width: int) -> Line:
    length = max(1e-9, playback.end - playback.begin)

    def cell(at: float) -> int:
        return min(width - 1, max(0, round((at - playback.begin) / length * (width - 1))))

    played = cell(playback.position)
    marks = [(number, "=", Tone.STRONG) for number in range(played)]
    start = [(cell(0.0), "|", Tone.STRONG)] if playback.begin <= 0.0 <= playback.end else []
    return scale("-" * width, [*marks, *start, (played, "●", Tone.WARN)])


# The latest message, with its time of day; it fades, and goes with the next key.


FRESH = 5.0
"""After this a message is dim, s."""

_GRAVE = (Tone.BAD, Tone.WARN)


class StatusLine(Lines):
    """A message; if there is none, the hint.

    `monotonic` is for the age of a message, s; `wall` in s since the epoch.
    """

    def __init__(
        self, hint: str, monotonic: Callable[[], float], wall: Callable[[], float] = time.time
    ) -> None:
        super().__init__(id="status-line")
        self._monotonic = monotonic
        self._wall = wall
        self._said = ""
        self._at = self._shown_at = 0.0
        self._faded = False
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
        self._at, self._shown_at, self._faded = self._wall(), self._monotonic(), False
        self.redraw()

    def age(self) -> None:
        faded = bool(self._said) and self._monotonic() - self._shown_at >= FRESH
        if faded != self._faded:
            self._faded = faded
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
            return paragraph(self.hint, width, Tone.DIM)
        head = line(Span(f"{time_of_day(self._at)} ", Tone.DIM))
        return paragraph(self._said, width, Tone.DIM if self._faded else self.tone, head)


# The run in a terminal that is too small for the other screens.


SMALLEST = (10, 3)
"""Columns and rows for the phase, the clock and the way to abort."""

_GAP = Span("  ")
_ROOM_FOR_REASONS = 24
_MOST_ROWS = 3


class Part(IntEnum):
    """What there is to show, the most important first."""

    CLOCK = 0
    ABORT = 1
    PHASE = 2
    KIND = 3
    URGENT = 4
    FAULT = 5
    LEFT = 6
    NEXT = 7
    HINT = 8


class TinyClock(View):
    """Clock, abort, and as much else as there are rows for."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        return tiny_lines(snapshot, width, self.room.height)


def tiny_lines(snapshot: Snapshot, width: int, height: int) -> list[Line]:
    """The most important parts that fit into `width` x `height` cells, from the top.

    Phase, clock and time left share a row if that is wide enough. Long texts are wrapped, and
    cut to one row before anything but the hint gives way to them.
    """
    lines: list[Line] = []
    for kept, most in _concessions():
        lines = _lines(snapshot, width, kept, most)
        if len(lines) <= height:
            break
    return lines[:height]


def _concessions() -> Iterator[tuple[Sequence[Part], int]]:
    parts = list(Part)
    yield parts, _MOST_ROWS
    for most in range(_MOST_ROWS, 0, -1):
        yield parts[:-1], most
    for count in range(len(parts) - 2, 0, -1):
        yield parts[:count], 1


def _lines(snapshot: Snapshot, width: int, kept: Sequence[Part], most: int) -> list[Line]:
    text, tone = banner(snapshot)
    urgent = tone in (Tone.ALARM, Tone.NOTICE)
    head = {
        Part.PHASE: phase_span(snapshot.run),
        Part.CLOCK: clock_span(snapshot),
        Part.KIND: Span("PRACTICE" if snapshot.practice else "", Tone.NOTICE),
        Part.LEFT: Span(_left(snapshot)),
    }
    lines = _packed((span for part, span in head.items() if part in kept and span.text), width)
    if Part.URGENT in kept and urgent:
        lines += _wrapped(text.strip(), tone, width, most)
    if Part.NEXT in kept and not urgent and snapshot.run.active:
        lines += _wrapped(text, tone, width, most)
    if Part.FAULT in kept and snapshot.all_faults:
        lines += _wrapped(f"FAULT {snapshot.all_faults[0]}", Tone.BAD, width, most)
    elif Part.FAULT in kept and snapshot.notice is not None:
        lines += _wrapped(snapshot.notice, Tone.WARN, width, most)
    if Part.ABORT in kept:
        lines.append(_abort(snapshot, width))
    if Part.HINT in kept:
        lines.append(line(Span(fitted("60x18 shows all", width), Tone.DIM)))
    return lines


def _packed(spans: Iterable[Span], width: int) -> list[Line]:
    lines: list[Line] = []
    for text, tone in spans:
        span = Span(shortened(text, width), tone)
        if lines and width_of((*lines[-1], _GAP, span)) <= width:
            lines[-1] = (*lines[-1], _GAP, span)
        else:
            lines.append((span,))
    return lines


def _wrapped(text: str, tone: Tone, width: int, most: int) -> list[Line]:
    rows = wrapped(text, width) if text else []
    if len(rows) > most:
        rows = [*rows[: most - 1], fitted(" ".join(rows[most - 1 :]), width)]
    return [line(Span(row, tone)) for row in rows]


def _left(snapshot: Snapshot) -> str:
    """Time to the timeout; that of a countdown is the clock itself."""
    if snapshot.remaining is None or snapshot.run.phase is not Phase.RUNNING:
        return ""
    return f"{minutes_text(snapshot.remaining)} left"


def _abort(snapshot: Snapshot, width: int) -> Line:
    """The key as in the footer, dim with the reason if it does nothing; a replay says it is one."""
    if snapshot.playback is not None:
        return line(Span("REPLAY", Tone.NOTICE), " ", state_span(snapshot.playback))
    refused = snapshot.refusal(Abort.name)
    if refused is None:
        return line(Span("F8", Tone.CAP), Span(" ABORT", Tone.STRONG))
    text = f"F8 abort: {refused}" if width >= _ROOM_FOR_REASONS else "(F8 abort)"
    return line(Span(fitted(text, width), Tone.DIM))
