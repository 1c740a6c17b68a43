"""The history pane, and what it shares with the standings."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, ClassVar, Generic, NamedTuple, TypeVar

from msgspec.structs import replace
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.archive.collection import filter_problem, matches
from madrob_console.archive.history import PROTEST_OPEN, RunSummary, condition_words, time_words
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.referee.flags import FlagKind, undecided, weighty
from madrob_console.ui.cells.dialog import Field
from madrob_console.ui.cells.lines import Label, Span, Tone
from madrob_console.ui.cells.table import Column, Row, Table
from madrob_console.ui.look.words import shortened
from madrob_console.ui.panes.run_status import FLAG_TONES, flag_sign
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import DOUBTED, Uncertainty, value_text

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.pages.tally import Standing

Content = TypeVar("Content")
_Row = TypeVar("_Row", bound="RunSummary | Standing")

Load = Callable[[], Sequence[RunSummary]]
"""Reads all runs; may take a while and may raise `MadrobError`."""


class RunsPane(Vertical, Generic[Content, _Row]):
    """Reads all runs in a thread when it comes into view and whenever a result changes."""

    class Opened(Message):
        """The referee wants to see the run, or the runs, of a row."""

        def __init__(self, row: RunSummary | Standing) -> None:
            super().__init__()
            self.row = row

    def __init__(self, load: Load, table: Table[_Row], *, id: str) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self._load = load
        self.table = table
        self._number = 0
        self._reading = False
        self._seen: object = None
        self.head = Label(id=f"{id}-head")
        self.about = Label(id=f"{id}-about")

    @abstractmethod
    def prepare(self, runs: Sequence[RunSummary]) -> Content:
        """What the pane needs of the runs; done in a thread."""

    @abstractmethod
    def show_content(self, content: Content) -> None:
        """Show what was prepared."""

    @abstractmethod
    def words_about(self, row: _Row) -> tuple[str, Tone]:
        """What does not fit into a row."""

    @property
    def selected(self) -> _Row | None:
        return self.table.selected

    def on_table_marked(self, event: Table.Marked) -> None:
        event.stop()
        row = self.selected
        self.about.say(*("", Tone.DIM) if row is None else self.words_about(row))

    def on_table_chosen(self, event: Table.Chosen) -> None:
        event.stop()
        if self.selected is not None:
            self.post_message(self.Opened(self.selected))

    def enter(self) -> None:
        self.screen.set_focus(self.table)
        self._seen = None
        self.reload()

    def reload(self) -> None:
        """Reads in the background; what was shown stays until then."""
        self._number += 1
        self._reading = True
        self.head.say("reading the results folder ...", Tone.DIM)
        self.run_worker(partial(self._read, self._number), thread=True, exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        run = snapshot.run
        written = snapshot.result is not None
        said = (run.closure, run.rulings, run.accepted_doubts, run.protests)
        seen = (run.start, run.issue, said, written, snapshot.teams)
        if self._seen not in (None, seen):
            self.reload()
        self._seen = seen

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Says what is shown; not while other runs are on their way."""
        if not self._reading:
            self.head.say(text, tone)

    def _read(self, number: int) -> None:
        """In the thread: it must not wait for the screens."""
        try:
            show = partial(self.show_content, self.prepare(self._load()))
        except (MadrobError, OSError, MemoryError) as error:
            show = partial(self.head.say, str(error) or "no memory", Tone.BAD)
        self.call_later(self._show_read, number, show)

    def _show_read(self, number: int, show: Callable[[], None]) -> None:
        """Shows what was read last; results of earlier reads are dropped."""
        if number == self._number:
            self._reading = False
            show()


def results_state(snapshot: Snapshot) -> tuple[object, ...]:
    """Changes when a result has come or changed: what was read of all runs is old then."""
    run = snapshot.run
    said = (
        *(run.closure, run.rulings, run.voided, run.corrections),
        *(run.accepted_doubts, run.protests),
    )
    return (run.start, run.issue, said, snapshot.result is not None)


# Columns that the history and the standings share: numbers, names, indicators.


MISSING = Span("-", Tone.DIM)

_LARGE = 1e4
"""From here on a number is shown by its power of ten instead of all its digits."""


