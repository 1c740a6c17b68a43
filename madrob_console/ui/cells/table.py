"""A table of any number of rows: only what is in view is drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Generic

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.columns import GAP, Column, ColumnLayout, Row, in_order, lay_out
from madrob_console.ui.cells.lines import Line, Lines, Span, Target, Tone, line, width_of
from madrob_console.ui.look.words import fitted

_MARK = "> "
_AROUND = 2  # header and last line
_WHEEL = 3


class Table(Lines, Generic[Row], can_focus=True):
    """Rows under a header; arrows move, left and right bring more columns, `o` and `O` sort.

    Args:
        columns: in the order of their importance.
        key: what names a row: the marked row stays marked when rows change.
        fixed: how many columns stay in view on the left.

    Attributes:
        empty: what to show instead of rows when there are none.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
        Binding("home", "end(False)", show=False),
        Binding("end", "end(True)", show=False),
        Binding("left", "columns(-1)", show=False),
        Binding("right", "columns(1)", show=False),
        Binding("o", "sort", show=False),
        Binding("O", "reverse", show=False),
        Binding("enter", "choose", show=False),
    ]

    class Chosen(Message):
        """Enter on a row."""

        def __init__(self, key: str) -> None:
            super().__init__()
            self.key = key

    class Marked(Message):
        """Another row is marked, or the marked one has changed; None = there are no rows."""

        def __init__(self, key: str | None) -> None:
            super().__init__()
            self.key = key

    def __init__(
        self,
        columns: Sequence[Column[Row]],
        key: Callable[[Row], str],
        *,
        fixed: int = 1,
    ) -> None:
        super().__init__()
        self._columns = columns
        self._key = key
        self._fixed = fixed
        self.empty = ""
        self._given: Sequence[Row] = ()
        self._rows: Sequence[Row] = ()
        self._by = columns[0]
        self._falling = columns[0].falling
        self._cursor = 0
        self._top = 0
        self._first = 0

    @property
    def selected(self) -> Row | None:
        """The marked row."""
        return self._rows[self._cursor] if self._rows else None

    @property
    def rows(self) -> Sequence[Row]:
        """All rows as they are sorted."""
        return self._rows

    def set_rows(self, rows: Sequence[Row], *, from_top: bool = False) -> None:
        """Show other rows; rows that sort alike keep the order given here.

        Args:
            rows: all of them.
            from_top: mark the first row; else the marked row stays marked.
        """
        self._given = rows
        self._arrange(from_top=from_top)

    def lines(self, width: int) -> Sequence[Line]:
        """Header, the rows in view, where that is."""
        return self.page(width, self.room.height)

    def page(self, width: int, height: int) -> list[Line]:
        """The same for any height."""
        layout = self._layout(width)
        room = max(1, height - _AROUND)
        self._top = min(self._top, self._cursor, max(0, len(self._rows) - room))
        self._top = max(self._top, self._cursor - room + 1)
        in_view = self._rows[self._top : self._top + room]
        body = [
            self._row(row, layout, marked=number == self._cursor)
            for number, row in enumerate(in_view, self._top)
        ]
        if not body:
            body = [line(Span(f"  {self.empty}", Tone.DIM))]
        blank: list[Line] = [()] * (room - len(body))
        return [self._header(layout), *body, *blank, self._foot(layout, len(in_view), width)]

    @property
    def copied(self) -> str:
        """The heads and the marked row, all columns, separated by tabs."""
        if self.selected is None:
            return ""
        heads = "\t".join(column.title for column in self._columns)
        cells = "\t".join(column.cell(self.selected).text for column in self._columns)
        return f"{heads}\n{cells}"

    def action_move(self, step: int) -> None:
        """Mark a row further down or up."""
        self._mark(self._cursor + step)

    def action_page(self, step: int) -> None:
        """The same by what is in view."""
        self._mark(self._cursor + step * max(1, self.room.height - _AROUND))

    def action_end(self, last: bool) -> None:
        """Mark the first or the last row."""
        self._mark(len(self._rows) if last else 0)

    def action_columns(self, step: int) -> None:
        """Bring more columns into view."""
        layout = self._layout(self.room.width)
        self._first = min(max(0, layout.first + step), layout.last_first)
        self.redraw()

    def action_sort(self) -> None:
        """Sort by the next column, as they stand now, and show it."""
        order = in_order(self._columns, self.room.width - len(_MARK))
        self.sort_by(order[(order.index(self._by) + 1) % len(order)])

    def action_reverse(self) -> None:
        """Sort the other way round."""
        self.sort_by(self._by, falling=not self._falling)

    def sort_by(self, column: Column[Row], *, falling: bool | None = None) -> None:
        """Sort by a column, from the top; without `falling`, the way that is usual for it."""
        self._by = column
        self._falling = column.falling if falling is None else falling
        self._bring_into_view(column)
        self._arrange(from_top=True)

    def action_choose(self) -> None:
        """Tell which row is marked."""
        if self._rows:
            self.post_message(self.Chosen(self._key(self._rows[self._cursor])))

    def on_click(self, event: events.Click) -> None:
        """Mark the row under the mouse, a double click opens it; a head sorts, again turns."""
        if (hit := self.clicked(event)) is not None:
            column = next(column for column in self._columns if column.title == hit[0])
            self.sort_by(column, falling=not self._falling if column is self._by else None)
            return
        offset = event.get_content_offset(self)
        in_view = min(len(self._rows) - self._top, self.room.height - _AROUND)
        if offset is not None and 1 <= offset.y <= in_view:
            self._mark(self._top + offset.y - 1)
            if event.chain == 2:
                self.action_choose()

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """The wheel moves the mark."""
        event.stop()
        self.action_move(_WHEEL)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """The wheel moves the mark."""
        event.stop()
        self.action_move(-_WHEEL)

    def _mark(self, number: int) -> None:
        self._cursor = min(max(0, number), max(0, len(self._rows) - 1))
        self._tell()
        self.redraw()

    def _tell(self) -> None:
        self.post_message(self.Marked(self._key(self._rows[self._cursor]) if self._rows else None))

    def _arrange(self, *, from_top: bool) -> None:
        marked = None if self.selected is None else self._key(self.selected)
        value = self._by.value
        valued = [(found, row) for row in self._given if (found := value(row)) is not None]
        valued.sort(key=lambda pair: pair[0], reverse=self._falling)
        missing = [row for row in self._given if value(row) is None]
        self._rows = [*(row for _, row in valued), *missing]
        keys = (number for number, row in enumerate(self._rows) if self._key(row) == marked)
        last = max(0, len(self._rows) - 1)
        self._cursor = 0 if from_top else next(keys, min(self._cursor, last))
        self._tell()
        self.redraw()

    def _layout(self, width: int) -> ColumnLayout[Row]:
        room = width - len(_MARK)
        return lay_out(in_order(self._columns, room), self._fixed, self._first, room)

    def _bring_into_view(self, column: Column[Row]) -> None:
        width = self.room.width
        others = in_order(self._columns, width - len(_MARK))[self._fixed :]
        if not width or column not in others:
            return
        self._first = min(self._first, others.index(column))
        while all(shown is not column for shown, _ in self._layout(width).shown):
            self._first += 1

    def _header(self, layout: ColumnLayout[Row]) -> Line:
        spans = [Span(" " * len(_MARK))]
        for column, width in layout.shown:
            sorts = column is self._by
            arrow = ("▼" if self._falling else "▲") if sorts else ""
            text = column.fit(column.title[: width - len(arrow)] + arrow, width)
            tone = Tone.STRONG if sorts else Tone.DIM
            spans += [Target(text, tone, column.title), Span(" " * GAP)]
        return tuple(spans[:-1])

    def _row(self, row: Row, layout: ColumnLayout[Row], *, marked: bool) -> Line:
        spans = [Span(_MARK if marked else " " * len(_MARK), Tone.STRONG)]
        at_cursor = marked and self.has_focus
        for column, width in layout.shown:
            text, tone = column.cell(row)
            if at_cursor and tone in (Tone.PLAIN, Tone.DIM):
                tone = Tone.CURSOR
            gap = Tone.CURSOR if at_cursor else Tone.PLAIN
            spans += [Span(column.fit(text, width), tone), Span(" " * GAP, gap)]
        return tuple(spans[:-1])

    def _foot(self, layout: ColumnLayout[Row], shown: int, width: int) -> Line:
        where = f"{self._top + 1}-{self._top + shown} of {len(self._rows)}" if shown else "none"
        way = "descending" if self._falling else "ascending"
        text = f"  {where}, by {self._by.meaning}, {way}"
        left = f"<- {layout.before}" if layout.before else ""
        right = f"{layout.after} ->" if layout.after else ""
        more = "  ".join(part for part in (left, "more columns", right) if part)
        if not (left or right):
            return line(Span(text, Tone.DIM))
        room = width - width_of(line(more)) - GAP
        return line(Span(fitted(text, room), Tone.DIM), " " * GAP, Span(more, Tone.DIM))
