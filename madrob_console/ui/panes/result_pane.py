"""The results pane: outcome, values and steps first, details below them."""

from __future__ import annotations

from asyncio import to_thread
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import ClassVar

from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Container, VerticalScroll

from madrob_console.archive.history import earlier_runs
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import date_of
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.tally import Aggregate, aggregate_of
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import (
    FlagKind,
    common_reason,
    doubted_words,
    other_remarks,
    serious,
    undecided,
)
from madrob_console.referee.protests import Protest
from madrob_console.referee.records import Incident
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.lines import (
    NAMED_KEYS,
    Line,
    Span,
    Tone,
    Unmarked,
    View,
    line,
    paragraph,
    plain,
    with_keys,
)
from madrob_console.ui.look.words import OUTCOMES
from madrob_console.ui.panes.run_status import FLAG_TONES, StepTable, packed, phase_span, what_text
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition
from scoring.result import (
    Indicator,
    Result,
    Uncertainty,
    difference_text,
    distinguishable,
    uncertainty_text,
    value_text,
)
from scoring.rulesets import RulesetName

# The head of a result: outcome, what must be decided, who ran, final or not.


_UNSAVED = "NOT ON DISK YET: only the engine has it, and goes on trying"


class ResultHead(View):
    """Outcome, what must be decided and what changed the score, run, state.

    `more`: there are details below what is in view.
    """

    more = False

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        result, run, heavy = snapshot.result, snapshot.run, serious(snapshot.flags)
        if result is None:
            return [line(_no_result(snapshot))]
        word, tone = phase_span(run, result)
        if heavy and tone is not Tone.BAD:
            tone = FLAG_TONES[heavy[0].weight]
        said = f"{word}, {'VOID' if run.voided else 'valid'}"
        if not (run.valid or run.voided):
            said = OUTCOMES[result.outcome]
        notices = (flag.words for flag in snapshot.flags if flag.kind is FlagKind.PRACTICE)
        headline = [
            Span(f"{said} ({result.ended})", tone),
            *(Span(f" {words} ", Tone.NOTICE) for words in notices),
        ]
        return [
            *packed(headline, width, "  "),
            *packed(_flags(snapshot), width),
            *paragraph(what_text(run), width),
            *_state(snapshot, result, width, ". v: details" * self.more),
        ]


def _no_result(snapshot: Snapshot) -> str:
    if snapshot.playback is not None:
        return "The result comes at the end of the recording."
    if snapshot.rescoring:
        return "The result is being scored again: the one that was here is out of date."
    if snapshot.run.phase is Phase.STOPPED:
        return "The result is being written."
    return "No result yet: it appears here by itself when a run has stopped."


def _flags(snapshot: Snapshot) -> Iterator[Span]:
    """The flags that weigh."""
    for flag in serious(snapshot.flags):
        yield Span(flag.words, FLAG_TONES[flag.weight])


def _state(snapshot: Snapshot, result: Result, width: int, more: str) -> list[Line]:
    run, playback = snapshot.run, snapshot.playback
    other_rules = result.ruleset != RulesetName.PROTOCOL
    version = f"version {run.issue}" + (f" by ruleset {result.ruleset}" if other_rules else "")
    if (closure := run.closure) is not None:
        note = f" ({closure.note})" if closure.note else ""
        text = f"{version}, signed by {closure.referee}, {closure.team_word.words}{note}"
        tone = Tone.GOOD
        if undecided(snapshot.flags):
            text, tone = f"{text}, with open questions", Tone.WARN
    else:
        text, tone = f"{version}, not final" if run.valid else version, Tone.WARN
    if todo := _what_to_do(snapshot):
        text += f". {todo}"
    named = NAMED_KEYS | {"v: details": "v", "x is": "x"}
    lines = with_keys(paragraph(f"{text}{more}", width, tone), named)
    if snapshot.pulse.unsaved:
        lines = [*paragraph(_UNSAVED, width, Tone.BAD), *lines]
    if playback is not None:
        lines += paragraph(playback.comparison, width, Tone.DIM if playback.agrees else Tone.BAD)
    if snapshot.opened:
        day = date_of(result.start)
        lines.append(line(Span(f"an earlier run, started {day}", Tone.DIM)))
    return lines