def number_column(
    title: str, meaning: str, value: Callable[[Row], int | None], width: int
) -> Column[Row]:
    def cell(row: Row) -> Span:
        found = value(row)
        return MISSING if found is None else Span(str(found))

    return Column(title, meaning, cell, value, width, right=True)


def text_column(
    title: str,
    meaning: str,
    value: Callable[[Row], str],
    width: int,
    *,
    ample: int = 0,
    comfort: bool = False,
) -> Column[Row]:
    """The column of a text, sorted without regard to case; an empty one comes last."""
    return Column(
        title,
        meaning,
        lambda row: Span(value(row)),
        lambda row: value(row).casefold() or None,
        width,
        ample,
        comfort=comfort,
    )


class Shown(NamedTuple):
    """What a row has of an indicator; `signs` stand directly behind the value."""

    value: float | None
    uncertainty: Uncertainty | None = None
    signs: str = ""


def indicator_column(
    name: IndicatorName, shown: Callable[[Row], Shown], signs: Callable[[], int] = lambda: 1
) -> Column[Row]:
    """The column of an indicator.

    `signs` gives the most that stand behind a value now; all values leave room for them.
    """
    spec = name.spec
    width = len(spec.column) + 1

    def cell(row: Row) -> Span:
        found = shown(row)
        behind = f"{found.signs:<{signs()}}"
        if found.value is None:
            return Span(f"{MISSING.text}{behind}", MISSING.tone)
        text = number_text(found.value, spec.decimals, width - len(behind), found.uncertainty)
        return Span(f"{text}{behind}", Tone.WARN if DOUBTED in behind else Tone.PLAIN)

    return Column(
        spec.column,
        f"{name.words} ({spec.unit})",
        cell,
        lambda row: shown(row).value,
        width,
        right=True,
        falling=spec.higher_is_better,
    )


def number_text(
    value: float, decimals: int, width: int, uncertainty: Uncertainty | None = None
) -> str:
    """A number in at most `width` cells: counts as they are, very large ones in powers of ten.

    It shows no digit below its uncertainty, and fewer decimals if there is no room.
    """
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    if uncertainty is not None and uncertainty.expanded:
        text = min(text, value_text(value, uncertainty), key=len)
    while len(text) > width and "." in text and "e" not in text and abs(value) < _LARGE:
        decimals -= 1
        text = f"{value:.{decimals}f}"
    small = value != 0 and abs(value) < 0.5 * 10**-decimals
    if not small and len(text) <= width:
        return text
    powers = f"{value:.1e}"
    return powers if len(powers) <= width else f"{value:.0e}"


# The columns of the history.


_OUTCOME_TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.PLAIN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
    None: Tone.WARN,
}
_SOURCES: Mapping[str, Span] = {
    SourceKind.ROS: Span("ros"),
    SourceKind.SIMULATED: Span("SIM", Tone.NOTICE),
    SourceKind.REPLAY: Span("rep", Tone.WARN),
}
_CLOSING_TONES = {
    "not final": Tone.DIM,
    "final": Tone.PLAIN,
    "protested": Tone.WARN,
    PROTEST_OPEN: Tone.BAD,
}
_OUTCOME = 13
"""Cells of the outcome with its signs; `completed P!!` has so many."""


def columns(name: Callable[[RunSummary], str] = attrgetter("team")) -> list[Column[RunSummary]]:
    """Every column, the most important first; `name` gives the current name of a run's team."""
    indicators = {name: _indicator(name) for name in IndicatorName}
    first = [
        indicators.pop(IndicatorName.CAPABILITY_LEVEL),
        indicators.pop(IndicatorName.EXECUTION_TIME),
        indicators.pop(IndicatorName.TIME_TO_HANDLE),
    ]
    return [
        Column(
            "started", "start", lambda r: Span(r.started_text), lambda r: r.started, 12,
            falling=True,
        ),
        number_column("subj", "subject", lambda r: r.subject, 4),
        text_column("team", "team", name, 8, ample=18),
        number_column("run", "run number", lambda r: r.run_number, 4),
        number_column("cond", "condition", lambda r: r.condition, 5),
        text_column("task", "task", lambda r: condition_words(r.condition).way, 20, comfort=True),
        Column("outcome", "outcome", _outcome, lambda r: r.outcome_word.casefold(), _OUTCOME),
        Column("src", "source", _source, lambda r: r.source, 3),
        *first,
        *indicators.values(),
        text_column("door", "benchmark type", lambda r: condition_words(r.condition).door, 14),
        number_column("issue", "issue of the result", lambda r: r.issue or None, 6),
        Column("result", "whether the result is final", _closing, lambda r: r.closing, 9),
        text_column("ruleset", "ruleset", lambda r: r.ruleset, 14),
        text_column("testbed", "testbed", lambda r: r.testbed, 12),
        Column("folder", "folder", lambda r: Span(r.folder, Tone.DIM), lambda r: r.folder, 44),
    ]  # fmt: skip


