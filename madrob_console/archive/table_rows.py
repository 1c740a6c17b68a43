"""Tables as files and as DataFrames, and the samples of a run that tables are made of."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, TypeAlias, TypeVar
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from madrob_console.archive.collection import collected
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_record import RunLabel
from madrob_console.archive.scored import Scored, score_with_series
from madrob_console.archive.stored_runs import StoredRun, stored_run
from madrob_console.archive.table_columns import (
    RUN,
    RUN_TABLES,
    SAMPLE_TABLES,
    CellKind,
    Row,
    TidyTable,
    rows_of,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.common.names import table_cell, terminal_safe
from scoring.indicator_table import RulesetName
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, Condition, PassageSensor
from scoring.result import Result
from scoring.series import WholeSeries

if TYPE_CHECKING:
    from pandas import DataFrame

_Read = TypeVar("_Read")

_ROWS_AT_ONCE = 2_000

Cells: TypeAlias = "NDArray[Any] | Sequence[object]"
"""Cells of one column; None, and NaN among numbers, are empty."""


class Sink(Protocol):
    """Takes the bytes of a table."""

    def write(self, data: bytes, /) -> object: ...


class TableWriter:
    """Writes one table in batches of rows; only one batch is in memory.

    Numbers keep all digits: the shortest that read back as the same float64.
    """

    def __init__(self, file: Sink, table: TidyTable) -> None:
        self._file = file
        self._table = table
        self._names = [column.name for column in table.columns]
        self._rows: list[Row] = []
        self._write_csv([self._names])

    def write_rows(self, rows: Iterable[Row]) -> None:
        self._rows += rows
        if len(self._rows) >= _ROWS_AT_ONCE:
            self._flush()

    def write_cells(self, cells: Mapping[str, Cells]) -> None:
        """Writes whole columns of one length."""
        for begin in range(0, len(cells[self._names[0]]), _ROWS_AT_ONCE):
            end = begin + _ROWS_AT_ONCE
            self._write_batch({name: cells[name][begin:end] for name in self._names})

    def close(self) -> None:
        """Writes what belongs at the end; a table without rows still has its columns."""
        self._flush()

    def _flush(self) -> None:
        if self._rows:
            self._write_batch({name: [row[name] for row in self._rows] for name in self._names})
            self._rows = []

    def _write_batch(self, cells: Mapping[str, Cells]) -> None:
        plain = (_plain(column.kind, cells[column.name]) for column in self._table.columns)
        self._write_csv(zip(*map(_no_formulas, plain), strict=True))

    def _write_csv(self, rows: Iterable[Iterable[object]]) -> None:
        text = StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        self._file.write(text.getvalue().encode())


def write_table(path: Path, table: TidyTable, cells: Mapping[str, Cells]) -> None:
    """Writes a table whole or not at all, over an earlier file; MadrobError if the disk refuses."""
    with whole_file(path) as file, closing(TableWriter(file, table)) as writer:
        writer.write_cells(cells)


def _plain(kind: CellKind, cells: Cells) -> list[object]:
    values = cells.tolist() if isinstance(cells, np.ndarray) else cells
    empty = "" if kind is CellKind.TEXT else None
    return [empty if value is None or value != value else _CELLS[kind](value) for value in values]  # noqa: PLR0124  NaN


def _no_formulas(cells: Iterable[object]) -> Iterator[object]:
    return (table_cell(cell) if isinstance(cell, str) else cell for cell in cells)


_CELLS: Mapping[CellKind, Callable[[Any], object]] = {
    CellKind.TEXT: lambda text: terminal_safe(str(text)),  # paths among them
    CellKind.COUNT: int,
    CellKind.NUMBER: float,
    CellKind.FLAG: bool,
}


@dataclass(frozen=True, slots=True)
class SampledRun:
    """A scored run with all of its samples; the tables call it `name`."""

    name: str
    scored: Scored
    series: WholeSeries
    label: RunLabel

    @classmethod
    def of(cls, run: RunPath, rules: RulesetName | None = None) -> Self:
        """Scores a run by `rules` (None = its own); MadrobError if it cannot be."""
        run.demand_recording()
        scored, series = score_with_series(run.path, rules)
        return cls(run.own_name, scored, series, scored.record.label)

    @property
    def result(self) -> Result:
        return self.scored.result

    @property
    def practice(self) -> bool:
        return self.scored.record.setup.practice

    @property
    def condition(self) -> Condition:
        return self.scored.record.setup.condition

    @property
    def present_height(self) -> float:
        return self.scored.record.thresholds.present_height

    @property
    def door_jerk(self) -> Array:
        rows = self.series.rows
        jerk = np.full(rows.joint_state.time.size, np.nan)
        jerk[np.searchsorted(rows.joint_state.time, rows.jerk_time)] = rows.jerk  # at some of them
        return jerk

    @property
    def passage_sensors(self) -> Iterator[PassageSensor]:
        """The sensor of each row."""
        return (PASSAGE_SENSORS[place] for place in self.series.passage.sensor.tolist())

    def columns_of(self, table: TidyTable) -> Mapping[str, Cells]:
        row: Mapping[str, Any] = table.row_of(self)
        return {name: [cell] for name, cell in row.items()} if table is RUN else row


class Frames(Mapping[str, "DataFrame"]):
    """The tables of the runs at a path by name, each made when it is first asked for.

    Those of samples score each run from its recording. What cannot be read is warned of.
    """

    _tables: ClassVar = {table.name: table for table in (*RUN_TABLES, *SAMPLE_TABLES)}

    def __init__(self, path: Path) -> None:
        collection = collected([path])
        for unlisted in collection.unlisted:
            warn(f"{unlisted.place} {unlisted.why}", stacklevel=3)
        self._runs = [
            RunPath(collection.root / run.folder) for run in collection.runs if not run.twin
        ]
        self._frames: dict[str, DataFrame] = {}

    def __iter__(self) -> Iterator[str]:
        return iter((*self._tables, "samples"))

    def __len__(self) -> int:
        return len(self._tables) + 1

    def __getitem__(self, name: str) -> DataFrame:
        if name not in self._frames:
            self._frames[name] = self._all_samples() if name == "samples" else self._frame(name)
        return self._frames[name]

    def _frame(self, name: str) -> DataFrame:
        from pandas import DataFrame, Series

        table, cells = self._tables[name], defaultdict[str, list[object]](list)
        for part in self._parts(table):
            for column, values in part.items():
                cells[column].extend(values)
        series = {
            column.name: Series(_plain(column.kind, cells[column.name]), dtype=column.kind.value)
            for column in table.columns
        }
        return DataFrame(series)

    def _parts(self, table: TidyTable) -> Iterator[Mapping[str, Cells]]:
        if table in SAMPLE_TABLES:
            return (run.columns_of(table) for run in self._sampled)
        rows = (row for run in self._stored for row in rows_of(table, run))
        return ({name: [cell] for name, cell in row.items()} for row in rows)

    def _all_samples(self) -> DataFrame:
        """What was measured, a row for each reading of a sensor."""
        from pandas import concat

        sensors = self["passage"].strip + "_" + self["passage"].element.astype("str")
        of = {"door": "position", "handle": "force", "passage": "range", "latch": "engaged"}
        return concat(
            self[name][["run", "time", "since_start"]].assign(
                signal=sensors if name == "passage" else name,
                value=self[name][column].astype("float64"),
            )
            for name, column in of.items()
        ).reset_index(drop=True)

    @cached_property
    def _stored(self) -> list[StoredRun]:
        return [*self._each(stored_run)]

    @cached_property
    def _sampled(self) -> list[SampledRun]:
        return [*self._each(SampledRun.of)]

    def _each(self, read: Callable[[RunPath], _Read]) -> Iterator[_Read]:
        for run in self._runs:
            try:
                yield read(run)
            except MadrobError as error:
                warn(str(error), stacklevel=2)
