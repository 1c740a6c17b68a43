"""Tables written to files, csv, NDJSON or Parquet, by pandas."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from madrob_console.errors import MadrobError
from madrob_console.files.whole import whole_file
from madrob_console.names import valid_text
from madrob_console.tidy.tidy_table import CellKind, TableFormat, TidyColumn, TidyTable

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow.parquet as pq

_encoder = msgspec.json.Encoder(enc_hook=lambda cell: cell.item())  # NumPy's scalars


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Cells that are each one of few texts.

    Attributes:
        places: of each cell's text, shape (n,).
        texts: the texts.
    """

    places: NDArray[np.int8]
    texts: tuple[str, ...]


Cells: TypeAlias = "NDArray[Any] | Sequence[object] | Chosen"
"""Of one column; what is masked or None is empty, and so is NaN among numbers."""


def check_writable(kind: TableFormat) -> None:
    """Refuse a format that cannot be written here, before there is any work.

    Raises:
        MadrobError: what it needs is not installed.
    """
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
    """Writes one table, some rows after the other: only these are in memory.

    Numbers keep all their digits: in csv and NDJSON the shortest that read back as the same
    float64. An NDJSON file has a JSON object on each line, null for an empty cell, and the texts
    "inf" and "-inf" for what JSON has no number for.

    Args:
        file: where they go.
        table: which.
        kind: csv, NDJSON or Parquet, which has meaning and unit of the columns in its metadata.
    """

    def __init__(self, file: BinaryIO, table: TidyTable, kind: TableFormat) -> None:
        self._file = file
        self._table = table
        self._kind = kind
        self._parquet: pq.ParquetWriter | None = None
        self._begun = False

    def add(self, cells: Mapping[str, Cells]) -> None:
        """Write more rows.

        Args:
            cells: by column.
        """
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
        """Write what belongs at the end; a table without rows has its columns."""
        if not self._begun and self._kind is not TableFormat.NDJSON:
            self.add({one.name: [] for one in self._table.columns})
        if self._parquet is not None:
            self._parquet.close()


def write_table(
    path: Path, table: TidyTable, cells: Mapping[str, Cells], kind: TableFormat
) -> None:
    """Write one table, whole or not at all; an earlier file is replaced.

    Args:
        path: of the file.
        table: which.
        cells: by column.
        kind: as for `TableWriter`.

    Raises:
        MadrobError: the disk refuses.
    """
    with whole_file(path) as file, closing(TableWriter(file, table, kind)) as writer:
        writer.add(cells)


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
