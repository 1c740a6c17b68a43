"""Where the run stands: words, clock, the six steps, marks and files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from rich.cells import cell_len
from textual.geometry import Size

from madrob_console.archive.folders import PICTURES_FOLDER
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import Flag, FlagWeight, doubted_words, undecided, worst
from madrob_console.referee.records import relative_text
from madrob_console.referee.run import Phase, Run
from madrob_console.ui.cells.large_text import HEIGHT, large_text, rows_of, width_of_large
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph, width_of
from madrob_console.ui.look.words import (
    OUTCOMES,
    PHASES,
    clock_text,
    cut_inside,
    date_of,
    fitted,
    minutes_text,
    rough_text,
    wrapped,
)
from scoring.procedure import UNSETTLED, StepRecord
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

# The run's clock in large digits.


_LARGEST_TIME = "-00:00"
"""What there is room for, whatever the time: nothing moves when a run goes on for long."""

_FEWEST = (50, 16)
"""Columns and rows of the terminal for each size of the clock."""


def clock_size(terminal: Size) -> int:
    """How large the clock is: it grows with the terminal and with nothing else."""
    width, height = _FEWEST
    return max(1, min(terminal.width // width, terminal.height // height))


class RunClock(View):
    """Time since the start; negative in the countdown, the execution time once stopped.

    Textual writes a changed row from the widget's left edge on, so the tenths, ten times as
    quick as the rest, are a widget of their own (`RunTenths`), which stays small.
    """

    def get_content_width(self, container: Size, viewport: Size) -> int:
        return width_of_large(_LARGEST_TIME, clock_size(viewport)) + 1

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = clock_span(snapshot)
        size = clock_size(self.app.size)
        rows = large_text(text[:-2], size)
        if rows is None or len(rows[0]) > width:
            rows = ["", text[:-2], *[""] * (rows_of(size) - 2)]
        return [line(Span(f"{row:>{width}}", tone)) for row in rows]


class RunTenths(View):
    """The point and the tenths beside `RunClock`, at the foot of its digits."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        text, tone = clock_span(snapshot)
        size = clock_size(self.app.size)
        rows = large_text(text[-2:], 1) or ["", text[-2:], ""]
        above = rows_of(size) - len(rows) - (size > 1 and HEIGHT * size % 2 == 0)
        return [*[line("")] * above, *(line(Span(f" {row}", tone)) for row in rows)]


def clock_span(snapshot: Snapshot) -> Span:
    """The clock in ordinary digits; `?` for the tenths of one that may have gone on unseen."""
    if snapshot.elapsed is None:
        return Span("-:--.-", Tone.STRONG)
    if snapshot.pulse.stale and snapshot.run.active:
        return Span(f"{clock_text(snapshot.elapsed)[:-1]}?", Tone.DIM)
    return Span(clock_text(snapshot.elapsed), Tone.WARN if snapshot.elapsed < 0 else Tone.STRONG)


TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.WARN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
}


_LARGE_TEAM = 3
"""From this size of the clock on there is room for the team in large letters."""


