"""What is known before the result, and how many sources deliver, in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import rough_text
from scoring.result import DOUBTED

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_NAMES = {
    "time_to_handle": "to handle",
    "door_occupation_time": "occupation",
    "passage_time": "passage",
}
_SETTLED = "time_to_handle"
"""It is known with the touch; the others follow the last crossing and the last closing."""


class Provisional(View):
    """The time indicators as they become known; what the run can still change is marked."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """One row; two when a source is silent or the recorder has a problem."""
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
