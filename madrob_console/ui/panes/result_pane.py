"""The results pane: the outcome and what must be decided first, details below."""

from __future__ import annotations

from asyncio import to_thread
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar

from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Container, VerticalScroll

from madrob_console.archive.history import earlier_runs
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import date_of
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.flags import FlagKind, serious, undecided
from madrob_console.referee.run import Phase
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
from madrob_console.ui.panes.result_details import IndicatorTable, ResultDetails
from madrob_console.ui.panes.run_status import FLAG_TONES, StepTable, packed, phase_span, what_text
from scoring.indicator_table import RulesetName
from scoring.protocol import Condition
from scoring.result import Result

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
