"""The indicators of a result, and its details: comparison, marks, files, data quality."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import itemgetter

from madrob_console.common.formatting import date_of
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.tally import Aggregate, aggregate_of
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import common_reason, data_remarks, doubted_words
from madrob_console.referee.protests import Protest
from madrob_console.referee.records import Incident
from madrob_console.referee.run import Run
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from scoring.indicator_table import IndicatorName
from scoring.result import (
    Indicator,
    Result,
    Uncertainty,
    difference_text,
    distinguishable,
    uncertainty_text,
    value_text,
)

_NAME = 28
_VALUE = 10


class IndicatorTable(View):
    """One row for each indicator."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        indicators = {} if snapshot.result is None else snapshot.result.indicators
        if reason := common_reason(indicators):
            head = line(Span(f"{'values':<{_KIND}}", Tone.STRONG))
            return paragraph(f"none: {reason}", width, Tone.WARN, head)
        by_hand = snapshot.run.answered_at is None
        return [
            row
            for name, indicator in indicators.items()
            for row in _rows(name, indicator, width, by_hand)
        ]


def _rows(name: IndicatorName, indicator: Indicator, width: int, by_hand: bool) -> list[Line]:
    started = " (hand start)" if by_hand and name.spec.with_the_start else ""
    head = Span(f"{name.words + started:<{_NAME}}")
    if indicator.value is None:
        return paragraph(indicator.text, width, Tone.WARN, line(head, " "))
    value = value_text(indicator.value, indicator.uncertainty)
    behind = " ".join(filter(None, (uncertainty_text(indicator.uncertainty), indicator.unit)))
    row = line(
        head,
        Span(f"{value:>{_VALUE}}", Tone.STRONG),
        Span(indicator.sign or " ", Tone.WARN),
        Span(f" {behind}", Tone.DIM),
    )
    return [row]


_KIND = 18
_LONG = 900.0
"""From so many s on a mark has a date."""


class ResultDetails(View):
    """`earlier` are the team's completed runs in the same condition."""

    earlier: Sequence[RunSummary] = ()

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.result is None:
            return ()
        words = mark_words(snapshot.run, snapshot.result)
        words.append(("files", snapshot.folder or "not known"))
        return [
            *comparison(snapshot.result, snapshot.run, self.earlier),
            line(),
            *(row for kind, text in words for row in _entry(kind, text, width)),
            line(),
            *recorded_lines(snapshot.result, snapshot.run, width),
        ]


def _entry(kind: str, text: str, width: int, tone: Tone = Tone.PLAIN) -> list[Line]:
    return paragraph(text, width, tone, head=line(Span(f"{kind:<{_KIND}}", Tone.DIM)))


def comparison(result: Result, run: Run, earlier: Sequence[RunSummary]) -> Iterator[Line]:
    """A row for each indicator with a value here and in an earlier run."""
    head = Span(f"{'comparison':<{_KIND}}", Tone.STRONG)
    if not run.comparable or not earlier:
        why = "no earlier completed run" if run.comparable else "only completed runs that count"
        yield line(head, Span(f"none: {why}", Tone.DIM))
        return
    count = len(earlier)
    yield line(head, Span(f"mean of {count} earlier, difference to it", Tone.DIM))
    for name, indicator in result.indicators.items():
        mean = aggregate_of(earlier, name)
        if indicator.value is not None and mean is not None:
            yield compared(name, indicator.value, indicator.uncertainty, mean, count)


def compared(
    name: IndicatorName,
    value: float,
    uncertainty: Uncertainty | None,
    earlier: Aggregate,
    count: int,
) -> Line:
    """The mean, the difference to it, whether that is better.

    The mean says of how many runs it is, if not all of the `count` have a value. A difference
    within the uncertainties is neither better nor worse (protocol section 11).
    """
    difference = value - earlier.mean
    better = (difference > 0) is name.spec.higher_is_better
    word, tone = ("better", Tone.GOOD) if better else ("worse", Tone.WARN)
    if not distinguishable(value, earlier.mean, uncertainty, earlier.uncertainty):
        word, tone = "within +-", Tone.PLAIN
    elif difference == 0:
        word, tone = "equal", Tone.PLAIN
    spreads = () if uncertainty is None else (uncertainty, earlier.uncertainty)
    text = difference_text(difference, spreads, 4)
    mean = value_text(earlier.mean, earlier.uncertainty)
    of = "" if earlier.count == count else f" of {earlier.count}"
    return line(
        f"{name.words:<{_NAME}}",
        Span(f"{mean:>{_VALUE}}{of:<6}", Tone.DIM),
        Span(f"{text:>{_VALUE}} {word}", tone),
    )


def mark_words(run: Run, result: Result) -> list[tuple[str, str]]:
    """Kind and words of the ruleset, of each doubt and of each mark, the newest mark first."""
    marks = [
        *((w.time, "waiver", f"{w.check}: {w.reason}") for w in run.waivers),
        *(
            (start.time, "false start", f"{start.event.words} ({start.accepted or 'UNDECIDED'})")
            for start in run.false_starts
        ),
        *((fault.time, "testbed fault", fault.text) for fault in run.faults),
        *((incident.time, "incident", _incident(incident)) for incident in run.incidents),
        *((note.time, "note", note.text) for note in run.notes),
        *(
            (
                ruling.time,
                "ruling",
                f"step {ruling.step} {RULED[ruling.confirmed]}: {ruling.reason}",
            )
            for ruling in run.rulings
        ),
        *((back.time, "taken back", f"{back.words}: {back.reason}") for back in run.taken_back),
        *(
            (
                acceptance.time,
                "doubt accepted",
                f"{doubted_words(acceptance.doubts)}: {acceptance.reason}",
            )
            for acceptance in run.accepted_doubts
        ),
        *(
            (correction.time, "correction", f"{correction.words}: {correction.reason}")
            for correction in run.corrections
        ),
        *((void.time, "void", void.reason) for void in (run.voided,) if void is not None),
        *(
            (protest.time, f"protest {protest.number}", _protest(protest, run))
            for protest in run.protests
        ),
        *(
            (
                reissue.time,
                f"version {reissue.issue}",
                f"{reissue.what}: {reissue.reason} ({reissue.referee})",
            )
            for reissue in run.reissues
        ),
    ]
    doubts = (
        ("doubt", f"{words} ({', '.join(name.words for name in on)})")
        for words, on in result.doubts.items()
    )
    newest_first = sorted(marks, key=itemgetter(0))[::-1]
    said = ((kind, f"{_at(at - result.start, at)} {words}") for at, kind, words in newest_first)
    return [("ruleset", result.ruleset), *doubts, *said]


def _at(since_start: float, epoch: float) -> str:
    return f"{since_start:+.2f} s" if abs(since_start) < _LONG else date_of(epoch)


def _incident(incident: Incident) -> str:
    return ": ".join(filter(None, (incident.kind, incident.note)))


def _protest(protest: Protest, run: Run) -> str:
    words = f"{protest.team}, about {protest.about_words(run.start)}: {protest.text}"
    if (answer := protest.answer) is None:
        return words
    return f"{words}; {answer.end}: {answer.reason} ({answer.referee})"


def recorded_lines(result: Result, run: Run, width: int) -> Iterator[Line]:
    """Remarks on the data, and the evidence recorded beside them."""
    for text in data_remarks(result.quality):
        yield from paragraph(text, width, Tone.WARN)
    if (evidence := run.evidence) is None:
        return
    yield from _entry("evidence", evidence.words, width, Tone.PLAIN)
    for text in evidence.remarks(run.start):
        yield from paragraph(text, width, Tone.DIM)