def _indicator(name: IndicatorName) -> Column[RunSummary]:
    return indicator_column(
        name, lambda run: Shown(run.values.get(name), run.uncertainties.get(name), run.sign(name))
    )


def _outcome(run: RunSummary) -> Span:
    """The word; `P` if a protest is open or `*` if it is not final, the sign of its flags."""
    void = run.outcome is Outcome.ABORTED or run.voided
    unsigned = "*" if run.issue and not run.final and not void else ""
    if run.protest_due is not None:
        unsigned = "P"
    signs = unsigned + flag_sign(run.flags)
    tone = Tone.BAD if run.problem else _OUTCOME_TONES[run.outcome]
    if tone is not Tone.BAD and (heavy := weighty(run.flags)):
        tone = FLAG_TONES[heavy[0].weight]
    word = shortened(run.outcome_word, _OUTCOME - len(f" {signs}" if signs else ""))
    return Span(f"{word} {signs}".rstrip(), tone)


def _source(run: RunSummary) -> Span:
    if run.practice and run.source == SourceKind.ROS:
        return Span("PRA", Tone.NOTICE)
    return _SOURCES.get(run.source or "", MISSING)


def _closing(run: RunSummary) -> Span:
    return Span(run.closing, _CLOSING_TONES[run.closing]) if run.issue else MISSING


# The history pane: all runs, filtered and sorted, open to be looked at again.


KEYS = (
    "Enter opens, x next, / filter, v which, o O sort, <- -> columns; "
    "* not final, P protest, ! flags, ? doubted"
)


class RunFilter(StrEnum):
    """Which runs are shown."""

    ALL = "all"
    OPEN = "not final"
    UNDECIDED = "undecided"
    NOT_COUNTED = "invalid and interrupted"
    PROTEST = "protest open"

    def takes(self, run: RunSummary) -> bool:
        match self:
            case RunFilter.ALL:
                return True
            case RunFilter.OPEN:
                return not run.final
            case RunFilter.PROTEST:
                return run.protest_due is not None
            case RunFilter.UNDECIDED:
                return bool(undecided(run.flags))
            case RunFilter.NOT_COUNTED:
                return not run.valid


