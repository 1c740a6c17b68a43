"""The rows of stored runs: each result is read once, and of duplicates one counts."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
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
from madrob_console.archive.result_files import StoredRun, stored_run
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


_decoder = msgspec.msgpack.Decoder(_Rows)


def read_rows(
    table: TidyTable, runs: Iterable[FoundRun], read: Callable[[RunPath], StoredRun] = stored_run
) -> Iterator[bytes | MadrobError]:
    """The rows of each run, packed, or why there are none; `read`: a result the index has not."""
    rest = iter(runs)
    while some := list(islice(rest, _AT_ONCE)):
        of_root: dict[Path, list[str]] = defaultdict(list)
        for root, folder in (run.place for run in some):
            of_root[root].append(folder)
        stamps: dict[Path, dict[str, bytes]] = {}
        kept: dict[Path, dict[str, bytes]] = {}
        fresh: dict[Path, list[tuple[str, bytes, bytes]]] = defaultdict(list)
        for root, folders in of_root.items():
            now = stamps[root] = dict(zip(folders, run_stamps(root, folders), strict=True))
            known = _index_of(root, table).read(folders)
            kept[root] = {
                folder: rows for folder, stamp, rows in known if NO_FILES != stamp == now[folder]
            }
        for run in some:
            root, folder = run.place
            try:
                if (rows := kept[root].get(folder)) is None:
                    rows = _packed(table, read(run.run), run.run.name)
                    if is_run_name(run.folder) and stamps[root][folder] != NO_FILES:
                        fresh[root].append((folder, stamps[root][folder], rows))
                yield rows
            except MadrobError as error:
                yield error
        for root, some_rows in fresh.items():
            _index_of(root, table).store(some_rows)


def _index_of(root: Path, table: TidyTable) -> HistoryIndex:
    return HistoryIndex(root, f"table_{table.name}", software_version())


def _packed(table: TidyTable, stored: StoredRun, name: str) -> bytes:
    place, label = stored.place(name), stored.label
    cells = tuple(tuple(row.values()) for row in rows_of(table, stored))
    told = (place.run_id, place.practice, place.issue, label.testbed, label.competition, cells)
    return msgspec.msgpack.encode(told)


def unpacked_rows(table: TidyTable, packed: bytes, place: str) -> Iterator[Row]:
    """The index does not know by which path, `place`, somebody names its folder."""
    names = [column.name for column in table.columns]
    for cells in _decoder.decode(packed).cells:
        row = dict(zip(names, cells, strict=True))
        yield {**row, "place": place} if "place" in row else row


class ReadRuns:
    """The runs of a table, whose rows wait in a (temporary) file.

    Which of two duplicates counts is known only after the last run.
    """

    def __init__(self, table: TidyTable, file: BinaryIO) -> None:
        self._table = table
        self._file = file
        self._runs: list[_ReadRun] = []

    def add_runs(self, runs: Sequence[FoundRun]) -> Iterator[str | None]:
        """Reads the result of each run that the index does not have; why it cannot, in words."""
        for run, packed in zip(runs, read_rows(self._table, runs), strict=True):
            if isinstance(packed, MadrobError):
                yield str(packed)
                continue
            self._add_rows(run, packed)
            yield None

    def _add_rows(self, run: FoundRun, packed: bytes) -> None:
        rows = _decoder.decode(packed)
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
                yield list(unpacked_rows(self._table, self._file.read(run.size), place))

    def _counting(self) -> dict[str, str]:
        known = [run.told.run_id for run in self._runs if run.told.run_id]
        if len(set(known)) == len(known):  # as nearly always, and many places take their time
            return {}
        return places_that_count(run.place for run in self._runs)
