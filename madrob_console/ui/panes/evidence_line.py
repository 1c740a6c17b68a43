"""What is recorded as evidence, and what is lost of it, in one line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.amounts import counted, duration_words
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.look.words import shortened

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import EvidenceTopicView, EvidenceView, Snapshot

_GAP = "  "

_LEAST = 20
"""A topic that is cut takes this many cells at least."""

_ENDINGS = ("/image_raw/compressed", "/image/compressed", "/compressed", "/image_raw", "/image")


class EvidenceLine(View):
    """What is wrong first, then how long there is room, then what comes, as far as it fits."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """One row; none where no evidence is wanted."""
        evidence = snapshot.evidence
        if evidence is None:
            return ()
        names = _short_names([topic.topic for topic in evidence.topics])
        topics = sorted(evidence.topics, key=lambda t: (not t.problem, -t.lost, t.topic))
        least = "+" if evidence.gaps else ""  # nobody counts what comes while nothing is recorded
        poor = [_poor(one, names[one.topic], least) for one in topics if _is_poor(one)]
        good = [_good(one, names[one.topic]) for one in topics if not _is_poor(one)]
        room = _room(evidence)
        row = [Span("evidence", Tone.STRONG), *_of_all(evidence)]
        row += _as_they_fit(poor, width - width_of(tuple(row)) - width_of(room))
        for part in (room, *_sums(evidence), *good):
            if width_of(tuple(row)) + width_of(part) > width:
                break
            row += part
        return [line(*_cut(row, width))]


def _of_all(evidence: EvidenceView) -> Iterator[Span]:
    if evidence.problem is not None:
        yield Span(f"{_GAP}{evidence.problem}", Tone.BAD)
    elif not evidence.topics:
        yield Span(f"{_GAP}none of its topics is there", Tone.WARN)
    if over := [gap for gap in evidence.gaps if gap.end is not None]:
        number = sum(gap.number for gap in over)
        when = over[-1].words if number == 1 else f"{number} times"
        yield Span(f"{_GAP}missing {when}", Tone.WARN)


def _room(evidence: EvidenceView) -> Line:
    if evidence.room is None:
        return ()
    return (Span(f"{_GAP}room for {duration_words(evidence.room)}"),)


def _sums(evidence: EvidenceView) -> Iterator[Line]:
    if number := len(evidence.topics):
        byte_rate = sum(topic.byte_rate for topic in evidence.topics)
        yield (Span(f"{_GAP}{counted(number, 'topic')} {byte_rate / 1e6:.1f} MB/s"),)
    if evidence.recording:
        yield (Span(f"{_GAP}{evidence.size / 1e6:.0f} MB recorded", Tone.DIM),)


def _is_poor(topic: EvidenceTopicView) -> bool:
    return bool(topic.lost or topic.problem)


def _poor(topic: EvidenceTopicView, name: str, least: str) -> Line:
    lost = f"{topic.lost}{least} lost" if topic.lost else ""
    wrong = ", ".join(filter(None, (topic.problem, lost)))
    return (Span(f"{_GAP}{name} ", Tone.DIM), Span(wrong, Tone.WARN))


def _good(topic: EvidenceTopicView, name: str) -> Line:
    words = f"{topic.rate:.1f} Hz {_size(topic.byte_rate)}/s"
    return (Span(f"{_GAP}{name} ", Tone.DIM), Span(words))


def _as_they_fit(parts: Sequence[Line], width: int) -> Line:
    """The first ones, the first of all cut where it must be, and how many there are more.

    Where not even that one would be told they are only counted.
    """
    row: Line = ()
    more = len(f"{_GAP}and {len(parts)} more") if len(parts) > 1 else 0
    if parts and width - more < min(_LEAST, width_of(parts[0])):
        topics = f"{len(parts)} topics lack" if len(parts) > 1 else "1 topic lacks"
        return (Span(f"{_GAP}{topics} some", Tone.WARN),)
    for number, part in enumerate(parts):
        after = more if number < len(parts) - 1 else 0
        if number and width_of(row) + width_of(part) + after > width:
            return (*row, Span(f"{_GAP}and {len(parts) - number} more", Tone.WARN))
        row = _cut((*row, *part), width - after)
    return row


def _cut(row: Sequence[Span], width: int) -> Line:
    kept: list[Span] = []
    for span in row:
        rest = width - width_of(tuple(kept))
        if text := shortened(span.text, rest):
            kept.append(Span(text, span.tone))
    return tuple(kept)


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


def _size(number: float) -> str:
    return f"{number / 1e6:.1f} MB" if number >= 100_000 else f"{number / 1e3:.1f} kB"