def _what_to_do(snapshot: Snapshot) -> str:
    """The key that goes on with a result that is not final; empty where nobody may."""
    silent = snapshot.playback is not None or snapshot.right.only_watches
    if silent or snapshot.pulse.unsaved or snapshot.run.phase is not Phase.STOPPED:
        return ""
    if undecided(snapshot.flags):
        return "Enter decides"
    return "Enter: what next" if snapshot.run.valid else "x is the next run"


# The indicators: a value with its uncertainty and its unit, or the reason why there is none.


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


# Details: comparison with earlier runs, marks, files, data quality.


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
        *((gone.time, "evidence removed", gone.words) for gone in run.removed_evidence),
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
    """What is odd about the data; what was recorded beside them."""
    for text in other_remarks(run, result.quality):
        yield from paragraph(text, width, Tone.WARN)
    if (evidence := run.evidence) is None:
        return
    gone = run.evidence_removed(date_of)
    words = f"{evidence.words}{f'; {gone}' if gone else ''}"
    yield from _entry("evidence", words, width, Tone.WARN if gone else Tone.PLAIN)
    for text in evidence.remarks():
        yield from paragraph(text, width, Tone.DIM)


# The pane.


_BESIDE = 114
"""Cells of indicators and steps side by side, with what is between them."""


_COPIED = 100
"""Columns of the result as text."""

_Shown = tuple[float, int, int, Condition]
"""Start and issue of a result, and as which subject and condition it counts."""


class ResultsPane(VerticalScroll, Unmarked):
    """Outcome, values, steps; details below them. `load` may take a moment."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("v", "turn", "Details", show=False)]

    def __init__(self, load: Callable[[], Sequence[RunSummary]]) -> None:
        self._details = ResultDetails()
        self._head, tables = ResultHead(), (IndicatorTable(), StepTable())
        columns = Container(*tables, classes="columns")
        super().__init__(self._head, columns, self._details, id="results")
        self._views = (self._head, *tables, self._details)
        self._load = load
        self._shown: _Shown | None = None

    def action_turn(self) -> None:
        """Shows the details, and again what was above them."""
        if self.scroll_y:
            self.scroll_home(animate=False)
        else:
            self.scroll_to_widget(self._details, top=True, animate=False)

    def watch_show_vertical_scrollbar(self, scrolls: bool) -> None:
        """Names the key of the details where they are not in view."""
        self._head.more = scrolls
        self._head.redraw()

    def on_resize(self, _event: events.Resize) -> None:
        """Side by side only if both tables are whole."""
        self.set_class(self.scrollable_content_region.width >= _BESIDE, "-beside")

    def enter(self) -> None:
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        result, run, setup = snapshot.result, snapshot.run, snapshot.run.setup
        shown = None
        if result is not None and setup is not None:
            shown = (result.start, run.issue, setup.subject, setup.condition)
        if shown != self._shown:
            self._shown = shown
            self._details.earlier = ()
            self.scroll_home(animate=False)
            if result is not None and setup is not None and snapshot.playback is None:
                self._compare(result, setup, snapshot.practice)
        for view in self._views:
            view.show(snapshot)

    @property
    def copied(self) -> str:
        return "\n\n".join(filter(None, (plain(view.lines(_COPIED)) for view in self._views)))

    @work(exclusive=True)
    async def _compare(self, result: Result, setup: RunSetup, practice: bool) -> None:
        """Looks up the team's earlier runs in the same condition, off the loop."""
        shown = self._shown
        try:
            runs = await to_thread(
                lambda: earlier_runs(
                    self._load(),
                    setup.subject,
                    setup.condition.number,
                    result.start,
                    competition=setup.competition,
                    practice=practice,
                    ruleset=result.ruleset,
                )
            )
        except (MadrobError, OSError, MemoryError):
            return  # the history says what is wrong with the folder
        if shown == self._shown:
            self._details.earlier = runs
            self._details.redraw()
