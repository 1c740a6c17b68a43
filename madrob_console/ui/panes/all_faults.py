"""What is wrong now: faults, the banner, the evidence line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len

from madrob_console.referee.acts import Abort, Start
from madrob_console.referee.records import counted, format_duration
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph, width_of
from madrob_console.ui.look.words import shortened, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import EvidenceTopicView, EvidenceView, Snapshot

MOST_ROWS = 3
"""Rows that faults may take from the screen."""

FAULT, NOTE = " FAULT ", " NOTE  "

BELOW, ON_LIVE = " below", ": F3"
"""Where the rest of the faults stands."""


class AllFaults(View):
    """Every fault, with all its words, if the screen's fault line has no room for them."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if not short_form(snapshot, self.screen.size.width, BELOW).cut:
            return ()
        rows = [line(Span("all faults", Tone.STRONG), Span("  arrows and PgDn scroll", Tone.DIM))]
        for fault in snapshot.all_faults:
            rows += paragraph(fault, width, Tone.BAD, line("- "))
        return rows


class ShortForm(NamedTuple):
    """The faults in a few rows, and whether any of their words are missing there."""

    rows: list[str]
    cut: bool


def notices(snapshot: Snapshot, width: int) -> list[Line]:
    """Notices that are no faults and stand before them: a row at most."""
    told = [] if snapshot.notice is None else wrapped(snapshot.notice, width - len(FAULT))[:1]
    return [line(Span(NOTE, Tone.NOTICE), Span(text, Tone.WARN)) for text in told]


def short_form(snapshot: Snapshot, width: int, where: str) -> ShortForm:
    """The faults as the fault line of a screen has them; `where` says where the rest stands."""
    faults, room = snapshot.all_faults, width - len(FAULT)
    most = MOST_ROWS - len(notices(snapshot, width))
    rows: list[str] = []
    shown = 0
    for fault in faults:
        lines = wrapped(fault, room)
        if rows and len(rows) + len(lines) > most:
            break
        rows += lines
        shown += 1
    hidden, kept = len(faults) - shown, rows[:most]
    if not hidden and kept == rows:
        return ShortForm(rows, cut=False)
    more = f"({f'and {hidden} more' if hidden else 'more'}{where})"
    if kept == rows and cell_len(kept[-1]) + 1 + cell_len(more) <= room:
        kept[-1] += f" {more}"
    elif kept == rows and len(rows) < most:
        kept.append(more)
    else:
        kept[-1] = f"{_cut(kept[-1], room - 1 - cell_len(more))} {more}"
    return ShortForm(kept, cut=True)


def _cut(row: str, width: int) -> str:
    """The first words of a row: a number tells nothing without what it counts."""
    words = row.split()
    while words and (cell_len(" ".join(words)) > width - 2 or words[-1].isdigit()):
        words.pop()
    return f"{' '.join(words)} …" if words else shortened(f"{row} …", width)


# The banner: the one thing that the referee should look at now.


class Banner(View):
    """A false start, a question, or what comes next."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = banner(snapshot)
        return paragraph(text, width, tone)


def banner(snapshot: Snapshot) -> tuple[str, Tone]:
    run = snapshot.run
    if (false_start := run.undecided_false_start) is not None:
        at = "" if run.start is None else f" at {false_start.time - run.start:.1f} s"
        return f" FALSE START: {false_start.event.words}{at}{_decision(snapshot)} ", Tone.ALARM
    if writing := snapshot.pulse.writing:
        how = "; F8 withdraws it" if snapshot.refusal(Abort.name) is None else ""
        return f" {writing.upper()}: waiting for the disk{how} ", Tone.NOTICE
    if snapshot.ask_referee is not None:
        silent = snapshot.playback is not None or snapshot.right.only_watches
        how = "" if silent else " (1-6 rules on a step)"
        return f" REFEREE: {snapshot.ask_referee}{how} ", Tone.NOTICE
    if snapshot.settling:
        return "door closed: waiting for the settle time of step 6", Tone.WARN
    return _next(snapshot), Tone.PLAIN


def _decision(snapshot: Snapshot) -> str:
    if snapshot.playback is not None or snapshot.right.only_watches:
        return ""
    again = "r restarts the countdown, " if snapshot.run.phase is Phase.COUNTDOWN else ""
    return f": {again}a accepts it with a reason"


def _next(snapshot: Snapshot) -> str:
    read_only = snapshot.playback is not None or snapshot.right.only_watches
    match snapshot.run.phase:
        case Phase.IDLE | Phase.READY if snapshot.right.only_watches:
            return ""
        case Phase.IDLE:
            return "F2: set up a run"
        case Phase.READY:
            refused = snapshot.refusal(Start.name)
            return "F5 starts the countdown" if refused is None else f"F5 waits: {refused}"
        case Phase.COUNTDOWN:
            return "countdown: nobody touches the handle or the door"
        case Phase.RUNNING:
            step = next((record for record in snapshot.steps if not record.done), None)
            return "" if step is None else f"next: step {step.step} {step.step.text}"
        case Phase.STOPPED:
            if snapshot.result is not None:
                return "F4: result"
            if snapshot.rescoring:
                return "the result is being scored again"
            return "the run has stopped" if snapshot.playback else "the result is being written"
        case Phase.FINAL:
            more = "F4: result" if read_only else "x sets up the next run"
            return f"the result is final: {more}"


# The evidence line: what is recorded, and what is lost.


_GAP = "  "

_LEAST = 20
"""A topic that is cut takes this many cells at least."""

_ENDINGS = ("/image_raw/compressed", "/image/compressed", "/compressed", "/image_raw", "/image")


class EvidenceLine(View):
    """What is wrong first, then how long there is room, then what comes, as far as it fits."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
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
        return [line(*_cut_spans(row, width))]


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
    return (Span(f"{_GAP}room for {format_duration(evidence.room)}"),)


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
    """The parts that fit, and how many more there are.

    The first part is cut if necessary. If not even it would be legible, all are only counted.
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
        row = _cut_spans((*row, *part), width - after)
    return row


def _cut_spans(row: Sequence[Span], width: int) -> Line:
    kept: list[Span] = []
    for span in row:
        rest = width - width_of(tuple(kept))
        if text := shortened(span.text, rest):
            kept.append(Span(text, span.tone))
    return tuple(kept)


def _short_names(topics: Sequence[str]) -> dict[str, str]:
    """Topic names without the common end of all cameras' topics, if they still differ."""
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
