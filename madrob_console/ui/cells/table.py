"""Tables and grids of any number of rows: only what is in view is drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, NamedTuple, TypeVar

from rich.cells import cell_len
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.common.names import terminal_safe
from madrob_console.ui.cells.lines import Line, Lines, Span, Target, Tone, line, width_of
from madrob_console.ui.look.words import fitted

# Columns of a table: what they show, how they sort, which of them fit.


Row = TypeVar("Row")

GAP = 1
"""Cells between two columns."""

ROOMY = 106
"""A table of so many cells has room for comfort."""


@dataclass(frozen=True, slots=True, eq=False)
class Column(Generic[Row]):
    """One column.

    Attributes:
        meaning: in words, with the unit.
        value: by what a row sorts: a number or a text; None = missing, always last.
        width: cells, with room for the arrow beside the title.
        ample: cells in a roomy table; 0 = `width`.
        right: numbers stand on the right.
        falling: it sorts from the largest first.
        comfort: in a table that is not roomy the column moves behind all the others.
    """

    title: str
    meaning: str
    cell: Callable[[Row], Span]
    value: Callable[[Row], float | str | None]
    width: int
    ample: int = 0
    right: bool = False
    falling: bool = False
    comfort: bool = False

    def fit(self, text: str, width: int) -> str:
        """A text in exactly `width` cells, on its side; what is cut shows an ellipsis."""
        safe = terminal_safe(text)
        missing = width - cell_len(safe)
        return " " * missing + safe if self.right and missing > 0 else fitted(safe, width)


class ColumnLayout(NamedTuple, Generic[Row]):
    """The columns in view.

    Attributes:
        shown: with their widths, from the left.
        before, after: how many are out of view on either side.
        first: the first column in view behind the fixed ones, counted among those.
        last_first: what `first` is when the last column comes into view.
    """

    shown: Sequence[tuple[Column[Row], int]]
    before: int
    after: int
    first: int
    last_first: int


def in_order(columns: Sequence[Column[Row]], width: int) -> list[Column[Row]]:
    """The columns as they stand in `width` cells."""
    return sorted(columns, key=lambda column: column.comfort and width < ROOMY)


def lay_out(
    columns: Sequence[Column[Row]], fixed: int, first: int, width: int
) -> ColumnLayout[Row]:
    """Which columns fit into `width` cells.

    `fixed` of them stay in view on the left; fewer if nothing else would fit. `first` is the
    first of the others that is wanted in view.
    """
    fixed = min(fixed, len(columns) - 1)
    sized = [(c, c.ample if c.ample and width >= ROOMY else c.width) for c in columns]
    while fixed and _taken(sized[:fixed]) + max(size for _, size in sized) > width:
        fixed -= 1
    others = sized[fixed:]
    room = width - _taken(sized[:fixed])
    last_first = len(others) - 1
    while last_first > 0 and _taken(others[last_first - 1 :]) - GAP <= room:
        last_first -= 1
    first = min(max(0, first), last_first)
    end = first + 1
    while end < len(others) and _taken(others[first : end + 1]) - GAP <= room:
        end += 1
    shown = [*sized[:fixed], *others[first:end]]
    return ColumnLayout(shown, first, len(others) - end, first, last_first)


def _taken(sized: Sequence[tuple[Column[Row], int]]) -> int:
    return sum(size + GAP for _, size in sized)


_MARK = "> "
_AROUND = 2  # header and last line
_WHEEL = 3


class Table(Lines, Generic[Row], can_focus=True):
    """Rows under a header; arrows move, left and right bring more columns, `o` and `O` sort.

    The columns come in the order of their importance. `key` names a row: the marked row stays
    marked when rows change. `fixed` columns stay in view on the left. `empty` is shown if
    there are no rows.
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
        return self._rows[self._cursor] if self._rows else None

    @property
    def rows(self) -> Sequence[Row]:
        return self._rows

    def set_rows(self, rows: Sequence[Row], *, from_top: bool = False) -> None:
        """Rows that sort alike keep this order; `from_top` marks the first, else the mark stays."""
        self._given = rows
        self._arrange(from_top=from_top)

    def lines(self, width: int) -> Sequence[Line]:
        return self.page(width, self.room.height)

    def page(self, width: int, height: int) -> list[Line]:
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
        self._mark(self._cursor + step)

    def action_page(self, step: int) -> None:
        self._mark(self._cursor + step * max(1, self.room.height - _AROUND))

    def action_end(self, last: bool) -> None:
        self._mark(len(self._rows) if last else 0)

    def action_columns(self, step: int) -> None:
        layout = self._layout(self.room.width)
        self._first = min(max(0, layout.first + step), layout.last_first)
        self.redraw()

    def action_sort(self) -> None:
        order = in_order(self._columns, self.room.width - len(_MARK))
        self.sort_by(order[(order.index(self._by) + 1) % len(order)])

    def action_reverse(self) -> None:
        self.sort_by(self._by, falling=not self._falling)

    def sort_by(self, column: Column[Row], *, falling: bool | None = None) -> None:
        """Sorts by a column, from the top; without `falling`, the way that is usual for it."""
        self._by = column
        self._falling = column.falling if falling is None else falling
        self._bring_into_view(column)
        self._arrange(from_top=True)

    def action_choose(self) -> None:
        if self._rows:
            self.post_message(self.Chosen(self._key(self._rows[self._cursor])))

    def on_click(self, event: events.Click) -> None:
        """Marks the row under the mouse, a double click opens it; a head sorts, again turns."""
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
        event.stop()
        self.action_move(_WHEEL)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
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


# A grid of short cells, as teams x conditions: only what is in view is drawn.


class GridRow(NamedTuple):
    """One row; `head` takes as many cells in every row, `cells` has one for each column."""

    head: Sequence[Span]
    cells: Sequence[Span]


class Grid(Lines, can_focus=True):
    """Cells of one width under titles; arrows mark one, the others follow into view.

    The marked cell stands in brackets, so that it can be seen without colours. `row` and
    `column` count from 0. `empty` is shown if there are no rows.
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
        """Shows other cells; the mark stays if it can. `corner` is as wide as the rows' heads."""
        self._corner, self._titles, self._rows = corner, titles, rows
        self.mark(self.row, self.column)

    def mark(self, row: int, column: int) -> None:
        self.row = min(max(0, row), max(0, len(self._rows) - 1))
        self.column = min(max(0, column), max(0, len(self._titles) - 1))
        self.post_message(self.Marked())
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
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
        self.mark(self.row + down, self.column + right)

    def action_page(self, step: int) -> None:
        self.mark(self.row + step * max(1, self.room.height - _AROUND), self.column)

    def action_edge(self, last: bool) -> None:
        self.mark(self.row, len(self._titles) if last else 0)

    def action_choose(self) -> None:
        if self._rows and self._titles:
            self.post_message(self.Chosen())

    def on_click(self, event: events.Click) -> None:
        """Marks the cell under the mouse; a click on the marked one chooses it."""
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
        event.stop()
        self.action_move(_WHEEL, 0)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_move(-_WHEEL, 0)


def _scrolled(first: int, marked: int, room: int, count: int) -> int:
    """The first of `room` in view, so that the marked one is among them."""
    first = min(first, marked, max(0, count - room))
    return max(first, marked - room + 1)
