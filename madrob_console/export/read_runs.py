"""The stored runs of a table: of duplicates one counts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from madrob_console.archive.collection import demand_competition, demand_testbed
from madrob_console.archive.folders import RunPath, RunPlace, places_that_count
from madrob_console.archive.result_files import stored_run


class _ReadRun(NamedTuple):
    run: RunPath
    place: RunPlace
    testbed: str
    competition: str


class ReadRuns:
    """The runs of a table; each is read again for its rows, so that few bytes of it are kept.

    Which of two duplicates counts is known only after the last run.
    """

    def __init__(self) -> None:
        self._runs: list[_ReadRun] = []

    def add_run(self, run: RunPath) -> None:
        """Read the run's result; MadrobError if it cannot be used."""
        stored = stored_run(run)
        label = stored.label
        self._runs.append(_ReadRun(run, stored.place(run.name), label.testbed, label.competition))

    @property
    def twins(self) -> list[tuple[str, str]]:
        """Each place that does not count, and the one that counts instead."""
        counting = self._counting()
        named = ((place.name, counting.get(place.run_id)) for _, place, *_ in self._runs)
        return [(name, other) for name, other in named if other and other != name]

    def chosen(self, testbed: str | None, competition: str | None) -> Iterator[RunPath]:
        """The runs that count; MadrobError where no run is of these names."""
        if testbed is not None:
            demand_testbed(testbed, {run.testbed for run in self._runs})
        if competition is not None:
            demand_competition(competition, {run.competition for run in self._runs})
        counting = self._counting()
        return (
            run
            for run, place, *names in self._runs
            if counting.get(place.run_id, place.name) == place.name
            and testbed in (None, names[0])
            and competition in (None, names[1])
        )

    def _counting(self) -> dict[str, str]:
        return places_that_count(run.place for run in self._runs if run.place.run_id)
