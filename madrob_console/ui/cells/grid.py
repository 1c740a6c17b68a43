"""A grid of short cells, as teams x conditions: only what is in view is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line

_AROUND = 2  # header and last line
_WHEEL = 3


class GridRow(NamedTuple):
    """One row.

    Attributes:
        head: stands on its left, in as many cells in every row.
        cells: one for each column.
    """

    head: Sequence[Span]
    cells: Sequence[Span]


class Grid(Lines, can_focus=True):
    """Cells of one width under titles; arrows mark one, the others follow into view.

    The marked cell stands in brackets, so that it can be seen without colours.

    Attributes:
        row, column: of the marked cell, from 0.
        empty: what to show where there are no rows.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1, 0)", show=False),
        Binding("down", "move(1, 0)", show=False),
        Binding("left", "move(0, -1)", show=False),
        Binding("right", "move(0, 1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
        Binding("home", "edge(False)", show=False),
        Binding("end", "edge(True)", show=False),
        Binding("enter", "choose", show=False),
    ]

    class Chosen(Message):
        """Enter on a cell, or a click on the marked one."""

    class Marked(Message):
        """Another cell is marked, or the marked one has changed."""

    def __init__(self) -> None:
        super().__init__()
        self.row = self.column = 0
        self.empty = ""
        self._titles: Sequence[str] = ()
        self._rows: Sequence[GridRow] = ()
        self._corner = ""
        self._top = self._first = 0

    def set_cells(self, corner: str, titles: Sequence[str], rows: Sequence[GridRow]) -> None:
        """Show other cells; the mark stays where it is, as far as there is such a cell.

        Args:
            corner: stands over the heads of the rows, as wide as they are.
            titles: of the columns.
            rows: each with a cell for each column.
        """
        self._corner, self._titles, self._rows = corner, titles, rows
        self.mark(self.row, self.column)

    def mark(self, row: int, column: int) -> None:
        """Mark a cell, or the one nearest to it."""
        self.row = min(max(0, row), max(0, len(self._rows) - 1))
        self.column = min(max(0, column), max(0, len(self._titles) - 1))
        self.post_message(self.Marked())
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        """Titles, the rows in view, where that is."""
        height = self.room.height
        if not self._rows or not self._titles:
            return [line(Span(f"  {self.empty}", Tone.DIM))]
        across = max(1, (width - len(self._corner) - 1) // self._pitch)
        self._first = _scrolled(self._first, self.column, across, len(self._titles))
        down = max(1, height - _AROUND)
        self._top = _scrolled(self._top, self.row, down, len(self._rows))
        columns = range(self._first, min(self._first + across, len(self._titles)))
        rows = range(self._top, min(self._top + down, len(self._rows)))
        body = [self._line(row, columns) for row in rows]
        return [self._header(columns), *body, self._foot(rows, columns)]

    @property
    def _pitch(self) -> int:
        """Cells from one column to the next."""
        texts = (span.text for row in self._rows for span in row.cells)
        return 1 + max(map(len, (*self._titles, *texts)))

    def _header(self, columns: range) -> Line:
        spans = [Span(self._corner, Tone.DIM)]
        for column in columns:
            tone = Tone.STRONG if column == self.column else Tone.DIM
            spans.append(Span(f"{self._titles[column]:>{self._pitch}}", tone))
        return tuple(spans)

    def _line(self, row: int, columns: range) -> Line:
        spans = list(self._rows[row].head)
        closing = " "
        for column in columns:
            text, tone = self._rows[row].cells[column]
            marked = (row, column) == (self.row, self.column)
            spans.append(Span("[" if marked else closing, Tone.STRONG if marked else Tone.PLAIN))
            in_focus = marked and self.has_focus
            cell = f"{text:>{self._pitch - 1}}"
            spans.append(Span(cell, Tone.CURSOR if in_focus else tone))
            closing = "]" if marked else " "
        spans.append(Span(closing, Tone.STRONG))
        return tuple(spans)

    def _foot(self, rows: range, columns: range) -> Line:
        parts = []
        for what, seen, of in (
            ("rows", rows, len(self._rows)),
            ("columns", columns, len(self._titles)),
        ):
            if len(seen) < of:
                parts.append(f"{what} {seen[0] + 1}-{seen[-1] + 1} of {of}")
        return line(Span("  ".join(parts), Tone.DIM))

    def action_move(self, down: int, right: int) -> None:
        """Mark a cell beside the marked one."""
        self.mark(self.row + down, self.column + right)

    def action_page(self, step: int) -> None:
        """Mark one further up or down, by what is in view."""
        self.mark(self.row + step * max(1, self.room.height - _AROUND), self.column)

    def action_edge(self, last: bool) -> None:
        """Mark the first or the last of the row."""
        self.mark(self.row, len(self._titles) if last else 0)

    def action_choose(self) -> None:
        """Tell that the marked cell is wanted."""
        if self._rows and self._titles:
            self.post_message(self.Chosen())

    def on_click(self, event: events.Click) -> None:
        """Mark the cell under the mouse; the marked one is wanted."""
        offset = event.get_content_offset(self)
        if offset is None or not self._rows:
            return
        row = self._top + offset.y - 1
        column = self._first + (offset.x - len(self._corner)) // self._pitch
        inside = offset.y >= 1 and row < len(self._rows) and offset.x >= len(self._corner)
        if not inside or column >= len(self._titles):
            return
        if (row, column) == (self.row, self.column):
            self.action_choose()
        self.mark(row, column)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """The wheel moves the mark."""
        event.stop()
        self.action_move(_WHEEL, 0)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """The wheel moves the mark."""
        event.stop()
        self.action_move(-_WHEEL, 0)


def _scrolled(first: int, marked: int, room: int, count: int) -> int:
    """The first of `room` in view, so that the marked one is among them."""
    first = min(first, marked, max(0, count - room))
    return max(first, marked - room + 1)
