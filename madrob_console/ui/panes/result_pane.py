"""The results pane: what the run scored, and how good its data are."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from textual import events
from textual.app import ComposeResult
from textual.containers import Container, VerticalScroll

from madrob_console.archive.folders import PICTURES_FOLDER, pictures_in
from madrob_console.archive.history import earlier_runs
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.pages.tally import aggregate_of
from madrob_console.referee.acts.after import DECIDED_BY
from madrob_console.referee.flags import FlagKind, FlagWeight, common_reason, undecided, worst
from madrob_console.referee.records import format_due, open_protests
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import (
    Line,
    Span,
    Tone,
    Unmarked,
    View,
    line,
    paragraph,
    plain,
    width_of,
)
from madrob_console.ui.look.words import OUTCOMES, date_of, fitted
from madrob_console.ui.panes.run_status import (
    FLAG_TONES,
    TONES,
    RunMarks,
    StepTable,
    flag_lines,
    what_text,
)
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition
from scoring.result import DOUBTED, difference_text, distinguishable, uncertainty_text, value_text

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.pages.tally import Aggregate
    from madrob_console.referee.records import RunSetup
    from scoring.quality import SignalQuality
    from scoring.result import Indicator, Result

# How good the data are: a row per signal, then remarks.


_NAMES = ("samples", "Hz", "gap", "gaps", "jitter", "skew", "drop", "shift", "none")
_WIDTHS = (8, 6, 8, 5, 7, 7, 5, 6, 5)


class QualityTable(View):
    """Rates, gaps, jitter, skew, dropped and shifted stamps."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.result is None:
            return ()
        quality = snapshot.result.quality
        told = snapshot.run.remarks()  # they stand among the marks
        return [
            line(
                Span("data quality", Tone.STRONG),
                Span("  largest gap, jitter and skew in ms", Tone.DIM),
            ),
            line(Span(" " * 17 + _aligned(_NAMES), Tone.DIM)),
            *map(_row, quality.signals),
            *(
                row
                for text in quality.remarks
                if text not in told
                for row in paragraph(text, width, Tone.WARN)
            ),
            *_evidence(snapshot, width),
        ]


def _evidence(snapshot: Snapshot, width: int) -> Sequence[Line]:
    """What was recorded beside the testbed's topics; nothing is scored from it."""
    evidence = snapshot.run.evidence
    if evidence is None:
        return ()
    gone = snapshot.run.evidence_removed(date_of)
    words = f"{evidence.words}{f'; {gone}' if gone else ''}"
    head = (Span("evidence ", Tone.STRONG),)
    return [
        *paragraph(words, width, Tone.WARN if gone else Tone.PLAIN, head),
        *(row for text in evidence.remarks() for row in paragraph(text, width, Tone.DIM)),
    ]


def _row(q: SignalQuality) -> Line:
    poor = q.gaps or q.dropped or q.shifted or not q.samples
    tone = Tone.WARN if poor else Tone.PLAIN
    return line(f"{q.signal.value:<17}", Span(_aligned(q.cells()), tone))


def _aligned(cells: Sequence[str]) -> str:
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))


# The head of a result: outcome, team, rules, final or not.


_UNSAVED = "NOT ON DISK YET: only the engine has it, and goes on trying"


