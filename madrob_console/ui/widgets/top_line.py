"""The line that is always on top: source, competition, recorder, disk, time of day."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.cells import cell_len

from madrob_console.ui.widgets.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.words import fitted, size_text, time_of_day

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import RecorderView, Snapshot

LITTLE_DISK = 2_000_000_000
"""Below this many bytes free the number is marked; the pre-start check decides."""

_LEAST_LABEL = 18
_BADGE_FRAME = 8
_STATES = {"finished": "done"}


class TopLine(View):
    """Which source, which competition, and whether everything is being kept."""

    def __init__(self, competition: str) -> None:
        super().__init__(id="top-line")
        self._competition = competition

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The source on the left, what is being kept on the right; the disk gives way first."""
        clock = f"  {time_of_day(snapshot.time)}"
        recorder = recorder_spans(snapshot.recorder)
        right = line(*recorder, *_disk(snapshot.disk_free), clock)
        badge = source_badge(snapshot, max(_LEAST_LABEL, width - width_of(right) - _BADGE_FRAME))
        if width_of((badge,)) + width_of(right) > width:
            right = line(*recorder, clock)
        room = width - width_of((badge,)) - width_of(right)
        return [
            line(badge, Span(fitted(f" {self._competition}", max(0, room)), Tone.STRONG), *right)
        ]


def source_badge(snapshot: Snapshot, room: int) -> Span:
    """The source's label: LIVE and anything else differ in word, mark and colour."""
    label = snapshot.source_label
    if cell_len(label) > room:
        label = fitted(label, room)
    if snapshot.source_kind == "ros":
        return Span(f" {label} ", Tone.LIVE)
    return Span(f" ~~ {label} ~~ ", Tone.NOTICE)


def recorder_spans(recorder: RecorderView) -> Line:
    """The recorder in a few words."""
    if recorder.state == "closed":
        return line(Span(" rec closed", Tone.DIM))
    recording = recorder.state == "recording"
    tone = Tone.BAD if recorder.problem or recorder.state == "failed" else Tone.PLAIN
    name = "REC" if recording else f"rec {_STATES.get(recorder.state, recorder.state)}"
    return line(
        Span(f" {name}", Tone.GOOD if recording and tone is Tone.PLAIN else tone),
        f" {recorder.messages} msg {size_text(recorder.size)} ",
        Span(f"{recorder.dropped} dropped", Tone.ALARM if recorder.dropped else Tone.DIM),
    )


def _disk(free: int | None) -> Line:
    if free is None:
        return line(Span("  disk ?", Tone.WARN))
    tone = Tone.WARN if free < LITTLE_DISK else Tone.DIM
    return line(Span(f"  {size_text(free)}", tone))
