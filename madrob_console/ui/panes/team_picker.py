"""The list of teams, to choose one of them."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.ui.cells.dialog import Field
from madrob_console.ui.cells.lines import Label, Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.runs_pane import number_column, text_column

KEYS = "A part of a name, or a number; arrows; Enter takes the marked row, Escape none."

NO_LIST = (
    "There is no list of teams, names are free. `teams_file` of [competition] in the settings names"
    " one, or `--teams FILE`; [[teams]] in the settings is one, too."
)


class PickRow(NamedTuple):
    """A team of the list; without a subject, what to do about one that is not in it."""

    subject: int | None
    name: str


class SearchField(Field):
    """What is looked for; the arrows move in what is found."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "mark('move', -1)", show=False),
        Binding("down", "mark('move', 1)", show=False),
        Binding("pageup", "mark('page', -1)", show=False),
        Binding("pagedown", "mark('page', 1)", show=False),
    ]

    def __init__(self, table: Table[PickRow]) -> None:
        super().__init__(id="team-search", select_on_focus=False)
        self._table = table

    def action_mark(self, how: str, step: int) -> None:
        if how == "page":
            self._table.action_page(step)
        else:
            self._table.action_move(step)


class TeamPicker(Vertical):
    """Every team in a row; what is typed chooses among them."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "close", show=False),
    ]

    class Picked(Message):
        """A team was chosen; None: none was."""

        def __init__(self, subject: int | None) -> None:
            super().__init__()
            self.subject = subject

    class Named(Message):
        """The team of the set-up is to have another name than the list has."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

    def __init__(self) -> None:
        super().__init__(id="team-picker")
        self._teams = NO_TEAMS
        self._subject = 0
        self._table: Table[PickRow] = Table(
            [
                number_column("subj", "subject", lambda team: team.subject, 4),
                text_column("team", "team", lambda team: team.name, 49, ample=90),
            ],
            lambda team: "" if team.subject is None else str(team.subject),
            fixed=2,
        )
        self._head = Label(id="team-head")
        self._field = SearchField(self._table)
        self._about = Label(id="team-about")

    def compose(self) -> ComposeResult:
        yield self._head
        yield Horizontal(Label("search ", id="team-search-name"), self._field, id="team-search-row")
        yield self._table
        yield self._about
        yield Label(KEYS)

    def open(self, subject: int) -> None:
        """`subject` is the set-up's team, which may have another name; 0 = none."""
        self._subject = subject
        self._field.value = ""
        self._show_rows()
        self.screen.set_focus(self._field)

    def type(self, text: str) -> None:
        """Takes what was typed before the search had the focus."""
        self._field.insert_text_at_cursor(text)

    def show_teams(self, teams: TeamList) -> None:
        if teams != self._teams:
            self._teams = teams
            self._show_rows()

    def action_close(self) -> None:
        self.post_message(self.Picked(None))

    def on_input_changed(self, event: Input.Changed) -> None:
        event.stop()
        self._show_rows()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self._table.action_choose()

    def on_input_blurred(self, event: Input.Blurred) -> None:
        """Nothing was set up here."""
        event.stop()

    def on_table_marked(self, event: Table.Marked) -> None:
        event.stop()
        marked = self._table.selected
        number = "" if marked is None or marked.subject is None else f"{marked.subject} "
        self._about.say("" if marked is None else f"{number}{marked.name}", Tone.STRONG)

    def on_table_chosen(self, event: Table.Chosen) -> None:
        event.stop()
        if event.key:
            self.post_message(self.Picked(int(event.key)))
        else:
            self.post_message(self.Named(" ".join(self._field.value.split())))

    def _show_rows(self) -> None:
        names = self._teams.names
        found = matching(names, self._field.value)
        self._table.empty = "no team is called so" if names else "no teams"
        other = [self._other_row] if names and self._subject else []
        self._table.set_rows([*found, *other], from_top=True)
        if not names:
            self._head.say(NO_LIST, Tone.WARN)
        elif self._teams.problems:
            self._head.say("; ".join(self._teams.problems), Tone.WARN)
        else:
            of = "" if len(found) == len(names) else f"{len(found)} of "
            self._head.say(f"Teams: {of}{len(names)}", Tone.PLAIN)

    @property
    def _other_row(self) -> PickRow:
        name = " ".join(self._field.value.split())
        called = f": {name}" if name and not name.isdecimal() else " ..."
        return PickRow(None, f"another name for subject {self._subject}{called}")


def matching(names: Mapping[int, str], text: str) -> list[PickRow]:
    """The teams that a search finds, by number.

    A number finds the teams whose numbers begin with it; anything else, and a number that no team
    has, those with every word of it in their names. Capitals and accents do not matter.
    """
    teams = [PickRow(subject, names[subject]) for subject in sorted(names)]
    digits = text.strip().lstrip("0")
    if digits.isdecimal():
        numbered = [team for team in teams if str(team.subject).startswith(digits)]
        if numbered:
            return numbered
    words = _plain(text).split()
    return [team for team in teams if all(word in _plain(team.name) for word in words)]


def _plain(text: str) -> str:
    apart = unicodedata.normalize("NFKD", text.casefold())
    return "".join(char for char in apart if not unicodedata.combining(char))
