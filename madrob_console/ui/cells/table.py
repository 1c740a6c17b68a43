"""A table of any number of rows: only what is in view is drawn."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic

from rich.cells import cell_len
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.ui.cells.columns import GAP, Column, ColumnLayout, Row, lay_out
from madrob_console.ui.cells.lines import Line, Lines, Span, Target, Tone, line, with_keys
from madrob_console.ui.look.words import fitted

_AROUND = 2  # header and last line
_WHEEL = 3

_SORTS = "sorts by "
"""Begin of the target of a head; that of a cell is the title alone."""


class Table(Lines, Generic[Row], can_focus=True):
    """Rows under a header; arrows move, left and right bring more columns, `<` and `>` sort.

    The columns come in the order of their importance. `key` names a row: the marked row stays
    marked when rows change. `fixed` columns stay in view on the left. With `marks_cells` left
    and right mark a cell of the others, in brackets, so that it can be seen without colours.
    `empty` is shown if there are no rows, `legend` where there is room; rows with a `strong` key
    stand out. `passes` says which rows a filter shows: those with all its words, if not given.
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
        Binding("o", "turn", show=False),
        Binding("less_than_sign", "sort(-1)", show=False),
        Binding("greater_than_sign", "sort(1)", show=False),
        Binding("enter", "choose", show=False),
    ]

    @dataclass
    class Chosen(Message):
        """Enter on a row or cell."""

        key: str

    class Marked(Message):
        """Another row or cell is marked, or the marked one has changed."""

    def __init__(
        self,
        columns: Sequence[Column[Row]],
        key: Callable[[Row], str],
        *,
        fixed: int = 1,
        marks_cells: bool = False,
        passes: Callable[[Row, str], bool] | None = None,
    ) -> None:
        super().__init__()
        self._passes = passes or self._has_words
        self._filter, self._none = "", ""
        self.columns = columns
        self._key = key
        self._fixed, self._place = fixed, min(fixed, len(columns) - 1)
        self.marks_cells = marks_cells
        self.empty = self.legend = ""
        self.strong: Collection[str] = ()
        self._all_rows: Sequence[Row] = ()
        self.rows: Sequence[Row] = ()
        self._by = columns[0]
        self._falling = columns[0].falling
        self._cursor = self._top = self._first = 0

    @property
    def selected(self) -> Row | None:
        return self.rows[self._cursor] if self.rows else None

    @property
    def marked(self) -> Column[Row]:
        """The column of the marked cell."""
        return self.columns[self._place]

    def set_columns(self, columns: Sequence[Column[Row]]) -> None:
        """Other columns, for the rows that are set next; the order stays if it can."""
        same = next((column for column in columns if column.title == self._by.title), None)
        self.columns, self._by = columns, same or columns[0]
        self._place = min(max(self._fixed, self._place), len(columns) - 1)
        if same is None:
            self._falling = self._by.falling

    def set_rows(self, rows: Sequence[Row], *, from_top: bool = False) -> None:
        """Rows that sort alike keep this order; `from_top` marks the first, else the mark stays."""
        self._all_rows = rows
        self._arrange(from_top=from_top)

    def narrow(self, text: str, none: str = "nothing passes the filter") -> None:
        """Shows the rows that pass a filter, else why there is `none`; an empty text shows all."""
        self._filter, self._none = text, none
        self._arrange(from_top=True)

    def _has_words(self, row: Row, text: str) -> bool:
        words = " ".join(column.cell(row).text for column in self.columns).casefold()
        return all(word in words for word in text.casefold().split())

    def mark(self, row: int, column: int | None = None) -> None:
        """Marks a row, as they are sorted now, and one of its cells."""
        self._cursor = min(max(0, row), max(0, len(self.rows) - 1))
        if column is not None:
            self._place = min(max(self._fixed, column), len(self.columns) - 1)
        self.post_message(self.Marked())
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        return self.page(width, self.room.height)

    def page(self, width: int, height: int) -> list[Line]:
        layout = self._layout(width)
        room = max(1, height - _AROUND)
        self._top = min(self._top, self._cursor, max(0, len(self.rows) - room))
        self._top = max(self._top, self._cursor - room + 1)
        in_view = self.rows[self._top : self._top + room]
        body = [
            self._row(row, layout, marked=number == self._cursor)
            for number, row in enumerate(in_view, self._top)
        ]
        if not body:
            body = [line(Span(f"  {self._none if self._all_rows else self.empty}", Tone.DIM))]
        blank: list[Line] = [()] * (room - len(body))
        return [self._header(layout), *body, *blank, self._foot(layout, len(in_view), width)]

    @property
    def copied(self) -> str:
        """The heads and the marked row, all columns, separated by tabs."""
        if self.selected is None:
            return ""
        cells = (column.cell(self.selected).text for column in self.columns)
        return "\n".join(map("\t".join, ((column.title for column in self.columns), cells)))

    def action_move(self, step: int) -> None:
        self.mark(self._cursor + step)

    def action_page(self, step: int) -> None:
        self.mark(self._cursor + step * max(1, self.room.height - _AROUND))

    def action_end(self, last: bool) -> None:
        self.mark(len(self.rows) if last else 0)

    def action_columns(self, step: int) -> None:
        if self.marks_cells:
            self.mark(self._cursor, self._place + step)
            return
        self._first = self._layout(self.room.width).before + step
        self.redraw()

    def action_turn(self) -> None:
        self.sort_by(self._by, falling=not self._falling)

    def action_sort(self, step: int) -> None:
        """Sorts by the column beside, and shows it."""
        place = (self.columns.index(self._by) + step) % len(self.columns)
        self._first = max(0, place - self._fixed)
        self.sort_by(self.columns[place])

    def sort_by(self, column: Column[Row], *, falling: bool | None = None) -> None:
        """Sorts by a column, from the top; without `falling`, the way that is usual for it."""
        self._by = column
        self._falling = column.falling if falling is None else falling
        self._arrange(from_top=True)

    def action_choose(self) -> None:
        if self.selected is not None:
            self.post_message(self.Chosen(self._key(self.selected)))

    def on_click(self, event: events.Click) -> None:
        """Marks the row under the mouse; a double click opens it."""
        offset = event.get_content_offset(self)
        shown = min(len(self.rows) - self._top, self.room.height - _AROUND)
        if offset is not None and 1 <= offset.y <= shown:
            self.mark(self._top + offset.y - 1)
            if event.chain == 2:
                self.action_choose()

    def take_click(self, target: str, event: events.Click) -> None:
        """A head sorts by its column, again it turns the order; a cell is marked."""
        title = target.removeprefix(_SORTS)
        column = next((column for column in self.columns if column.title == title), None)
        if column is None:
            super().take_click(target, event)
        elif title == target:
            self.mark(self._cursor, self.columns.index(column))
        else:
            self.sort_by(column, falling=not self._falling if column is self._by else None)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.action_move(_WHEEL)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_move(-_WHEEL)

    def _arrange(self, *, from_top: bool) -> None:
        marked = None if self.selected is None else self._key(self.selected)
        value, rows = self._by.value, self._all_rows
        if self._filter:
            rows = [row for row in rows if self._passes(row, self._filter)]
        valued = [(cell, row) for row in rows if (cell := value(row)) is not None]
        valued.sort(key=lambda pair: pair[0], reverse=self._falling)
        missing = [row for row in rows if value(row) is None]
        self.rows = [*(row for _, row in valued), *missing]
        keys = (number for number, row in enumerate(self.rows) if self._key(row) == marked)
        self.mark(0 if from_top else next(keys, self._cursor))

    def _layout(self, width: int) -> ColumnLayout[Row]:
        """The columns in view: those of before, or the next that show the marked cell."""
        room = width - 2 * GAP - self.marks_cells  # mark or opening bracket; closing bracket
        first = self._first
        if self.marks_cells:
            first = max(0, min(first, self._place - self._fixed))
        layout = lay_out(self.columns, self._fixed, first, room)
        while self.marks_cells and all(column is not self.marked for column, _ in layout.shown):
            layout = lay_out(self.columns, self._fixed, layout.before + 1, room)
        self._first = layout.before
        return layout

    def _header(self, layout: ColumnLayout[Row]) -> Line:
        spans = [Span(" " * GAP)]
        for column, width in layout.shown:
            sorts = column is self._by
            arrow = ("▼" if self._falling else "▲") if sorts else ""
            text = column.fit(column.title[: width - len(arrow)] + arrow, width)
            tone = Tone.STRONG if sorts else Tone.DIM
            spans += [Span(" " * GAP), Target(text, tone, f"{_SORTS}{column.title}")]
        return tuple(spans)

    def _row(self, row: Row, layout: ColumnLayout[Row], *, marked: bool) -> Line:
        here = self.marked if marked and self.marks_cells else None
        whole = marked and not self.marks_cells
        spans = [Span(">" if whole else " ", Tone.STRONG)]
        gap_tone = Tone.CURSOR if whole and self.has_focus else Tone.PLAIN
        closing, strong = " ", self._key(row) in self.strong
        for column, width in layout.shown:
            text, tone = column.cell(row)
            if strong and tone is Tone.PLAIN:
                tone = Tone.STRONG
            if self.has_focus and (whole or column is here) and tone not in (Tone.WARN, Tone.BAD):
                tone = Tone.CURSOR
            gap = "[" if column is here else closing
            closing = "]" if column is here else " "
            spans += [Span(gap, gap_tone), Target(column.fit(text, width), tone, column.title)]
        return (*spans, Span(closing)) if closing == "]" else tuple(spans)

    def _foot(self, layout: ColumnLayout[Row], shown: int, width: int) -> Line:
        where = f"{self._top + 1}-{self._top + shown} of {len(self.rows)}" if shown else "none"
        if self._filter:
            where += f", filtered from {len(self._all_rows)} (Escape shows all)"
        left = f"<- {layout.before} " if layout.before else ""
        right = f" {layout.after} ->" if layout.after else ""
        more = f"{left}columns{right}" if left or right else ""
        room = width - len(more) - GAP
        text = f"  {where}, by {self._by.meaning}"
        if cell_len(legend := f"{text}   {self.legend}") <= room:
            text = legend
        keys = {"<-": "left", "->": "right", "(Escape shows all)": "escape"}
        return with_keys([line(Span(f"{fitted(text, room)} {more}", Tone.DIM))], keys)[0]
