"""The rows of tables, and the files that they are written to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from madrob_console.archive.result_files import StoredRun
from madrob_console.archive.run_record import RunLabel
from madrob_console.archive.scored import Scored
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.common.names import valid_text
from madrob_console.export.table_columns import (
    DOOR,
    EVENTS,
    HANDLE,
    INDICATORS,
    LATCH,
    PASSAGE,
    RUN,
    RUNS,
    STEPS,
    CellKind,
    TableFormat,
    TidyColumn,
    TidyTable,
)
from madrob_console.referee.flags import undecided
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, Condition, Side, Strip
from scoring.rulesets import ruleset
from scoring.series import PassageSeries, WholeSeries

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow.parquet as pq

# Writing tables as csv, NDJSON or Parquet, by pandas.


_encoder = msgspec.json.Encoder(enc_hook=lambda cell: cell.item())  # NumPy's scalars


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Cells with few distinct texts: each cell's index into `texts`, shape (n,)."""

    places: NDArray[np.int8]
    texts: tuple[str, ...]


Cells: TypeAlias = "NDArray[Any] | Sequence[object] | Chosen"
"""Cells of one column; masked, None, and NaN among numbers are empty."""


def check_writable(kind: TableFormat) -> None:
    """Raises MadrobError, before any work, if a package that the format needs is missing."""
    if kind is not TableFormat.PARQUET:
        return
    import pandas as pd

    try:
        pd.DataFrame().to_parquet(BytesIO(), engine="pyarrow")
    except ImportError:
        raise MadrobError(
            "Parquet needs pyarrow, which is not there or too old: install madrob-console with its "
            "extra `tables`, or write csv"
        ) from None


class TableWriter:
    """Writes one table in batches of rows; only one batch is in memory.

    Numbers keep all digits: csv and NDJSON have the shortest that read back as the same
    float64. NDJSON has an object on each line, null for an empty cell, and the texts "inf"
    and "-inf". Parquet has meaning and unit of the columns in its metadata.
    """

    def __init__(self, file: BinaryIO, table: TidyTable, kind: TableFormat) -> None:
        self._file = file
        self._table = table
        self._kind = kind
        self._parquet: pq.ParquetWriter | None = None
        self._begun = False

    def write_rows(self, cells: Mapping[str, Cells]) -> None:
        import pandas as pd

        columns = self._table.columns
        frame = pd.DataFrame({one.name: _column(one, cells[one.name]) for one in columns})
        match self._kind:
            case TableFormat.CSV:
                form: dict[str, Any] = {"lineterminator": "\n", "mode": "wb", "encoding": "utf-8"}
                frame.to_csv(self._file, index=False, header=not self._begun, **form)
            case TableFormat.NDJSON:
                rows = zip(*(_json_values(frame[name]) for name in frame), strict=True)
                lines = [dict(zip(frame, row, strict=True)) for row in rows]
                self._file.write(_encoder.encode_lines(lines))
            case TableFormat.PARQUET:
                self._add_parquet(frame)
        self._begun = True

    def _add_parquet(self, frame: pd.DataFrame) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        if self._parquet is None:
            columns = self._table.columns
            told = {one.name: f"{one.meaning} [{one.unit or '-'}]" for one in columns}
            schema = pa.Schema.from_pandas(frame, preserve_index=False)
            for place, one in enumerate(columns):  # without rows pandas knows no type of texts
                if one.kind is CellKind.TEXT and pa.types.is_null(schema.field(place).type):
                    schema = schema.set(place, pa.field(one.name, pa.string()))
            attributes = {b"PANDAS_ATTRS": msgspec.json.encode(told)}
            schema = schema.with_metadata({**(schema.metadata or {}), **attributes})
            self._parquet = parquet.ParquetWriter(self._file, schema)
        schema = self._parquet.schema
        self._parquet.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False))

    def close(self) -> None:
        """Writes what belongs at the end; a table without rows still has its columns."""
        if not self._begun and self._kind is not TableFormat.NDJSON:
            self.write_rows({one.name: [] for one in self._table.columns})
        if self._parquet is not None:
            self._parquet.close()


def write_table(
    path: Path, table: TidyTable, cells: Mapping[str, Cells], kind: TableFormat
) -> None:
    """Writes a table whole or not at all, over an earlier file; MadrobError if the disk refuses."""
    with whole_file(path) as file, closing(TableWriter(file, table, kind)) as writer:
        writer.write_rows(cells)


