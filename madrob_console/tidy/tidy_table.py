"""What a table for programs is: its columns, each with its type, its unit and what it means."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum


class TableFormat(StrEnum):
    """How tables are written."""

    CSV = "csv"
    NDJSON = "ndjson"
    PARQUET = "parquet"


class CellKind(Enum):
    """What the cells of a column are; the value is pandas' name of the type.

    A cell may be empty, but in a column of texts.
    """

    TEXT = "str"
    COUNT = "Int64"
    NUMBER = "float64"
    FLAG = "boolean"


@dataclass(frozen=True, slots=True)
class TidyColumn:
    """One column.

    Attributes:
        name: in the header.
        kind: of its cells.
        unit: of a number; empty = none.
        meaning: in words, also of an empty cell.
    """

    name: str
    kind: CellKind
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class TidyTable:
    """One table.

    Attributes:
        name: how its files end.
        row: what one row is.
        columns: from left to right.
    """

    name: str
    row: str
    columns: Sequence[TidyColumn]


def column_lines(tables: Sequence[TidyTable]) -> Iterator[str]:
    """What a help text says of the tables: a line for each column, below its table."""
    every = [column for table in tables for column in table.columns]
    names = max(len(column.name) for column in every)
    units = max(len(column.unit) for column in every)
    for table in tables:
        yield f"  {table.name}: {table.row}"
        for one in table.columns:
            yield f"    {one.name:<{names}}  {one.unit:<{units}}  {one.meaning}"
