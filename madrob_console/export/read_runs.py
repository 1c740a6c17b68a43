"""The stored runs of a table: of duplicates one counts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

from madrob_console.archive.collection import demand_competition, demand_testbed
from madrob_console.archive.folders import FoundRun, RunPlace, places_that_count
from madrob_console.archive.result_files import stored_run


class _ReadRun(NamedTuple):
    found: FoundRun
    run_id: str
    practice: bool
    issue: int
    testbed: str
    competition: str

    @property
    def place(self) -> RunPlace:
        return RunPlace(self.found.run.name, self.run_id, self.practice, self.issue)


class ReadRuns:
    """The runs of a table; each is read again for its rows, so that few bytes of it are kept.

    Which of two duplicates counts is known only after the last run.
    """

    def __init__(self) -> None:
        self._runs: list[_ReadRun] = []

    def add_run(self, run: FoundRun) -> None:
        """Read the run's result; MadrobError if it cannot be used."""
        stored = stored_run(run.run)
        result, texts = (
            stored.result,
            map(sys.intern, (stored.result.testbed, stored.result.competition)),
        )
        self._runs.append(_ReadRun(run, result.run_id, stored.practice, result.issue, *texts))

    @property
    def twins(self) -> list[tuple[str, str]]:
        """Each place that does not count, and the one that counts instead."""
        counting = self._counting()
        named = ((run.found.run.name, counting.get(run.run_id)) for run in self._runs)
        return [(name, other) for name, other in named if other and other != name]

    def chosen(self, testbed: str | None, competition: str | None) -> Iterator[FoundRun]:
        """The runs that count; MadrobError where no run is of these names."""
        if testbed is not None:
            demand_testbed(testbed, {run.testbed for run in self._runs})
        if competition is not None:
            demand_competition(competition, {run.competition for run in self._runs})
        counting = self._counting()
        return (
            run.found
            for run in self._runs
            if counting.get(run.run_id, run.found.run.name) == run.found.run.name
            and testbed in (None, run.testbed)
            and competition in (None, run.competition)
        )

    def _counting(self) -> dict[str, str]:
        known = [run.run_id for run in self._runs if run.run_id]
        if len(set(known)) == len(known):  # as nearly always, and many places take their time
            return {}
        return places_that_count(run.place for run in self._runs)
