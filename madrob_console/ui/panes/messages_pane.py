"""The messages pane: what this screen has said, the newest first."""

from __future__ import annotations

from collections.abc import Sequence

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.controls import Said
from madrob_console.ui.cells.lines import Span, Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.list_pane import LIST_KEYS, ListPane


class MessagesPane(ListPane[Said]):
    """`said` grows while it is shown."""

    def __init__(self, said: Sequence[Said]) -> None:
        self._said = said
        columns: list[Column[Said]] = [
            Column(
                "time", "time", lambda said: Span(time_of_day(said.at)), lambda said: said.at, 9,
                falling=True,
            ),
            Column(
                "message", "message", lambda said: Span(said.text, said.tone),
                lambda said: said.text, 64, ample=200,
            ),
        ]  # fmt: skip
        super().__init__(Table(columns, lambda said: f"{said.at} {said.text}"), id="messages")
        self.table.empty = "nothing was said yet"
        self.head.say("What this screen has said", Tone.STRONG)
        self.keys.say(LIST_KEYS, Tone.DIM)

    def words_about(self, row: Said) -> tuple[str, Tone]:
        return row.text, row.tone

    def enter(self) -> None:
        self.screen.set_focus(self.table)

    def show(self, snapshot: Snapshot) -> None:
        self.table.set_rows([*reversed(self._said)])
