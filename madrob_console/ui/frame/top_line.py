"""The line that is always on top: source, competition, recorder, sources, disk, time of day."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.kinds import SourceKind
from madrob_console.referee.health import Freshness
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.look.words import fitted, shortened, size_text, time_of_day

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import RecorderView, Snapshot, TopicView

LITTLE_DISK = 2_000_000_000
"""Below this many bytes free the number is marked; the pre-start check decides."""

WATCHING = " WATCHING"
"""On a screen that can do nothing to the run."""

_LEAST_LABEL = 18
ROOMY = 100
"""With fewer cells the row below tells competition and machine."""

_STATES = {"finished": "done"}


class TopLine(View):
    """Which source, which competition, and whether everything is being kept.

    Args:
        where: competition and machine; the row below has room for them where this one has not.
    """

    def __init__(self, where: str) -> None:
        super().__init__(id="top-line")
        self._where = where

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The source on the left, what is being kept on the right, names between them."""
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
    """Nothing of it is told as if it were so now."""
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
    """The recorder in a few words."""
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
    """How old the newest message of the most silent needed topic is."""
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
