"""The history pane, and what the lists share."""

from __future__ import annotations

from abc import abstractmethod
from asyncio import to_thread
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import ClassVar, Generic, TypeVar

from msgspec.structs import replace
from textual import events, work
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical
from textual.message import Message
from textual.widget import Widget

from madrob_console.archive.collection import filter_problem, matches
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted
from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.tally import Standing
from madrob_console.referee.flags import serious, undecided
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run_summary import PROTEST_OPEN, RunSummary, condition_words
from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.lines import NAMED_KEYS, Label, Line, Span, Tone, line, paragraph
from madrob_console.ui.cells.table import Column, Row, Table
from madrob_console.ui.look.words import shortened
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Uncertainty, value_text

Content = TypeVar("Content")
_Row = TypeVar("_Row", bound="RunSummary | Standing")

Load = Callable[[], Sequence[RunSummary]]
"""Reads all runs; may take a while and may raise `MadrobError`."""


# What all lists have: a filter, and the marked row in words, below the table or beside it.


LIST_KEYS = "< > o sort, / filters"

_LIST_KEYS = NAMED_KEYS | {
    "<": "less_than_sign",
    ">": "greater_than_sign",
    " o ": "o",
    "/ filters": "slash",
    "v ": "v",
}

BESIDE = 114
"""From so many cells of a list on, in a terminal of 120, the marked row stands beside it."""


class Filtered(Vertical):
    """`/` opens a field above what is listed, Escape shows all again."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("slash", "filter", show=False),
        Binding("escape", "unfilter", show=False),
    ]

    def __init__(self, listed: Widget, *, id: str, examples: str = "") -> None:  # noqa: A002 - textual's name
        super().__init__(id=id)
        self.filter = Field(id=f"{id}-filter")
        self.filter.placeholder = examples or "words that it has; Enter goes to the list"
        self.filter.display = False
        self._listed = listed

    def compose(self) -> ComposeResult:
        yield from (self.filter, self._listed)

    @abstractmethod
    def narrow(self, text: str) -> None:
        """Shows what passes the filter."""

    def look_for(self, text: str) -> None:
        self.filter.value, self.filter.display = text, bool(text)
        self.narrow(text)

    def action_filter(self) -> None:
        self.filter.display = True
        self.screen.set_focus(self.filter)

    def action_unfilter(self) -> None:
        """Shows all again; SkipAction if all is shown, so that the key goes on."""
        if not self.filter.display:
            raise SkipAction
        self.look_for("")
        self.screen.set_focus(self._listed)

    def on_input_changed(self, event: Field.Changed) -> None:
        event.stop()
        self.narrow(self.filter.value)

    def on_input_submitted(self, event: Field.Submitted) -> None:
        event.stop()
        self.filter.display = bool(self.filter.value)
        self.screen.set_focus(self._listed)


class About(Label):
    """The marked row: what does not fit into it below the table, all of it beside that."""

    cells: Sequence[tuple[str, Span]] = ()
    beside = False

    def lines(self, width: int) -> Sequence[Line]:
        if not self.beside:
            return paragraph(self.text, width, self.tone)  # it names no keys
        rows = [row for part in self.text.split("; ") for row in paragraph(part, width, self.tone)]
        return [
            *rows,
            line(),
            *(line(Span(f"{name:<9} ", Tone.DIM), cell) for name, cell in self.cells),
        ]


class ListPane(Filtered, Generic[Row]):
    """A table; the line above says what it shows, `about` what its marked row means."""

    def __init__(self, table: Table[Row], *, id: str, examples: str = "") -> None:  # noqa: A002 - textual's name
        super().__init__(table, id=id, examples=examples)
        self.table = table
        self.head = Label(id=f"{id}-head")
        self.about = About(id=f"{id}-about")
        self.keys = Label(keys=_LIST_KEYS)

    def compose(self) -> ComposeResult:
        yield from (self.filter, self.head)
        yield Container(self.table, self.about)
        yield self.keys

    def narrow(self, text: str) -> None:
        self.table.narrow(text)

    def on_resize(self, event: events.Resize) -> None:
        self.about.beside = event.size.width >= BESIDE and not self.table.marks_cells
        self.set_class(self.about.beside, "-beside")

    @abstractmethod
    def words_about(self, row: Row) -> tuple[str, Tone]:
        """What does not fit into a row."""

    def on_table_marked(self, event: Table.Marked) -> None:
        event.stop()
        row, columns = self.table.selected, self.table.columns
        self.about.cells = (
            [] if row is None else [(column.title, column.cell(row)) for column in columns]
        )
        self.about.say(*("", Tone.DIM) if row is None else self.words_about(row))


class RunsPane(ListPane[_Row], Generic[Content, _Row]):
    """Reads all runs in a thread when it comes into view and whenever a result changes."""

    @dataclass
    class Opened(Message):
        """The referee wants to see the run, or the runs, of a row."""

        row: RunSummary | Standing

    def __init__(
        self, load: Load, table: Table[_Row], content: Content, name: str, examples: str = ""
    ) -> None:
        super().__init__(table, id=name, examples=examples)
        self._load = load
        self.content = content
        self._reading = False
        self._shown_state: object = None
        self.teams: Mapping[int, str] = {}
        self.competition = ""

    @abstractmethod
    def prepare(self, runs: Sequence[RunSummary]) -> Content:
        """What the pane needs of the runs; done in a thread."""

    @abstractmethod
    def show_rows(self, *, from_top: bool = True) -> None:
        """Shows what was prepared; `from_top` marks the first row."""

    def on_table_chosen(self, event: Table.Chosen) -> None:
        event.stop()
        if (row := self.table.selected) is not None:
            self.post_message(self.Opened(row))

    def enter(self) -> None:
        self.screen.set_focus(self.table)
        self._shown_state = None
        self.reload()

    def reload(self) -> None:
        """Reads in a thread; what was shown stays until then, what is read no more is dropped."""
        self._reading = True
        self.head.say("reading the results folder ...", Tone.DIM)
        self._read()

    def show(self, snapshot: Snapshot) -> None:
        shown_state = (results_state(snapshot), snapshot.teams, snapshot.competition)
        self.teams, self.competition = snapshot.teams.names, snapshot.competition
        if self._shown_state not in (None, shown_state):
            self.reload()
        self._shown_state = shown_state

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Says what is shown, if no other runs are on their way."""
        if not self._reading:
            self.head.say(text, tone)

    @work(exclusive=True)
    async def _read(self) -> None:
        try:
            self.content = await to_thread(lambda: self.prepare(self._load()))
        except (MadrobError, OSError, MemoryError) as error:
            self._reading = False
            self.say(str(error) or "no memory", Tone.BAD)
        else:
            self._reading = False
            self.show_rows(from_top=False)