def _json_values(cells: pd.Series[Any]) -> list[object]:
    plain = cells.astype(object).where(cells.notna(), None).tolist()
    return [str(cell) if isinstance(cell, float) and math.isinf(cell) else cell for cell in plain]


def _column(column: TidyColumn, cells: Cells) -> pd.Series[Any]:
    import pandas as pd

    if isinstance(cells, Chosen):
        return pd.Series(pd.Categorical.from_codes(cells.places, pd.Index(cells.texts)))
    if isinstance(cells, np.ma.MaskedArray):
        missing = np.ma.getmaskarray(cells)
        return pd.Series(pd.arrays.BooleanArray(cells.data.astype(np.bool_), missing))
    if column.kind is CellKind.TEXT:  # paths among them
        cells = [valid_text(cell) if isinstance(cell, str) else cell for cell in cells]
    return pd.Series(cells, dtype=column.kind.value)


Row: TypeAlias = Mapping[str, object]
"""Cells of a row by column."""

_ROWS_AT_ONCE = 2_000


def rows_of(table: TidyTable, run: StoredRun) -> Iterator[Row]:
    whose = asdict(run.label)
    for row in _MAKERS[table.name](run):
        yield {**whose, **row}


def cells_of(table: TidyTable, rows: Iterable[Row]) -> Mapping[str, Cells]:
    every = list(rows)
    return {column.name: [row[column.name] for row in every] for column in table.columns}


class RowWriter:
    """Writes a table of any number of runs; few rows and those of one run are in memory."""

    def __init__(self, writer: TableWriter, table: TidyTable) -> None:
        self._writer = writer
        self._table = table
        self._rows: list[Row] = []

    def write_rows(self, rows: Iterable[Row]) -> None:
        self._rows += rows
        if len(self._rows) >= _ROWS_AT_ONCE:
            self._flush()

    def close(self) -> None:
        if self._rows:
            self._flush()
        self._writer.close()

    def _flush(self) -> None:
        self._writer.write_rows(cells_of(self._table, self._rows))
        self._rows = []


def task_cells(condition: Condition) -> Row:
    return {
        "benchmark_type": condition.benchmark_type.value,
        "opening_side": condition.opening_side.value,
        "starting_side": condition.starting_side.value,
        "destination_side": condition.destination_side.value,
    }


def _judged(run: StoredRun) -> Row:
    return {
        "practice": run.practice,
        "ruleset": run.result.ruleset,
        "outcome": run.result.outcome.value,
        "valid": run.result.valid,
    }


def _runs(run: StoredRun) -> Iterator[Row]:
    result, closure = run.result, run.result.closure
    found, waiting = result.flags or (), result.open_protest
    yield {
        **_judged(run),
        **task_cells(Condition.from_number(result.condition_number)),
        "folder": run.folder.name,
        "place": str(run.folder),
        "source": result.source or "",
        "lock_detection": result.lock_detection,
        "start": result.start,
        "stop": result.stop,
        "duration": None if result.stop is None else result.stop - result.start,
        "reason": result.outcome_reason,
        "void": result.voided is not None,
        "issue": result.issue,
        "final": closure is not None,
        "team_word": "" if closure is None else closure.team_word,
        "protests": len(result.protests),
        "open_protests": sum(one.answer is None for one in result.protests),
        "protest_due": None if waiting is None else waiting.due,
        "flags": "; ".join(flag.words for flag in found),
        "undecided": len(undecided(found)),
        "sampling_rate": result.rate,
        "software": result.software,
    }


def _indicators(run: StoredRun) -> Iterator[Row]:
    for name, one in run.result.indicators.items():
        known = one.uncertainty
        yield {
            **_judged(run),
            "indicator": name,
            "value": one.value,
            "unit": one.unit,
            "reason": one.reason or "",
            "uncertainty": None if known is None else known.u,
            "expanded_uncertainty": None if known is None else known.expanded,
            "doubts": "; ".join(one.doubts),
        }


def _events(run: StoredRun) -> Iterator[Row]:
    for one in run.result.events:
        told = {"ruleset": run.result.ruleset, "event": one.event}
        yield {**told, "time": one.time, "since_start": one.since_start}


