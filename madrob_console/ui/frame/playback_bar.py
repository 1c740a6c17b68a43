"""Where a replay stands: above every pane, so that nobody takes it for a run that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.gauge import scale
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of

if TYPE_CHECKING:
    from madrob_console.engine.shown.playback import PlaybackView
    from madrob_console.engine.shown.snapshot import Snapshot

_LEAST_GAUGE = 10


class PlaybackBar(View):
    """One row; none for anything but a replay."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """REPLAY, playing or not, speed, position and length, and the same as a scale."""
        playback = snapshot.playback
        return () if playback is None else [playback_line(playback, width)]


def playback_line(playback: PlaybackView, width: int) -> Line:
    """The bar in `width` cells; the scale goes first where there is little room."""
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
    """Playing, paused, jumping or at the end, and how fast."""
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
    """What has been played, and a mark at the start of the run."""
    length = max(1e-9, playback.end - playback.begin)

    def cell(at: float) -> int:
        return min(width - 1, max(0, round((at - playback.begin) / length * (width - 1))))

    played = cell(playback.position)
    marks = [(number, "=", Tone.STRONG) for number in range(played)]
    start = [(cell(0.0), "|", Tone.STRONG)] if playback.begin <= 0.0 <= playback.end else []
    return scale("-" * width, [*marks, *start, (played, "●", Tone.WARN)])