class RunStatus(View):
    """Phase or outcome with the time left, who, and in which condition; large if the clock is."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        run, size = snapshot.run, clock_size(self.app.size)
        phase = phase_span(run)
        stands = line(phase, *_on_its_way(snapshot), *_time_left(snapshot))
        who, condition = line(who_text(run)), line(Span(condition_text(run), Tone.DIM))
        if size == 1:
            return [stands, who, condition]
        large = partial(in_large, width=width, size=size // 2)
        team = Span(team_text(run) if size >= _LARGE_TEAM else "", Tone.STRONG)
        return [*large(phase), stands, *large(team), who, condition]


def in_large(span: Span, width: int, size: int) -> list[Line]:
    """A text in the largest letters up to a size that fit; no row if none do."""
    while size and width_of_large(span.text, size) > width:
        size -= 1
    rows = large_text(span.text, size) if size else None
    return [line(Span(row, span.tone)) for row in rows or ()]


def phase_span(run: Run) -> Span:
    if run.outcome is not None:
        return Span(OUTCOMES[run.outcome].partition(":")[0], TONES[run.outcome])
    tone = Tone.GOOD if run.phase is Phase.RUNNING else Tone.STRONG
    return Span(PHASES[run.phase], Tone.WARN if run.phase is Phase.COUNTDOWN else tone)


def team_text(run: Run) -> str:
    return "" if run.setup is None else f"{run.setup.subject} {run.setup.team}".rstrip()


def who_text(run: Run) -> str:
    if run.setup is None:
        return "no run is set up"
    team = f" {run.setup.team}" if run.setup.team else ""
    kind = "practice run" if run.setup.practice else "run"
    return f"{kind} {run.setup.run_number} of subject {run.setup.subject}{team}"


def what_text(run: Run) -> str:
    if run.setup is None:
        return who_text(run)
    condition = run.setup.condition
    what = f"condition {condition.number}: {condition.benchmark_type}, {condition.way}"
    return f"{who_text(run)}, {what}"


def _on_its_way(snapshot: Snapshot) -> Line:
    """What has happened, but is not on disk yet."""
    return line(Span("  NOT ON DISK YET", Tone.WARN)) if snapshot.pulse.unsaved else ()


def _time_left(snapshot: Snapshot) -> Line:
    run, pulse = snapshot.run, snapshot.pulse
    if pulse.stale and run.active:
        age = max(pulse.server, pulse.core)
        return line(Span(f"  as it was {age} s ago" if age else "  as it was", Tone.WARN))
    if run.outcome is not None:
        ended = run.outcome_reason if snapshot.result is None else snapshot.result.ended
        return line(f"  {ended}")
    if snapshot.remaining is None:
        return ()
    if run.phase is Phase.COUNTDOWN:
        return line(f"  starts in {minutes_text(snapshot.remaining)}")
    of = f" of {minutes_text(run.setup.timeout)}" if run.setup else ""
    return line(f"  {minutes_text(snapshot.remaining)} left{of}")


def condition_text(run: Run) -> str:
    if run.setup is None:
        return ""
    condition = run.setup.condition
    return f"condition {condition.number}: {condition.way}, {condition.benchmark_type}"


# The six steps: what the sensors say, what the referee says, what counts.


_NARROW = 50
"""Cells without the column of reasons; with fewer, only what counts is shown."""

_COMPACT = 34
"""Cells of what counts with `ref` behind it; with fewer, an `R` stands before the step."""

_LEAST_ROOM = 14
"""Cells that a column of reasons needs."""


class StepTable(View):
    """The steps as they stand, or as they are in the result."""

    def __init__(self, *, of_result: bool = False) -> None:
        super().__init__()
        self._of_result = of_result

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        result = snapshot.result
        if not self._of_result:
            return step_lines(snapshot.steps, snapshot.run.start, width, settled=result is not None)
        return [] if result is None else result_step_lines(result.steps, result.start, width)


def step_lines(
    steps: Sequence[StepRecord], start: float | None, width: int, *, settled: bool = True
) -> list[Line]:
    """The table of a run that goes on, times in s since `start` (s since the epoch).

    With room, a column says why a step is not done. `settled`: no time can change any more;
    else those that can are rough and marked.
    """
    room = _room(width)
    pending = next((record.step for record in steps if not record.done), None)
    rows = [_head(width, "counts" if settled else "so far", why=bool(room))]
    for record in steps:
        rough = not settled and record.step in UNSETTLED
        row = _row(record, start, width, is_next=record.step is pending, rough=rough)
        why = Span(f"  {fitted(record.reason or '', room)}", Tone.DIM)
        rows.append(line(*row, why if room else ""))
    return rows


def result_step_lines(steps: Sequence[StepRecord], start: float, width: int) -> list[Line]:
    """The table of a result; why a step is not done stands beside it, without room below it."""
    room = _room(width)
    rows = [_head(width, "counts", why=bool(room))]
    for record in steps:
        row, why = _row(record, start, width, is_next=False, rough=False), record.why_not
        if room:
            rows.append(line(*row, Span(f"  {fitted(why, room)}", Tone.DIM)))
        else:
            below = paragraph(why, width, Tone.DIM, head=line(" " * 4)) if why else []
            rows += [row, *below]
    return rows


def _room(width: int) -> int:
    """Cells for reasons in a column; 0 for too few."""
    room = width - _NARROW - 2
    return room if room >= _LEAST_ROOM else 0


def _head(width: int, last: str, *, why: bool) -> Line:
    if width < _NARROW:
        text = f"    {'step':<19}{last:>7}"
    else:
        text = f"    {'step':<19} {'sensors':>7}  {'referee':<9} {last:>7}"
    return line(Span(fitted(text + ("  why not" if why else ""), width), Tone.DIM))


def _row(
    record: StepRecord, start: float | None, width: int, *, is_next: bool, rough: bool
) -> Line:
    if width < _NARROW:
        return _compact(record, start, width, is_next=is_next, rough=rough)
    ruling = record.referee
    said = "-" if ruling is None else "confirmed" if ruling.confirmed else "denied"
    mark = "x" if said == "denied" else ">" if is_next else " "
    tone = Tone.STRONG if is_next else Tone.DIM
    if record.done:
        mark, tone = "✓", Tone.PLAIN
    return line(
        Span(f"{mark} ", Tone.GOOD if record.done else Tone.BAD if mark == "x" else Tone.STRONG),
        Span(f"{record.step} {record.step.text:<19} ", tone),
        Span(f"{step_time(record.sensors, start, rough=rough):>7}  ", tone),
        Span(f"{said:<9} ", Tone.WARN if ruling is not None else Tone.DIM),
        _counts(record, start, rough=rough),
    )


def _compact(
    record: StepRecord, start: float | None, width: int, *, is_next: bool, rough: bool
) -> Line:
    counts = _counts(record, start, rough=rough)
    ruled = record.referee is not None
    roomy = width >= _COMPACT
    return line(
        Span("✓" if record.done else ">" if is_next else " ", counts.tone),
        Span("R" if ruled and not roomy else " ", Tone.WARN),
        f"{record.step} {record.step.text:<19}",
        counts,
        Span(" ref" if ruled and roomy else "", Tone.WARN),
    )


def _counts(record: StepRecord, start: float | None, *, rough: bool) -> Span:
    if record.done:
        text = step_time(record.final, start, rough=rough)
        return Span(f"{text:>7}", Tone.PLAIN if rough else Tone.GOOD)
    return Span(f"{'no':>7}", Tone.DIM)


def step_time(at: float | None, start: float | None, *, rough: bool) -> str:
    """A time of a step, s since the start; one that may still change is rough and marked."""
    if rough and at is not None and start is not None:
        return rough_text(at - start)
    return relative_text(at, start)


# Marks of a run: doubts, decisions, incidents, waivers, notes, files.


class RunMarks(View):
    """One row each, by kind, the newest first; then the folder (y copies it whole)."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures = 0

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.result is None:
            return ()
        doubts = (
            ("doubt", f"{words} ({', '.join(name.words for name in on)})")
            for words, on in snapshot.result.doubts.items()
        )
        rows = [*doubts, *run_marks(snapshot.run)] or [("marks", "none")]
        lines = [text for name, words in rows for text in _entry(name, words, width)]
        lines += _path("files", snapshot.folder or "not known", width)
        if self.pictures and snapshot.folder:
            kind = f"{self.pictures} pictures"
            lines += _path(kind, f"{snapshot.folder}/{PICTURES_FOLDER}", width)
        return lines


