"""The rows of the tables of runs, from stored results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import TypeAlias

from madrob_console.archive.stored_runs import StoredRun
from madrob_console.referee.flags import undecided
from madrob_console.tidy.run_tables import EVENTS, INDICATORS, RUNS, STEPS
from madrob_console.tidy.table_files import Cells, TableWriter
from madrob_console.tidy.tidy_table import TidyTable
from scoring.protocol import Condition

Row: TypeAlias = Mapping[str, object]
"""Its cells by column."""

_ROWS_AT_ONCE = 2_000


def rows_of(table: TidyTable, run: StoredRun) -> Iterator[Row]:
    """The rows of one of the tables that a run has."""
    whose = asdict(run.label)
    for row in _MAKERS[table.name](run):
        yield {**whose, **row}


def cells_of(table: TidyTable, rows: Iterable[Row]) -> Mapping[str, Cells]:
    """The same by column."""
    every = list(rows)
    return {column.name: [row[column.name] for row in every] for column in table.columns}


class RowWriter:
    """Writes a table of any number of runs: few rows and those of one run are in memory.

    Args:
        writer: of the table.
        table: which.
    """

    def __init__(self, writer: TableWriter, table: TidyTable) -> None:
        self._writer = writer
        self._table = table
        self._rows: list[Row] = []

    def add(self, rows: Iterable[Row]) -> None:
        """Those of one run."""
        self._rows += rows
        if len(self._rows) >= _ROWS_AT_ONCE:
            self._flush()

    def close(self) -> None:
        """Write the rest, and what belongs at the end."""
        if self._rows:
            self._flush()
        self._writer.close()

    def _flush(self) -> None:
        self._writer.add(cells_of(self._table, self._rows))
        self._rows = []


def task_cells(condition: Condition) -> Row:
    """What a condition is."""
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