class ResultHead(View):
    """Outcome, validity, open questions, run, state; three rows, more for flags and long words."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        result = snapshot.result
        if result is None:
            return [line(_no_result(snapshot))]
        # the notice beside the outcome has that one
        found = [flag for flag in snapshot.flags if flag.kind is not FlagKind.PRACTICE]
        heaviest = worst(found) or FlagWeight.REMARK
        tone = TONES[result.outcome]
        if heaviest is not FlagWeight.REMARK and tone is not Tone.BAD:
            tone = FLAG_TONES[heaviest]
        valid = ", valid" if snapshot.run.valid else ", VOID" if snapshot.run.voided else ""
        outcome = f"{OUTCOMES[result.outcome]}{valid} ({result.ended})"
        acts = snapshot.run.phase is Phase.STOPPED and not _silent(snapshot)
        return [
            *_marked(paragraph(outcome, width, tone), snapshot, width),
            *flag_lines(found, width, DECIDED_BY if acts else None),
            *paragraph(what_text(snapshot.run), width),
            *_deadlines(snapshot, width),
            *_state(snapshot, result, width),
        ]


def _marked(lines: list[Line], snapshot: Snapshot, width: int) -> list[Line]:
    source = snapshot.result_source
    if source is None or (source is SourceKind.ROS and not snapshot.practice):
        return lines
    kind = "practice" if source is SourceKind.ROS else source
    notice = line(Span(f" {kind.upper()}: not an official result ", Tone.NOTICE))
    if width_of(lines[-1]) + 2 + width_of(notice) > width:
        return [*lines, notice]
    return [*lines[:-1], line(*lines[-1], "  ", *notice)]


def _silent(snapshot: Snapshot) -> bool:
    return snapshot.playback is not None or snapshot.right.only_watches


def _no_result(snapshot: Snapshot) -> str:
    if snapshot.playback is not None:
        return "The result comes at the end of the recording."
    if snapshot.rescoring:
        return "The result is being scored again: the one that was here is out of date."
    if snapshot.run.phase is Phase.STOPPED:
        return "The result is being written."
    return "No result yet: it appears here by itself when a run has stopped."


def _deadlines(snapshot: Snapshot, width: int) -> list[Line]:
    if snapshot.playback is not None:  # what was to be done then is over
        return []
    lines: list[Line] = []
    for one in open_protests(snapshot.run.protests):
        left = format_due(one.due, snapshot.time)
        by = time.strftime("%H:%M", time.localtime(one.due))
        text = f"protest {one.number} of {one.team}, decision due {by}, {left}"
        lines += paragraph(text, width, Tone.BAD if one.due < snapshot.time else Tone.WARN)
    return lines


def _state(snapshot: Snapshot, result: Result, width: int) -> list[Line]:
    run = snapshot.run
    issue = f"ruleset {result.ruleset}, issue {run.issue}"
    if run.closure is None:
        then = "" if _silent(snapshot) or snapshot.pulse.unsaved else ": f finalises it"
        text, tone = f"{issue}, not final yet{then}", Tone.WARN
    else:
        closure = run.closure
        note = f" ({closure.note})" if closure.note else ""
        text = f"{issue}, final: {closure.team_word} by the team{note}, signed {closure.referee}"
        tone = Tone.GOOD
        if undecided(snapshot.flags):
            text, tone = f"{text} with what is undecided", Tone.WARN
    lines = paragraph(text, width, tone)
    if snapshot.pulse.unsaved:
        lines = [*paragraph(_UNSAVED, width, Tone.BAD), *lines]
    if (playback := snapshot.playback) is not None:
        tone = Tone.DIM if playback.agrees else Tone.BAD
        lines += paragraph(playback.comparison, width, tone)
    if snapshot.opened:
        day = date_of(result.start)
        lines.append(line(Span(f"an earlier run, started {day}", Tone.DIM)))
    return lines


# The indicators: a value with its uncertainty and its unit, or the reason why there is none.


_NAME = 28
_SHORT_NAME = 21
_VALUE = 10
_SHORT_VALUE = 8
_SPREAD = 11
"""Cells of an uncertainty with the gaps around it."""
_ROOMY = 75
_WITH_WORDS = 62
"""Cells with which a difference says whether it is better."""
_IN_POWERS = 1e3
"""A larger difference has no room otherwise."""

ALIKE = "="
"""A difference within the uncertainty."""


class _Room(NamedTuple):
    """Cells: of a row, of a name, of a value, of an uncertainty; with names and numbers short."""

    row: int
    name: int
    value: int
    spread: int

    @property
    def compared(self) -> int:
        """As many as a row without uncertainties would have: what is compared does not shrink."""
        used = self.name + self.value + self.spread
        return self.row - used + _NAME + _VALUE


class IndicatorTable(View):
    """One row for each indicator; `earlier` are the team's completed runs in the same condition."""

    earlier: Sequence[RunSummary] = ()

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.result is None:
            return ()
        found = snapshot.result.indicators
        if reason := common_reason(found):
            begin = line(Span("indicators  ", Tone.STRONG))
            return [
                *paragraph(f"none: {reason}", width, Tone.WARN, begin),
                *_drift(snapshot.result, snapshot.handle.touch_force),
            ]
        roomy = width >= _ROOMY
        comparable = snapshot.run.comparable
        earlier = self.earlier if comparable else ()
        count = len(earlier)
        against = f"against mean of {count} earlier" if count else "no earlier run to compare"
        if not comparable:
            against = "compared with no other run"
        delay = "* with the manual start's delay"
        head = fitted(f"indicators  {delay}", _NAME + 18) if roomy else fitted("indicators", _NAME)
        lines = [line(Span(head[:12], Tone.STRONG), Span(f"{head[12:]}{against}", Tone.DIM))]
        room = _room(found.values(), width)
        signs = set()
        for name, indicator in found.items():
            rows, alike = _rows(name, indicator, aggregate_of(earlier, name), count, room)
            lines += rows
            if name is IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION:
                lines += _drift(snapshot.result, snapshot.handle.touch_force)
            signs |= {ALIKE} if alike else set()
            signs |= {DOUBTED} if indicator.doubts else set()
        told = ([] if roomy else [delay]) + [text for sign, text in _LEGEND if sign in signs]
        return [*lines, *(row for text in told for row in paragraph(text, width, Tone.DIM))]