def run_marks(run: Run) -> Iterator[tuple[str, str]]:
    """Kind and words of every mark, the newest of a kind first; times in s since the start."""
    for false_start in reversed(run.false_starts):
        what, decided = false_start.event.words, false_start.accepted or "UNDECIDED"
        yield "false start", f"{_at(false_start.time, run)}{what} ({decided})"
    yield from _protests(run)
    yield from _decisions(run)
    for incident in reversed(run.incidents):
        more = f": {incident.note}" if incident.note else ""
        gone = "" if incident.withdrawn is None else f" WITHDRAWN: {incident.withdrawn}"
        yield "incident", f"{_at(incident.time, run)}{incident.kind}{more}{gone}"
    for fault in reversed(run.faults):
        yield "testbed fault", f"{_at(fault.time, run)}{fault.text}"
    for waiver in run.waivers:
        yield "waiver", f"{waiver.check}: {waiver.reason}"
    for note in reversed(run.notes):
        yield "note", f"{_at(note.time, run)}{note.text}"
    for removed in reversed(run.removed_evidence):
        yield "evidence removed", f"{date_of(removed.time)}: {removed.words}"


def _protests(run: Run) -> Iterator[tuple[str, str]]:
    for one in reversed(run.protests):
        at = "" if one.at is None else f" {_at(one.at, run)}".rstrip()
        late = f"; late, admitted: {one.late}" if one.late else ""
        yield f"protest {one.number}", f"{one.team}, about {one.about}{at}: {one.text}{late}"
        if (answer := one.answer) is not None:
            came = f"; {one.late_decision}" if one.late_decision else ""
            yield "  decision", f"{answer.end}: {answer.reason} ({answer.referee}){came}"


