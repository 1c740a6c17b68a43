"""`madrob score --reissue`: the next versions of many results after a rule change."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

from madrob_console.archive.folders import JOURNAL_FILE, results_folder_of
from madrob_console.archive.run_paths import RunPath
from madrob_console.cli.batch import each_run
from madrob_console.cli.output import BAD_INPUT, Complaints
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted
from madrob_console.common.names import terminal_safe
from scoring.indicator_table import RulesetName

if TYPE_CHECKING:
    from madrob_console.common.clock import Clock


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