def _steps(run: StoredRun) -> Iterator[Row]:
    for one in run.result.steps:
        done = one.final is not None
        yield {
            "ruleset": run.result.ruleset,
            "step": one.step,
            "name": one.name,
            "done": done,
            "time": one.final,
            "since_start": None if one.final is None else one.final - run.result.start,
            "sensors": one.sensors,
            "referee": None if one.referee is None else one.referee.confirmed,
            "reason": "" if done else one.reason or "",
        }


_MAKERS: Mapping[str, Callable[[StoredRun], Iterator[Row]]] = {
    RUNS.name: _runs,
    INDICATORS.name: _indicators,
    EVENTS.name: _events,
    STEPS.name: _steps,
}


# Rows of the tables of samples, from a scored run and all of its samples.


SampleRows: TypeAlias = Mapping[str, Mapping[str, Cells]]
"""Cells by table, then by column."""


def sample_rows(name: str, scored: Scored, series: WholeSeries, label: RunLabel) -> SampleRows:
    """The tables of one run, which they call `name`; `series` is all that its sensors said."""
    start, thresholds = scored.result.start, scored.record.thresholds

    def timed(time: Array, cells: Mapping[str, Cells]) -> Mapping[str, Cells]:
        return {
            "run": Chosen(np.zeros(time.size, dtype=np.int8), (name,)),
            "time": time,
            "since_start": time - start,
            **cells,
        }

    rows, passage = series.rows, series.passage
    return {
        RUN.name: _run(name, scored, series, label),
        DOOR.name: timed(rows.joint_state.time, _door(series)),
        HANDLE.name: timed(rows.force_time, {"force": rows.force}),
        PASSAGE.name: timed(passage.time, _passage(passage, thresholds.lintel_height)),
        LATCH.name: timed(series.latch_time, {"engaged": series.latch_engaged}),
    }


def _run(name: str, scored: Scored, series: WholeSeries, label: RunLabel) -> Mapping[str, Cells]:
    setup, result, limits = scored.record.setup, scored.result, scored.record.thresholds
    told = {**asdict(label), "run_number": label.run, **task_cells(setup.condition)}
    return {
        **{column: [cell] for column, cell in told.items()},
        "run": [name],
        "practice": [setup.practice],
        "ruleset": [result.ruleset.value],
        "lock_detection": [result.lock_detection.value],
        "outcome": [result.outcome.value],
        "start": [result.start],
        "stop": [result.stop],
        "duration": [None if result.stop is None else result.stop - result.start],
        "rows_from": [series.rows_from - result.start],
        "rows_until": [series.rows_until - result.start],
        "handle_zero": [result.handle_zero],
        "touch_force": [limits.touch_force],
        "closed_angle": [limits.closed_angle],
        "lintel_height": [limits.lintel_height],
        "present_height": [ruleset(result.ruleset).present_height or limits.present_height],
        "settle_time": [limits.settle_time],
        "largest_gap": [limits.largest_gap],
    }


def _door(series: WholeSeries) -> Mapping[str, Cells]:
    rows, joint = series.rows, series.rows.joint_state
    jerk = np.full(joint.time.size, np.nan)
    jerk[np.searchsorted(joint.time, rows.jerk_time)] = rows.jerk  # of some of these very times
    return {
        "position": joint.position,
        "velocity": joint.velocity,
        "acceleration": joint.acceleration,
        "low_passed_acceleration": rows.low_passed,
        "jerk": jerk,
    }


def _passage(passage: PassageSeries, lintel_height: float) -> Mapping[str, Cells]:
    def of_sensor(places: list[int]) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
        return np.array(places, dtype=np.int8)[passage.sensor]

    sides, strips = list(Side), list(Strip)
    return {
        "side": Chosen(of_sensor([sides.index(s.side) for s in PASSAGE_SENSORS]), tuple(Side)),
        "index": of_sensor([sensor.index for sensor in PASSAGE_SENSORS]),
        "strip": Chosen(of_sensor([strips.index(s.strip) for s in PASSAGE_SENSORS]), tuple(Strip)),
        "element": of_sensor([sensor.element for sensor in PASSAGE_SENSORS]),
        "range": passage.distance,
        "height": lintel_height - passage.distance,
        "present": np.ma.masked_less(passage.present, 0),
        "masked": passage.masked,
    }