_LEGEND = (
    (DOUBTED, f"{DOUBTED} doubted, see below"),
    (ALIKE, f"{ALIKE} differs by less than the uncertainties: not distinguishable"),
)


def _room(found: Iterable[Indicator], width: int) -> _Room:
    spread = _SPREAD if any(uncertainty_text(one.uncertainty) for one in found) else 0
    if not spread or width >= _ROOMY + spread:
        return _Room(width, _NAME, _VALUE, spread)
    return _Room(width, _SHORT_NAME, _SHORT_VALUE, spread)


def _rows(
    name: IndicatorName, indicator: Indicator, earlier: Aggregate | None, count: int, room: _Room
) -> tuple[list[Line], bool]:
    """The rows of an indicator, and whether it differs from the mean by no more than is known."""
    words = name.words if room.name == _NAME else name.words.partition(" of ")[0]
    title = words + (" *" if name.spec.with_the_start else "")
    head = line(f"{title:<{room.name}}")
    if indicator.value is None:
        return paragraph(indicator.text, room.row, Tone.WARN, line(*head, " ")), False
    value = value_text(indicator.value, indicator.uncertainty)
    spread = uncertainty_text(indicator.uncertainty)
    behind = compared(name, indicator, earlier, count, room.compared)
    row = line(
        *head,
        Span(f"{value:>{room.value}}", Tone.STRONG),
        Span(indicator.sign or " ", Tone.WARN),
        Span(f"{f' {spread}'[: room.spread]:<{room.spread}}{indicator.unit:<7}", Tone.DIM),
        *behind,
    )
    return [row], any(span.text.strip() == ALIKE for span in behind)


def _drift(result: Result, touch_force: float) -> list[Line]:
    """How far the handle came to rest from its zero, if too far (protocol section 11)."""
    rest = result.rest
    if rest is None or rest.drift is None or not rest.drifted(touch_force):
        return []
    head = line(Span(f"{'  at rest after, from zero':<{_NAME}}", Tone.WARN))
    return [line(*head, Span(f"{rest.drift:>+10.2f} N", Tone.WARN))]


def compared(
    name: IndicatorName, indicator: Indicator, earlier: Aggregate | None, count: int, width: int
) -> Line:
    """The difference to the mean, and whether it is better; with room, the mean.

    Beside it the number of its runs, if not all of the `count` have a value. A difference
    within the uncertainties is neither better nor worse (protocol section 11).
    """
    if earlier is None or indicator.value is None:
        return ()
    value, known = indicator.value, indicator.uncertainty
    difference = value - earlier.mean
    better = (difference > 0) is name.spec.higher_is_better
    word, tone = ("better", Tone.GOOD) if better else ("worse", Tone.WARN)
    if not distinguishable(value, earlier.mean, known, earlier.uncertainty):
        word, tone = ALIKE, Tone.PLAIN
    elif difference == 0:
        word, tone = "equal", Tone.PLAIN
    spreads = () if known is None else (known, earlier.uncertainty)
    text = difference_text(difference, spreads, 4)
    if abs(difference) >= _IN_POWERS:
        text = f"{difference:+.2e}"
    parts = [Span(f"{text:>{9 if known is None or width >= _WITH_WORDS else 8}}", tone)]
    if width >= _WITH_WORDS:
        parts.append(Span(f" {word:<6}", tone))
    elif word == ALIKE:
        parts.append(Span(f" {word}", tone))
    if width >= _ROOMY:
        of = "" if earlier.count == count else f" ({earlier.count})"
        parts.append(Span(f" {value_text(earlier.mean, earlier.uncertainty)}{of}", Tone.DIM))
    return tuple(parts)


