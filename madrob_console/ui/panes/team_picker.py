"""The list of teams, to choose one of them."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.message import Message
from textual.widgets import Input

from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.list_columns import number_column, text_column
from madrob_console.ui.panes.list_pane import ListPane

KEYS = "a part of the name, or the number; Enter takes the marked row, Escape none"

NO_LIST = (
    "There is no list of teams, names are free. `teams_file` of [competition] in the settings names"
    " one, or `--teams FILE`; [[teams]] in the settings is one, too."
)


class PickRow(NamedTuple):
    """A team of the list; without a subject, what to do about one that is not in it."""

    subject: int | None
    name: str


class TeamPicker(ListPane[PickRow]):
    """Every team in a row; what is typed chooses among them."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
    ]

    @dataclass
    class Picked(Message):
        """A team of the list was chosen, or an `other` name for the set-up's; or neither."""

        subject: int | None = None
        other: str | None = None

    def __init__(self) -> None:
        columns: list[Column[PickRow]] = [
            number_column("subj", "subject", lambda team: team.subject, 4),
            text_column("team", "team", lambda team: team.name, 49, ample=90),
        ]
        super().__init__(
            Table(columns, lambda team: str(team.subject or ""), fixed=2),
            id="team-list",
            examples=KEYS,
        )
        self._teams = NO_TEAMS
        self._subject = 0
        self.filter.select_on_focus, self.filter.display = False, True

    def compose(self) -> ComposeResult:
        yield from (self.head, self.filter, self.table, self.about)

    def words_about(self, row: PickRow) -> tuple[str, Tone]:
        """The whole name."""
        return f"{row.subject or ''} {row.name}", Tone.PLAIN

    def open(self, teams: TeamList, subject: int) -> None:
        """`subject` is the set-up's team, which may have another name; 0 = none."""
        self._teams, self._subject, self.filter.value = teams, subject, ""
        self._show_rows()
        self.screen.set_focus(self.filter)

    def action_unfilter(self) -> None:
        self.post_message(self.Picked())

    def action_move(self, step: int) -> None:
        self.table.action_move(step)

    def action_page(self, step: int) -> None:
        self.table.action_page(step)

    def narrow(self, text: str) -> None:
        self._show_rows()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self.table.action_choose()

    def on_table_chosen(self, event: Table.Chosen) -> None:
        event.stop()
        if event.key:
            self.post_message(self.Picked(int(event.key)))
        else:
            self.post_message(self.Picked(other=self._searched))

    @property
    def _searched(self) -> str:
        return " ".join(self.filter.value.split())

    def _show_rows(self) -> None:
        names, searched = self._teams.names, self._searched
        rows = matching(names, searched)
        if names and self._subject:
            called = f": {searched}" if searched and not searched.isdecimal() else " ..."
            rows.append(PickRow(None, f"another name for subject {self._subject}{called}"))
        self.table.empty = "no team is called so" if names else "no teams"
        self.table.set_rows(rows, from_top=True)
        if not names or self._teams.notes:
            self.head.say("; ".join(self._teams.notes) if names else NO_LIST, Tone.WARN)
        else:
            self.head.say(f"Teams: {len(names)}")


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