def results_state(snapshot: Snapshot) -> tuple[object, ...]:
    """Changes when a result has come or changed: what was read of all runs is old then."""
    run = snapshot.run
    said = (
        *(run.closure, run.rulings, run.voided, run.corrections),
        *(run.accepted_doubts, run.protests),
    )
    written = [entry.number for entry in snapshot.log if entry.text == Change.RESULT_WRITTEN]
    return (run.start, run.issue, said, snapshot.result is not None, written[-1:])


# Columns that the history and the standings share: numbers, names, indicators.


MISSING = Span("-", Tone.DIM)

_LARGE = 1e4
"""From here on a number is shown by its power of ten instead of all its digits."""


def number_column(
    title: str, meaning: str, value: Callable[[Row], int | None], width: int
) -> Column[Row]:
    def cell(row: Row) -> Span:
        content = value(row)
        return MISSING if content is None else Span(str(content))

    return Column(title, meaning, cell, value, width, right=True)


def text_column(
    title: str,
    meaning: str,
    value: Callable[[Row], str],
    width: int,
    *,
    ample: int = 0,
) -> Column[Row]:
    """The column of a text, sorted without regard to case; an empty one comes last."""
    return Column(
        title,
        meaning,
        lambda row: Span(value(row)),
        lambda row: value(row).casefold() or None,
        width,
        ample,
    )


def indicator_column(name: IndicatorName) -> Column[RunSummary]:
    spec, width = name.spec, len(name.spec.column) + 1

    def cell(run: RunSummary) -> Span:
        value, sign = run.values.get(name), run.sign(name)
        if value is None:
            return Span(f"{MISSING.text}{sign:<1}", MISSING.tone)
        text = number_text(value, spec.decimals, width - 1, run.uncertainties.get(name))
        return Span(f"{text}{sign:<1}", Tone.WARN if sign else Tone.PLAIN)

    return Column(
        spec.column,
        f"{name.words} ({spec.unit})",
        cell,
        lambda run: run.values.get(name),
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
"""Cells of the outcome with its signs; `completed *!!` has so many."""

LEGEND = "!! decide  ! scored otherwise  P protest  * not final"


def columns(name: Callable[[RunSummary], str] = attrgetter("team")) -> list[Column[RunSummary]]:
    """Every column, the most important first; `name` gives the current name of a run's team."""
    indicators = {name: indicator_column(name) for name in IndicatorName}
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
        text_column("team", "team", name, 14, ample=30),
        number_column("run", "run number", lambda r: r.run_number, 4),
        number_column("cond", "condition", lambda r: r.condition, 5),
        Column("outcome", "outcome", _outcome, lambda r: r.outcome_word.casefold(), _OUTCOME),
        Column("src", "source", _source, lambda r: r.source, 3),
        *first,
        text_column("task", "task", lambda r: condition_words(r.condition).way, 20),
        *indicators.values(),
        text_column("door", "benchmark type", lambda r: condition_words(r.condition).door, 14),
        number_column("vers", "version of the result", lambda r: r.issue or None, 6),
        Column("result", "whether the result is final", _closing, lambda r: r.closing, 9),
        text_column("ruleset", "ruleset", lambda r: r.ruleset, 14),
        text_column("testbed", "testbed", lambda r: r.testbed, 12),
    ]  # fmt: skip


