"""Columns of a table: what they show, how they sort, which of them fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from rich.cells import cell_len

from madrob_console.common.names import terminal_safe
from madrob_console.ui.cells.lines import Span
from madrob_console.ui.look.words import fitted

Row = TypeVar("Row")

GAP = 1
"""Cells between two columns."""

USUAL = 76
"""Cells of the columns in a terminal of 80."""


@dataclass(frozen=True, slots=True, eq=False)
class Column(Generic[Row]):
    """One column.

    Attributes:
        meaning: in words, with the unit.
        value: by what a row sorts: a number or a text; None = missing, always last.
        width: cells, with room for the arrow beside the title.
        ample: cells where the other columns leave room; 0 = `width`.
        right: numbers stand on the right.
        falling: it sorts from the largest first.
    """

    title: str
    meaning: str
    cell: Callable[[Row], Span]
    value: Callable[[Row], float | str | None]
    width: int
    ample: int = 0
    right: bool = False
    falling: bool = False

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
    """

    shown: Sequence[tuple[Column[Row], int]]
    before: int
    after: int


def lay_out(
    columns: Sequence[Column[Row]], fixed: int, first: int, width: int
) -> ColumnLayout[Row]:
    """Which columns fit into `width` cells.

    `fixed` of them stay in view on the left; fewer if nothing else would fit. `first` is the
    first of the others that is wanted in view. Ample columns take what is left, and those that
    are fixed a sixth of what a usual terminal does not have.
    """
    sizes = {column: column.width for column in columns}

    def taken(some: Sequence[Column[Row]]) -> int:
        return sum(sizes[column] + GAP for column in some)

    def grow(some: Sequence[Column[Row]], room: int) -> None:
        for column in some:
            more = max(0, min(room, column.ample - sizes[column]))
            sizes[column] += more
            room -= more

    fixed = min(fixed, len(columns) - 1)
    widest = max(sizes.values())
    while fixed and taken(columns[:fixed]) + widest > width:
        fixed -= 1
    grow(columns[:fixed], min((width - USUAL) // 6, width - taken(columns[:fixed]) - widest))
    others = columns[fixed:]
    room = width - taken(columns[:fixed]) + GAP
    last_first = len(others) - 1
    while last_first and taken(others[last_first - 1 :]) <= room:
        last_first -= 1
    first = min(max(0, first), last_first)
    end = first + 1
    while end < len(others) and taken(others[first : end + 1]) <= room:
        end += 1
    shown = [*columns[:fixed], *others[first:end]]
    grow(shown, width + GAP - taken(shown))
    sized = [(column, sizes[column]) for column in shown]
    return ColumnLayout(sized, first, len(others) - end)
