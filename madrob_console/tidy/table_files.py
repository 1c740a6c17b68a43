"""Tables written to files, csv or Parquet, by pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from madrob_console.errors import MadrobError
from madrob_console.files.whole import whole_file
from madrob_console.tidy.tidy_table import TableFormat, TidyColumn, TidyTable

if TYPE_CHECKING:
    import pandas as pd


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
    if kind is TableFormat.CSV:
        return
    import pandas as pd

    try:
        pd.DataFrame().to_parquet(BytesIO(), engine="pyarrow")
    except ImportError:
        raise MadrobError(
            "Parquet needs pyarrow, which is not there or too old: install madrob-console with its "
            "extra `tables`, or write csv"
        ) from None


def write_table(
    path: Path, table: TidyTable, cells: Mapping[str, Cells], kind: TableFormat
) -> None:
    """Write one table, whole or not at all; an earlier file is replaced.

    Numbers keep all their digits: in csv the shortest that read back as the same float64.

    Args:
        path: of the file.
        table: which.
        cells: by column.
        kind: csv or Parquet, which has meaning and unit of the columns in its metadata.

    Raises:
        MadrobError: the disk refuses.
    """
    import pandas as pd

    frame = pd.DataFrame({one.name: _column(one, cells[one.name]) for one in table.columns})
    with whole_file(path) as file:
        if kind is TableFormat.CSV:
            frame.to_csv(file, index=False, lineterminator="\n", mode="wb", encoding="utf-8")
        else:
            frame.attrs = {one.name: f"{one.meaning} [{one.unit or '-'}]" for one in table.columns}
            frame.to_parquet(file, engine="pyarrow", index=False)


def _column(column: TidyColumn, cells: Cells) -> pd.Series[Any]:
    import pandas as pd

    if isinstance(cells, Chosen):
        return pd.Series(pd.Categorical.from_codes(cells.places, pd.Index(cells.texts)))
    if isinstance(cells, np.ma.MaskedArray):
        missing = np.ma.getmaskarray(cells)
        return pd.Series(pd.arrays.BooleanArray(cells.data.astype(np.bool_), missing))
    return pd.Series(cells, dtype=column.kind.value)