def _decisions(run: Run) -> Iterator[tuple[str, str]]:
    for one in reversed(run.reissues):
        by = f" ({one.referee})" if one.referee else ""
        yield f"issue {one.issue}", f"{date_of(one.time)}, {one.what}: {one.reason}{by}"
    if run.voided is not None:
        yield "void", f"{_at(run.voided.time, run)}{run.voided.reason}"
    for change in reversed(run.corrections):
        yield "correction", f"{_at(change.time, run)}{change.words}: {change.reason}"
    for accepted in reversed(run.accepted_doubts):
        words = f"{doubted_words(accepted.doubts)}: {accepted.reason}"
        yield "doubt accepted", f"{_at(accepted.time, run)}{words}"
    for back in reversed(run.taken_back):
        yield "taken back", f"{_at(back.time, run)}{back.words}: {back.reason}"
    for ruling in reversed(run.rulings):
        word = RULED[ruling.confirmed]
        yield "ruling", f"{_at(ruling.time, run)}step {ruling.step} {word}: {ruling.reason}"


def _path(name: str, path: str, width: int) -> list[Line]:
    head = f"{name:<18}"
    if cell_len(head) + cell_len(path) > width:
        head = f"{name} "
    return [line(Span(head, Tone.DIM), Span(cut_inside(path, width - len(head)), Tone.STRONG))]


def _at(time: float, run: Run) -> str:
    return "" if run.start is None else f"{time - run.start:+.2f} s "


def _entry(name: str, words: str, width: int, tone: Tone = Tone.PLAIN) -> list[Line]:
    return paragraph(words, width, tone, head=(Span(f"{name:<18}", Tone.DIM),))


# Flags on the screens: signs, tones, lines.


FLAG_TONES = {
    FlagWeight.REMARK: Tone.DIM,
    FlagWeight.CAUTION: Tone.WARN,
    FlagWeight.ALARM: Tone.BAD,
}
_SIGNS = {None: "", FlagWeight.REMARK: "", FlagWeight.CAUTION: "!", FlagWeight.ALARM: "!!"}
_BETWEEN = Span("; ", Tone.DIM)


def flag_sign(found: Iterable[Flag]) -> str:
    """The most serious flag in two cells, `!!` with one undecided; empty if none weighs."""
    flags = tuple(found)
    return _SIGNS[FlagWeight.ALARM if undecided(flags) else worst(flags)]


def flag_lines(
    found: Sequence[Flag], width: int, hints: Mapping[str, str] | None = None
) -> list[Line]:
    """All words of some flags, each in its tone; `hints`: what the referee can do, by flag kind."""
    rows: list[list[Span]] = []
    for flag in found:
        how = (hints or {}).get(flag.kind) if flag.undecided else None
        text = flag.words + (f": {how}" if how else "")
        tone = FLAG_TONES[flag.weight]
        for number, part in enumerate(wrapped(text, width)):
            span = Span(part, tone)
            room = width - width_of((*rows[-1], _BETWEEN)) if rows else 0
            if number == 0 and rows and width_of((span,)) <= room:
                rows[-1] += [_BETWEEN, span]
            else:
                rows.append([span])
    return [tuple(row) for row in rows]
