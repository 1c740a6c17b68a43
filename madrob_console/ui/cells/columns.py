"""Columns of a table: what they show, how they sort, which of them fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from rich.cells import cell_len

from madrob_console.names import terminal_safe
from madrob_console.ui.cells.lines import Span
from madrob_console.ui.look.words import fitted

Row = TypeVar("Row")

GAP = 1
"""Cells between two columns."""

ROOMY = 106
"""A table of so many cells has room for comfort."""


@dataclass(frozen=True, slots=True, eq=False)
class Column(Generic[Row]):
    """One column.

    Attributes:
        title: in the header.
        meaning: in words, with the unit.
        cell: what a row shows.
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

    Args:
        columns: in order.
        fixed: how many of them stay in view on the left; fewer where nothing else would fit.
        first: the first of the others that is wanted in view.
        width: cells.
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