_BESIDE = 114
"""Cells of indicators and steps side by side, with what is between them."""


_LOOKS_EVERY = 3.0  # s
_COPIED = 100
"""Columns of the result as text."""

_Shown = tuple[float | None, int, tuple[int, Condition] | None]
"""Start and issue of a result, and as which subject and condition it counts."""


class ResultsPane(VerticalScroll, Unmarked):
    """Outcome, indicators, capability, marks, files, data quality; `load` may take a moment."""

    def __init__(self, load: Callable[[], Sequence[RunSummary]]) -> None:
        super().__init__(id="results")
        self._load = load
        self._shown: _Shown = (None, 0, None)
        self._indicators = IndicatorTable()
        self._marks = RunMarks()
        self._folder = ""
        self._looking = False
        self._views: tuple[View, ...] = (
            ResultHead(),
            self._indicators,
            StepTable(of_result=True),
            self._marks,
            QualityTable(),
        )

    def compose(self) -> ComposeResult:
        head, indicators, steps, marks, quality = self._views
        yield head
        yield Container(indicators, steps, classes="columns")
        yield marks
        yield quality

    def on_mount(self) -> None:
        """Looks for pictures later: they come with the report, some time after the result."""
        self.set_interval(_LOOKS_EVERY, self._look_for_pictures)

    @property
    def pictures(self) -> str:
        """The folder with what the cameras saw of the run that is shown; empty = there is none."""
        return f"{self._folder}/{PICTURES_FOLDER}" if self._marks.pictures else ""

    def on_resize(self, _event: events.Resize) -> None:
        """Side by side only if both tables are whole."""
        self.set_class(self.scrollable_content_region.width >= _BESIDE, "-beside")

    def enter(self) -> None:
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        result = snapshot.result
        run, setup = snapshot.run, snapshot.run.setup
        series = None if setup is None else (setup.subject, setup.condition)
        shown = (None if result is None else result.start, run.issue, series)
        if shown != self._shown:
            self._shown = shown
            self.scroll_home(animate=False)
            self._indicators.earlier = ()
            official = snapshot.result is not None and snapshot.playback is None
            if official and setup is not None:
                self._compare(snapshot, setup)
        folder = "" if result is None else snapshot.folder or ""
        if folder != self._folder:
            self._folder, self._marks.pictures = folder, 0
            self._look_for_pictures()
        for view in self._views:
            view.show(snapshot)

    @property
    def copied(self) -> str:
        return "\n\n".join(filter(None, (plain(view.lines(_COPIED)) for view in self._views)))

    def _compare(self, snapshot: Snapshot, setup: RunSetup) -> None:
        """Looks up the team's earlier runs in the same condition, off the loop."""
        result, practice, shown = snapshot.result, snapshot.practice, self._shown
        assert result is not None

        def look_up() -> None:
            try:
                runs = earlier_runs(
                    self._load(),
                    setup.subject,
                    setup.condition.number,
                    result.start,
                    competition=setup.competition,
                    practice=practice,
                    ruleset=result.ruleset,
                )
            except (MadrobError, OSError, MemoryError):
                return  # the history says what is wrong with the folder
            self.call_later(self._show_earlier, shown, runs)

        self.run_worker(look_up, thread=True, exclusive=True)

    def _look_for_pictures(self) -> None:
        """Off the loop: a disk may hang. Then nobody looks again."""
        folder = self._folder
        if not folder or self._looking:
            return
        self._looking = True

        def look() -> None:
            self.call_later(self._show_pictures, folder, pictures_in(folder))

        self.run_worker(look, thread=True, group="pictures")

    def _show_pictures(self, folder: str, count: int) -> None:
        self._looking = False
        if folder == self._folder and count != self._marks.pictures:
            self._marks.pictures = count
            self._marks.redraw()

    def _show_earlier(self, of: _Shown, runs: Sequence[RunSummary]) -> None:
        if of == self._shown:
            self._indicators.earlier = runs
            self._indicators.redraw()
