"""The output of `madrob score`: tables for programs, and re-issued results."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.archive.folders import JOURNAL_FILE, results_folder_of
from madrob_console.archive.run_paths import RunPath, places_that_count
from madrob_console.archive.table_columns import RUN_TABLES, UNREADABLE, rows_of
from madrob_console.cli.batch import each_run
from madrob_console.cli.output import BAD_INPUT, Complaints, name_twins
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted
from madrob_console.common.names import terminal_safe
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.table_columns import Row
    from madrob_console.common.clock import Clock


class FreshRows(NamedTuple):
    """Rows of one run by the name of the table."""

    rows: Mapping[str, Sequence[Row]]
    run_id: str


def fresh_rows(run: RunPath, *, rules: tuple[RulesetName | None, ...]) -> FreshRows:
    """Score a run for the tables; `rules` None = the ruleset of the run."""
    from madrob_console.archive.stored_runs import fresh_runs

    scored = fresh_runs(run, rules)
    rows = {
        table.name: [row for each in scored for row in rows_of(table, each)] for table in RUN_TABLES
    }
    return FreshRows(rows, scored[0].label.run_id)


def write_tables(
    arguments: argparse.Namespace, runs: Sequence[RunPath], rules: tuple[RulesetName | None, ...]
) -> int:
    """Write the tables of all runs atomically; one that cannot be read has its row."""
    from madrob_console.archive.stored_runs import stored_places
    from madrob_console.archive.table_rows import TableWriter
    from madrob_console.common.files import new_folder, whole_file

    folder = arguments.output.absolute()
    places = places_that_count(stored_places(runs))
    twins: list[tuple[str, str]] = []
    with ExitStack() as stack:
        bad = stack.enter_context(_Unreadable())
        part = stack.enter_context(new_folder(folder))
        writers = {}
        for table in (*RUN_TABLES, UNREADABLE):
            file = stack.enter_context(whole_file(part / f"{table.name}.csv"))
            writers[table.name] = stack.enter_context(closing(TableWriter(file, table)))
        work = partial(fresh_rows, rules=rules)
        for run, fresh in stack.enter_context(closing(each_run(arguments, work, runs, bad))):
            if fresh is None:
                continue
            if fresh.run_id and (place := places.setdefault(fresh.run_id, run.name)) != run.name:
                twins.append((run.name, place))
                continue
            for name, rows in fresh.rows.items():
                writers[name].write_rows(rows)
        writers[UNREADABLE.name].write_rows(bad.rows)
        name_twins(twins)
    print(terminal_safe(f"{folder}: {len(runs)} runs, {bad.count} of them cannot be read"))
    return BAD_INPUT if bad.count else 0


class _Unreadable(Complaints):
    """Complaints of runs, and the `rows` of the table that says the same."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[Row] = []

    def add_complaint(self, problem: object, of: object) -> None:
        super().add_complaint(problem, of)
        self.rows.append(UNREADABLE.row_of(str(of), str(problem).removeprefix(f"{of}: ")))


_AT_ONCE = 200
"""Limit of next issues in memory, with their files, less than 2 MB each."""


def reissue(
    arguments: argparse.Namespace,
    runs: Sequence[RunPath],
    rules: RulesetName | None,
    clock: Clock,
) -> int:
    """Re-issue many results after a rule change.

    Workers score the runs. This process alone writes, one run after the other, because a worker
    that was given up may still be alive. It holds each run as an engine would.
    """
    from madrob_console.archive.rule_change import RuleChange, next_issue, write_next_issue
    from madrob_console.config import load_settings

    dry: bool = arguments.dry_run
    referee = load_settings(arguments.settings).competition.referee
    change = RuleChange(arguments.reissue.strip(), rules, referee, clock.now_ns() / 1e9)
    work, count = partial(next_issue, change=change, files=not dry), 0
    with Complaints() as bad:
        with closing(each_run(arguments, work, runs, bad, at_once=_AT_ONCE)) as issues:
            for run, issue in issues:
                if issue is None:
                    continue
                try:
                    if not dry:
                        write_next_issue(issue, clock.now_ns() / 1e9)
                except MadrobError as error:
                    bad.add_complaint(error, run.name)
                    continue
                count += 1
                print(terminal_safe(f"{run.name}: {issue.words}"), flush=True)
        if not dry:
            _renew_reports(runs, bad)
    print(f"{count} of {counted(len(runs), 'result')} {'would be ' * dry}re-issued")
    return BAD_INPUT if bad.count else 0


def _renew_reports(runs: Sequence[RunPath], bad: Complaints) -> None:
    """Remake the reports of re-issued runs; one that a console works on is left to it."""
    from madrob_console.archive.unfinished_runs import is_held
    from madrob_console.cli.repairing import renew_all, renew_reports
    from madrob_console.pages.related_runs import RelatedRuns, report_is_old

    old = [run.path for run in runs if report_is_old(run.path)]
    free = (folder for folder in old if not is_held(folder / JOURNAL_FILE))
    others = (renew_all(results) for results in dict.fromkeys(map(results_folder_of, old)))
    for problem in chain(renew_reports(free, RelatedRuns()), *others):
        bad.add_complaint(problem, problem.partition(":")[0])
