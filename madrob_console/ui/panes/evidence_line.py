"""What is recorded as evidence, and what is lost of it, in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.preflight import duration_words
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.look.words import cut_inside, shortened

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import EvidenceTopicView, EvidenceView, Snapshot

_GAP = "  "
_ROOMY = 100
"""From this width on the size is shown, too."""

_LEAST_NAME = 8
"""Cells of the first topic's name, however narrow the line is."""

_ENDINGS = ("/image_raw/compressed", "/image/compressed", "/compressed", "/image_raw", "/image")


class EvidenceLine(View):
    """All of it first, then its topics as far as there is room: what lacks something first."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """One row; none where no evidence is wanted."""
        evidence = snapshot.evidence
        if evidence is None:
            return ()
        spans = [Span("evidence", Tone.STRONG)]
        for span in _whole(evidence, roomy=width >= _ROOMY):
            spans.append(Span(shortened(span.text, width - width_of(tuple(spans))), span.tone))
        names = _short_names([topic.topic for topic in evidence.topics])
        topics = sorted(evidence.topics, key=lambda topic: (not _is_poor(topic), topic.topic))
        for number, topic in enumerate(topics):
            shown = _topic(topic, name := names[topic.topic])
            more = f"{_GAP}and {len(topics) - number} more"
            rest = width - width_of(tuple(spans))
            needed = width_of(shown) + (len(more) if number < len(topics) - 1 else 0)
            if number == 0 and len(name) - _LEAST_NAME >= needed - rest > 0:
                shown = _topic(topic, cut_inside(name, len(name) - (needed - rest)))
                needed = rest
            if needed > rest:
                spans.append(Span(more[:rest], Tone.DIM))
                break
            spans += shown
        return [line(*spans)]


def _whole(evidence: EvidenceView, *, roomy: bool) -> list[Span]:
    if evidence.problem is not None:
        return [Span(f"{_GAP}{evidence.problem}", Tone.BAD)]
    if not evidence.topics:
        return [Span(f"{_GAP}none of its topics is there", Tone.WARN)]
    byte_rate = sum(topic.byte_rate for topic in evidence.topics)
    lost = sum(topic.lost for topic in evidence.topics)
    spans = [Span(f"{_GAP}{byte_rate / 1e6:.1f} MB/s")]
    if evidence.recording and roomy:
        spans.append(Span(f" {evidence.size / 1e6:.0f} MB", Tone.DIM))
    if evidence.room is not None and not evidence.recording:
        spans.append(Span(f" room for {duration_words(evidence.room)}", Tone.DIM))
    if lost:
        spans.append(Span(f" {lost} lost", Tone.WARN))
    return spans


def _is_poor(topic: EvidenceTopicView) -> bool:
    return bool(topic.lost or topic.problem)


def _short_names(topics: Sequence[str]) -> dict[str, str]:
    """Names without what all cameras' topics end with, where that leaves them different."""
    short = {topic: topic.removeprefix("/") for topic in topics}
    for topic, name in short.items():
        for ending in _ENDINGS:
            cut = name.removesuffix(ending)
            if cut and cut != name and cut not in short.values():
                short[topic] = cut
                break
    return short


def _topic(topic: EvidenceTopicView, name: str) -> Line:
    spans = [
        Span(f"{_GAP}{name} ", Tone.DIM),
        Span(f"{topic.rate:.1f} Hz {_size(topic.byte_rate)}/s"),
    ]
    if topic.lost:
        spans.append(Span(f", {topic.lost} lost", Tone.WARN))
    if topic.problem:
        spans.append(Span(f", {topic.problem}", Tone.WARN))
    return tuple(spans)


def _size(number: float) -> str:
    return f"{number / 1e6:.1f} MB" if number >= 100_000 else f"{number / 1e3:.1f} kB"
