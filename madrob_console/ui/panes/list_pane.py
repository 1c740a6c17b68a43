"""What all panes with lists have: a filter, and the marked row in words."""

from __future__ import annotations

from abc import abstractmethod
from asyncio import to_thread
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from textual import events, work
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical
from textual.message import Message
from textual.widget import Widget

from madrob_console.common.errors import MadrobError
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.tally import Standing
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.columns import Row
from madrob_console.ui.cells.controls import Label
from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.lines import NAMED_KEYS, Line, Span, Tone, line, paragraph
from madrob_console.ui.cells.table import Table

Content = TypeVar("Content")
_Row = TypeVar("_Row", bound="RunSummary | Standing")

Load = Callable[[], Sequence[RunSummary]]
"""Reads all runs; may take a while and may raise `MadrobError`."""

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