class FilterField(Field):
    """One line to look for runs."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "clear", show=False),
        Binding("down", "submit", show=False),
    ]

    def action_clear(self) -> None:
        self.value = ""
        self.post_message(self.Submitted(self, ""))


class HistoryPane(RunsPane[Sequence[RunSummary], RunSummary]):
    """Newest first; a filter and `v` choose. Teams of `competition` are called as in the list."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("slash", "filter", show=False),
        Binding("v", "which", show=False),
        Binding("escape", "unfilter", show=False),
    ]

    def __init__(self, load: Load, competition: str = "") -> None:
        table = Table(columns(self._called), lambda run: run.folder, fixed=5)
        super().__init__(load, table, id="history")
        self._competition = competition
        self._listed: Mapping[int, str] = {}
        self._runs: Sequence[RunSummary] = ()
        self._which = RunFilter.ALL
        self._field = FilterField(id="history-filter")
        self._row = Horizontal(Label("filter", id="filter-name"), self._field, id="filter-row")

    def compose(self) -> ComposeResult:
        yield self.head
        yield self._row
        yield self.table
        yield self.about
        yield Label(KEYS)

    def look_for(self, text: str) -> None:
        self._field.value = text
        self._which = RunFilter.ALL
        self._show_rows()

    def show(self, snapshot: Snapshot) -> None:
        self._listed = snapshot.teams.names
        super().show(snapshot)

    def _called(self, run: RunSummary) -> str:
        """The team as listed; as recorded for other competitions and teams that are not listed."""
        listed = self._listed.get(run.subject, "") if run.competition == self._competition else ""
        return listed or run.team

    def prepare(self, runs: Sequence[RunSummary]) -> Sequence[RunSummary]:
        return tuple(reversed(runs))

    def show_content(self, content: Sequence[RunSummary]) -> None:
        self._runs = content
        self._show_rows(from_top=False)

    def action_filter(self) -> None:
        self._row.display = True
        self.screen.set_focus(self._field)

    def action_which(self) -> None:
        order = list(RunFilter)
        self._which = order[(order.index(self._which) + 1) % len(order)]
        self._show_rows()

    def action_unfilter(self) -> None:
        """Shows all runs again; SkipAction if all are shown, so that the key goes on."""
        if not self._field.value.strip() and self._which is RunFilter.ALL:
            raise SkipAction
        self.look_for("")

    def on_input_changed(self, event: Input.Changed) -> None:
        event.stop()
        self._show_rows()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self.screen.set_focus(self.table)

    def on_input_blurred(self, event: Input.Blurred) -> None:
        """The field goes, its text stays in the head line."""
        event.stop()
        self._row.display = False

    def words_about(self, row: RunSummary) -> tuple[str, Tone]:
        odd = row.problem is not None or row.outcome is None or undecided(row.flags)
        return about(row, self._called(row)), Tone.WARN if odd else Tone.DIM

    def _passes(self, run: RunSummary, text: str) -> bool:
        """Under either of its team's names."""
        if matches(run, text):
            return True
        name = self._called(run)
        return name != run.team and matches(replace(run, team=name), text)

    def _show_rows(self, *, from_top: bool = True) -> None:
        text = self._field.value
        problem = filter_problem(text)
        shown = [run for run in self._runs if self._which.takes(run) and self._passes(run, text)]
        self.table.empty = "no run passes the filter" if self._runs else "no runs yet"
        if problem is not None:
            self.table.empty = problem
        self.table.set_rows(shown, from_top=from_top)
        if len(shown) == len(self._runs) and self._which is RunFilter.ALL and not text.strip():
            self.say(summary(self._runs))
            return
        wanted = [] if self._which is RunFilter.ALL else [str(self._which)]
        wanted += [f"filter '{text.strip()}' (Escape clears it)"] if text.strip() else []
        self.say(f"{len(shown)} of {len(self._runs)} runs: {', '.join(wanted)}", Tone.STRONG)


def summary(runs: Sequence[RunSummary]) -> str:
    if not runs:
        return "no runs in the results folder"
    words = Counter("valid" if run.valid else run.outcome_word for run in runs)
    parts = [f"{count} {word}" for word, count in words.most_common()]
    practice = sum(run.practice for run in runs)
    among = f" ({practice} PRACTICE)" if practice else ""
    plural = "s" if len(runs) > 1 else ""
    protests = sum(run.protest_due is not None for run in runs)
    if protests:
        parts.append(f"{protests} PROTEST{'S' if protests > 1 else ''} open")
    return f"{len(runs)} run{plural}{among}: {', '.join(parts)}"


def about(run: RunSummary, name: str | None = None) -> str:
    """One run in words: its condition, what is wrong, where it lies; `name` None = as recorded."""
    if run.problem is not None:
        return f"{run.problem} (folder {run.folder})"
    if run.twin:
        return run.why_twin
    task = ", ".join(word for word in condition_words(run.condition) if word)
    told = [task or f"condition {run.condition} does not exist", run.outcome_word]
    if run.outcome is None:
        told.append(run.never_ran or "it goes on, or it was cut off")
    else:
        told += [f"issue {run.issue}", run.closing, run.ruleset]
    name = run.team if name is None else name
    recorded = f" (recorded as {run.team})" if run.team and run.team != name else ""
    team = f"{name}{recorded}: " if name else ""
    if run.protest_due is not None:
        told.insert(0, f"decision due {time_words(run.protest_due)}")
    flagged = "; ".join(f.words for f in run.flags if f.kind is not FlagKind.PRACTICE)
    return f"{flagged}{'; ' if flagged else ''}{team}{'; '.join(told)}; {run.folder}"
