"""The recorder and the sources, in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.ui.widgets.lines import Line, Span, Tone, View, line
from madrob_console.ui.words import size_text

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot, TopicView


class RecorderLine(View):
    """What is being written, and which topics do not deliver."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """One row; two when something is wrong with a topic or the recorder."""
        recorder = snapshot.recorder
        silent = [topic for topic in snapshot.topics if _silent(topic)]
        wanted = [topic for topic in snapshot.topics if not topic.optional]
        fresh = sum(topic.freshness is Freshness.FRESH for topic in wanted)
        rows = [
            line(
                Span("recorder ", Tone.STRONG),
                f"{recorder.state}, {recorder.messages} messages, {size_text(recorder.size)}, ",
                Span(f"{recorder.dropped} dropped", Tone.ALARM if recorder.dropped else Tone.PLAIN),
                Span("  sources ", Tone.STRONG),
                Span(
                    f"{fresh} of {len(wanted)} fresh",
                    Tone.GOOD if fresh == len(wanted) else Tone.BAD,
                ),
            )
        ]
        if recorder.problem:
            rows.append(line(Span(recorder.problem, Tone.BAD)))
        elif silent:
            words = "  ".join(f"{topic.topic} {topic.freshness}" for topic in silent)
            rows.append(line(Span(words, Tone.BAD)))
        return rows


def _silent(topic: TopicView) -> bool:
    return not topic.optional and topic.freshness is not Freshness.FRESH
