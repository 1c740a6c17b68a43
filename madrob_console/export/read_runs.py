"""The rows of stored runs: each result is read once, and of duplicates one counts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import msgspec

from madrob_console.archive.collection import demand_competition, demand_testbed
from madrob_console.archive.folders import RunPath, RunPlace, places_that_count
from madrob_console.archive.result_files import stored_run
from madrob_console.export.table_columns import Row, TidyTable, rows_of


class _ReadRun(NamedTuple):
    place: RunPlace
    testbed: str
    competition: str
    begin: int
    size: int


class ReadRuns:
    """The runs of a table, whose rows wait in a (temporary) file.

    Which of two duplicates counts is known only after the last run.
    """

    def __init__(self, table: TidyTable, file: BinaryIO) -> None:
        self._table = table
        self._file = file
        self._runs: list[_ReadRun] = []

    def add_run(self, run: RunPath) -> None:
        """Reads a result; MadrobError if it is missing or cannot be used."""
        stored, begin = stored_run(run), self._file.tell()
        size = self._file.write(msgspec.msgpack.encode([*rows_of(self._table, stored)]))
        label = stored.label
        place = stored.place(run.name)
        self._runs.append(_ReadRun(place, label.testbed, label.competition, begin, size))

    @property
    def twins(self) -> list[tuple[str, str]]:
        """Each place that does not count, and the one that counts instead."""
        counting = self._counting()
        named = ((run.place.name, counting.get(run.place.run_id)) for run in self._runs)
        return [(name, other) for name, other in named if other and other != name]

    def chosen(self, testbed: str | None, competition: str | None) -> Iterator[list[Row]]:
        """The rows of each run that counts; MadrobError where no run is of these names."""
        if testbed is not None:
            demand_testbed(testbed, {run.testbed for run in self._runs})
        if competition is not None:
            demand_competition(competition, {run.competition for run in self._runs})
        return self._rows(testbed, competition)

    def _rows(self, testbed: str | None, competition: str | None) -> Iterator[list[Row]]:
        counting = self._counting()
        for run in self._runs:
            counts = counting.get(run.place.run_id, run.place.name) == run.place.name
            wanted = testbed in (None, run.testbed) and competition in (None, run.competition)
            if counts and wanted:
                self._file.seek(run.begin)
                yield msgspec.msgpack.decode(self._file.read(run.size))

    def _counting(self) -> dict[str, str]:
        return places_that_count(run.place for run in self._runs)
