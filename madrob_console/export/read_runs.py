"""The rows of stored runs: each result is read once, and of duplicates one counts."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import msgspec

from madrob_console.archive.collection import demand_competition, demand_testbed
from madrob_console.archive.folders import (
    NO_FILES,
    FoundRun,
    RunPath,
    RunPlace,
    is_run_name,
    places_that_count,
    run_stamps,
)
from madrob_console.archive.history_index import HistoryIndex
from madrob_console.archive.result_files import stored_run
from madrob_console.common.errors import MadrobError
from madrob_console.common.version import software_version
from madrob_console.export.table_columns import Row, TidyTable, rows_of

_AT_ONCE = 500
"""Runs whose rows are looked up and stored in the index together."""


class _Rows(msgspec.Struct, frozen=True, array_like=True):
    """The rows of a run as the index keeps them."""

    run_id: str
    practice: bool
    issue: int
    testbed: str
    competition: str
    cells: tuple[tuple[Any, ...], ...] = ()


class _ReadRun(NamedTuple):
    found: FoundRun
    told: _Rows
    begin: int
    size: int

    @property
    def place(self) -> RunPlace:
        told = self.told
        return RunPlace(self.found.run.name, told.run_id, told.practice, told.issue)


class ReadRuns:
    """The runs of a table, whose rows wait in a (temporary) file.

    Which of two duplicates counts is known only after the last run.
    """

    def __init__(self, table: TidyTable, file: BinaryIO) -> None:
        self._table = table
        self._names = [column.name for column in table.columns]
        self._file = file
        self._runs: list[_ReadRun] = []
        self._decoder = msgspec.msgpack.Decoder(_Rows)

    def add_runs(self, runs: Iterable[FoundRun]) -> Iterator[str | None]:
        """Reads the result of each run that the index does not have; why it cannot, in words."""
        for root, within in groupby(runs, key=lambda run: run.place[0]):
            index = HistoryIndex(root, f"table_{self._table.name}", software_version())
            while some := list(islice(within, _AT_ONCE)):
                yield from self._add_some(root, index, some)

    def _add_some(
        self, root: Path, index: HistoryIndex, runs: Sequence[FoundRun]
    ) -> Iterator[str | None]:
        folders = [run.place[1] for run in runs]
        kept = {folder: (stamps, rows) for folder, stamps, rows in index.read(folders)}
        fresh = []
        for run, folder, now in zip(runs, folders, run_stamps(root, folders), strict=True):
            stamps, packed = kept.get(folder, (b"", b""))
            try:
                if now == NO_FILES or stamps != now:
                    packed = self._packed(run.run)
                    if now != NO_FILES and is_run_name(run.folder):
                        fresh.append((folder, now, packed))
                self._add_rows(run, packed)
                yield None
            except MadrobError as error:
                yield str(error)
        if fresh:
            index.store(fresh)

    def _packed(self, run: RunPath) -> bytes:
        stored = stored_run(run)
        place, label = stored.place(run.name), stored.label
        cells = tuple(tuple(row.values()) for row in rows_of(self._table, stored))
        told = (place.run_id, place.practice, place.issue, label.testbed, label.competition, cells)
        return msgspec.msgpack.encode(told)

    def _add_rows(self, run: FoundRun, packed: bytes) -> None:
        rows = self._decoder.decode(packed)
        texts = sys.intern(rows.testbed), sys.intern(rows.competition)
        told = _Rows(rows.run_id, rows.practice, rows.issue, *texts)
        self._runs.append(_ReadRun(run, told, self._file.tell(), len(packed)))
        self._file.write(packed)

    @property
    def twins(self) -> list[tuple[str, str]]:
        """Each place that does not count, and the one that counts instead."""
        counting = self._counting()
        if not counting:
            return []
        named = ((run.place.name, counting.get(run.told.run_id)) for run in self._runs)
        return [(name, other) for name, other in named if other and other != name]

    def chosen(self, testbed: str | None, competition: str | None) -> Iterator[list[Row]]:
        """The rows of each run that counts; MadrobError where no run is of these names."""
        if testbed is not None:
            demand_testbed(testbed, {run.told.testbed for run in self._runs})
        if competition is not None:
            demand_competition(competition, {run.told.competition for run in self._runs})
        return self._rows(testbed, competition)

    def _rows(self, testbed: str | None, competition: str | None) -> Iterator[list[Row]]:
        counting = self._counting()
        for run in self._runs:
            told, place = run.told, run.found.run.name
            counts = counting.get(told.run_id, place) == place
            wanted = testbed in (None, told.testbed) and competition in (None, told.competition)
            if counts and wanted:
                self._file.seek(run.begin)
                packed = self._decoder.decode(self._file.read(run.size))
                rows = (dict(zip(self._names, cells, strict=True)) for cells in packed.cells)
                # the index does not know by which path somebody names its folder
                yield [{**row, "place": place} if "place" in row else row for row in rows]

    def _counting(self) -> dict[str, str]:
        known = [run.told.run_id for run in self._runs if run.told.run_id]
        if len(set(known)) == len(known):  # as nearly always, and many places take their time
            return {}
        return places_that_count(run.place for run in self._runs)
