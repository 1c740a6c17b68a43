"""Columns of a EUROBENCH CSV file; errors name file, line and column."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.protocol import ScoringError


@dataclass(frozen=True, slots=True)
class CsvTable:
    """The columns asked for; `lines` are each row's line numbers in the file."""

    name: str
    lines: tuple[int, ...]
    cells: Mapping[str, tuple[str, ...]]

    def numbers(self, column: str, *, optional: bool = False) -> NDArray[np.float64]:
        """A column of finite numbers; `optional`: empty or `nan` cells are NaN, not an error."""
        values = np.empty(len(self.lines))
        for row, cell in enumerate(self.cells[column]):
            value = math.nan if optional and cell.lower() in ("", "nan") else _finite(cell)
            if value is None:
                raise self.error(row, column, f"{cell[:40]!r} is no finite number: correct it")
            values[row] = value
        return values

    def times(self, *, repeats: bool = False) -> NDArray[np.float64]:
        """Increasing times, s; `repeats` allows a time equal to the row before."""
        times = self.numbers("time")
        before, after = times[:-1], times[1:]
        for row in np.flatnonzero(after < before if repeats else after <= before)[:1].tolist():
            words = "does not come after the row before: sort the rows, drop repeated times"
            raise self.error(row + 1, "time", f"{times[row + 1]} {words}")
        return times

    def error(self, row: int, column: str, words: str) -> ScoringError:
        return ScoringError(f"{self.name}, line {self.lines[row]}, column {column}: {words}")


def parse_table(name: str, text: str, columns: Sequence[str]) -> CsvTable:
    """The given columns of a table with a header line, comma or semicolon between the cells.

    Blanks around cells, empty lines, other columns and any order of columns are allowed.
    `ScoringError` names the line that is wrong.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    delimiter = ";" if ";" in first else ","
    reader = csv.reader(io.StringIO(text, newline=None), delimiter=delimiter, skipinitialspace=True)
    try:
        rows = [
            (reader.line_num, [cell.strip() for cell in row])
            for row in reader
            if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise ScoringError(
            f"{name}, line {reader.line_num}: is no CSV ({error}): correct it"
        ) from None
    if not rows:
        raise ScoringError(f"{name}: is empty: write it again, header line included")
    (header_line, header), *body = rows
    places = _places(f"{name}, line {header_line}", header, columns)
    for line, cells in body:
        _check_width(f"{name}, line {line}", cells, header)
    return CsvTable(
        name,
        tuple(line for line, _ in body),
        {column: tuple(cells[place] for _, cells in body) for column, place in places.items()},
    )


def _places(place: str, header: list[str], columns: Sequence[str]) -> dict[str, int]:
    for column in columns:
        if header.count(column) != 1:
            fault = "there more than once" if column in header else "missing"
            raise ScoringError(
                f"{place}, column {column}: is {fault}: give the header {','.join(columns)}"
            )
    return {column: header.index(column) for column in columns}


def _check_width(place: str, cells: list[str], header: list[str]) -> None:
    """Refuse a row with too few cells, or more of them than the header (unless empty)."""
    if len(cells) < len(header):
        column, fault = header[len(cells)], "is missing"
    elif any(cells[len(header) :]):
        column, fault = str(len(header) + 1), "is not in the header"
    else:
        return
    raise ScoringError(f"{place}, column {column}: {fault}: give {len(header)} cells in every row")


def _finite(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in cell else None
