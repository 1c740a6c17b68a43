"""What the panes about all runs have in common: they read in the background."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Generic, TypeVar

from textual.containers import Vertical
from textual.message import Message

from madrob_console.archive.history import RunSummary
from madrob_console.errors import MadrobError
from madrob_console.ui.cells.label import Label
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.cells.table import Table

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.standings.tally import Standing

Content = TypeVar("Content")
_Row = TypeVar("_Row", bound="RunSummary | Standing")

Load = Callable[[], Sequence[RunSummary]]
"""Reads all runs; may take a while and may raise `MadrobError`."""


class RunsPane(Vertical, Generic[Content, _Row]):
    """Reads all runs when it comes into view and whenever a result changes.

    Args:
        load: called in a thread.
        table: of what is read; it has the focus.
        id: of the pane.

    Attributes:
        table: as given.
        head: says what is shown, or what is wrong.
        about: says what does not fit into the marked row.
    """

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
    def take(self, content: Content) -> None:
        """Show what was prepared."""

    @abstractmethod
    def words_about(self, row: _Row) -> tuple[str, Tone]:
        """What does not fit into a row."""

    @property
    def selected(self) -> _Row | None:
        """The marked row."""
        return self.table.selected

    def on_table_marked(self, event: Table.Marked) -> None:
        """Say what does not fit into the marked row."""
        event.stop()
        row = self.selected
        self.about.say(*("", Tone.DIM) if row is None else self.words_about(row))

    def on_table_chosen(self, event: Table.Chosen) -> None:
        """Ask for the marked row."""
        event.stop()
        if self.selected is not None:
            self.post_message(self.Opened(self.selected))

    def enter(self) -> None:
        """Take the focus and read."""
        self.screen.set_focus(self.table)
        self._seen = None
        self.reload()

    def reload(self) -> None:
        """Read in the background; what was shown stays until then."""
        self._number += 1
        self._reading = True
        self.head.say("reading the results folder ...", Tone.DIM)
        self.run_worker(partial(self._read, self._number), thread=True, exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        """Read again when a result has come or changed, or the list of teams."""
        run = snapshot.run
        written = snapshot.result is not None
        said = (run.closure, run.rulings, run.accepted_doubts, run.protests)
        seen = (run.start, run.issue, said, written, snapshot.teams)
        if self._seen not in (None, seen):
            self.reload()
        self._seen = seen

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Say what is shown; not while other runs are on their way."""
        if not self._reading:
            self.head.say(text, tone)

    def _read(self, number: int) -> None:
        """In the thread: it must not wait for the screens."""
        try:
            show = partial(self.take, self.prepare(self._load()))
        except (MadrobError, OSError, MemoryError) as error:
            show = partial(self.head.say, str(error) or "no memory", Tone.BAD)
        self.call_later(self._show_read, number, show)

    def _show_read(self, number: int, show: Callable[[], None]) -> None:
        """Show what was read last; what an earlier reading brings is old."""
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