def _outcome(run: RunSummary) -> Span:
    """The word with its signs (`LEGEND`); what counts nowhere has no score to be changed."""
    counts = run.outcome is not Outcome.ABORTED and not run.voided
    sign = "*" if run.issue and not run.final and counts else ""
    tone = Tone.BAD if run.problem else _OUTCOME_TONES[run.outcome]
    if run.protest_filed is not None:
        sign, tone = "P", Tone.BAD
    elif undecided(run.flags):
        sign, tone = f"{sign}!!", Tone.BAD
    elif run.valid and serious(run.flags):
        sign, tone = f"{sign}!", Tone.WARN
    word = shortened(run.outcome_word, _OUTCOME - 1 - len(sign))
    return Span(f"{word} {sign}".rstrip(), tone)


def _source(run: RunSummary) -> Span:
    practice = run.practice and run.source == SourceKind.ROS
    return Span("PRA", Tone.NOTICE) if practice else _SOURCES.get(run.source or "", MISSING)


def _closing(run: RunSummary) -> Span:
    return Span(run.closing, _CLOSING_TONES[run.closing]) if run.issue else MISSING


# The history pane: all runs, filtered and sorted, open to be looked at again.


EXAMPLES = "delft, cond:7, official, not final, undecided, 14 Nov; Enter: to the list"


class HistoryPane(RunsPane[Sequence[RunSummary], RunSummary]):
    """Newest first. Teams of the competition are called as in the list."""

    def __init__(self, load: Load) -> None:
        cells = columns(self._called)
        table = Table(cells, lambda run: run.folder, fixed=5, passes=self._passes)
        table.legend, table.empty = LEGEND, "no runs yet"
        super().__init__(load, table, (), "history", EXAMPLES)
        self.keys.say(f"Enter opens its menu, {LIST_KEYS}", Tone.DIM)

    def narrow(self, text: str) -> None:
        self.table.narrow(text, filter_problem(text) or "no run passes the filter")

    def _called(self, run: RunSummary) -> str:
        """The team as listed; as recorded for other competitions and teams that are not listed."""
        listed = self.teams.get(run.subject, "") if run.competition == self.competition else ""
        return listed or run.team

    def prepare(self, runs: Sequence[RunSummary]) -> Sequence[RunSummary]:
        return runs[::-1]

    def words_about(self, row: RunSummary) -> tuple[str, Tone]:
        odd = row.problem is not None or row.outcome is None or undecided(row.flags)
        return about(row, self._called(row)), Tone.WARN if odd else Tone.DIM

    def _passes(self, run: RunSummary, text: str) -> bool:
        """Under either of its team's names."""
        if matches(run, text):
            return True
        name = self._called(run)
        return name != run.team and matches(replace(run, team=name), text)

    def show_rows(self, *, from_top: bool = True) -> None:
        self.table.set_rows(self.content, from_top=from_top)
        self.say(summary(self.content))


def summary(runs: Sequence[RunSummary]) -> str:
    if not runs:
        return "no runs in the results folder"
    words = Counter("valid" if run.valid else run.outcome_word for run in runs)
    practice = sum(run.practice for run in runs)
    protests = sum(run.protest_filed is not None for run in runs)
    among = f" ({practice} PRACTICE)" if practice else ""
    parts = [f"{count} {word}" for word, count in words.most_common()]
    parts += [protests_open(protests)] if protests else []
    return f"{counted(len(runs), 'run')}{among}: {', '.join(parts)}"


def protests_open(count: int) -> str:
    return f"{count} PROTEST{'S' if count > 1 else ''} open"


def about(run: RunSummary, name: str | None = None) -> str:
    """One run in words, first what must be decided; `name` None = the team's as recorded."""
    if run.problem is not None:
        return f"{run.problem} (folder {run.folder})"
    if run.twin:
        return run.why_twin
    waiting = undecided(run.flags)
    name = run.team if name is None else name
    recorded = f" (recorded as {run.team})" if run.team and run.team != name else ""
    task = ", ".join(filter(None, condition_words(run.condition)))
    task = task or f"condition {run.condition} does not exist"
    version = f"{'PRACTICE, ' if run.practice else ''}version {run.issue}"
    ended = (version, run.closing, run.ruleset)
    facts = (
        *(flag.words for flag in waiting),
        *(flag.words for flag in serious(run.flags) if flag not in waiting),
        f"{name}{recorded}: {task}" if name else task,
        run.outcome_word,
        *((run.never_ran or "it goes on, or it was cut off",) if run.outcome is None else ended),
        run.folder,
    )
    return "; ".join(filter(None, facts))
