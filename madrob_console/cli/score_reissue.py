"""`madrob score --reissue`: the next issues of results, in bulk, after a rule change.

Runs are scored wherever the work is shared to; this process alone writes, one run after the other,
because a worker that was given up may still be alive. It holds each run as an engine would.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.run_paths import RunPath
from madrob_console.cli.problems import BAD_INPUT, Complaints
from madrob_console.cli.progress import progress
from madrob_console.cli.sharing import lost_words, shared
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from scoring.indicator_table import IndicatorName
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.rule_change import NextIssue, RuleChange
    from madrob_console.clock import Clock
    from madrob_console.report.surroundings import Surroundings

_AT_ONCE = 200
"""So many next issues are in memory at once, with their files, less than 2 MB each."""


class MadeIssue(NamedTuple):
    """What came of scoring a run for its next issue.

    Attributes:
        issue: it; None = there is nothing to re-issue.
        problem: why it cannot be, on one line; None = it can.
        out_of_date: whether the result is to be made again first.
    """

    issue: NextIssue | None = None
    problem: str | None = None
    out_of_date: bool = False


def made_issue(run: RunPath, *, change: RuleChange, files: bool) -> MadeIssue:
    """Score a run for its next issue. Never raises: one bad run must not stop the others.

    Args:
        run: which one.
        change: of the rules.
        files: whether they are to be written.
    """
    from madrob_console.archive.rule_change import OutOfDateError, next_issue

    try:
        return MadeIssue(next_issue(run, change, files=files))
    except OutOfDateError as error:
        return MadeIssue(problem=str(error), out_of_date=True)
    except MadrobError as error:
        return MadeIssue(problem=str(error))
    except Exception as error:  # noqa: BLE001  # a fault of ours must not stop the others either
        return MadeIssue(problem=f"{run.name}: not re-issued ({error!r}): please report it")


@dataclass
class ChangeTotals:
    """What a rule change comes to.

    Attributes:
        issues: results that it changes.
        counting: of these, how many enter the standings.
        signed: of these, how many were final.
        values: by indicator, how many values it changes.
        levels: by the capability level before and after, how many runs.
        unchanged: runs that it leaves as they are.
        unwritten: issues that the disk refused after the journal's line.
    """

    issues: int = 0
    counting: int = 0
    signed: int = 0
    values: Counter[IndicatorName] = field(default_factory=Counter)
    levels: Counter[tuple[float | None, float | None]] = field(default_factory=Counter)
    unchanged: int = 0
    unwritten: int = 0

    def add(self, issue: NextIssue) -> None:
        """One more result."""
        self.issues += 1
        self.counting += issue.counts
        self.signed += issue.signed is not None
        for value in issue.values:
            self.values[value.indicator] += 1
            if value.indicator is IndicatorName.CAPABILITY_LEVEL:
                self.levels[value.before, value.after] += 1

    def lines(self, bad: int, *, dry: bool) -> Iterator[str]:
        """All of it, for people."""
        done = "would be re-issued" if dry else "re-issued"
        counts = [f"{self.issues} {done}", f"{self.unchanged} unchanged"]
        if self.unwritten:
            counts.append(f"{self.unwritten} journalled and not written yet")
        yield f"{', '.join(counts)}, {bad - self.unwritten} left alone (see above)"
        if not self.issues:
            return
        final = f"{self.signed} of them {'are' if dry else 'were'} final and to be signed again"
        yield f"{self.counting} of them count in the standings; {final}"
        if self.values:
            named = (f"{name.words} {count}" for name, count in self.values.most_common())
            yield f"values that change: {', '.join(named)}"
        if self.levels:
            moved = (f"{a} -> {b}: {count}" for (a, b), count in self.levels.most_common())
            yield f"runs that change level: {', '.join(moved)}"


def reissue(
    arguments: argparse.Namespace,
    runs: Sequence[RunPath],
    rules: RulesetName | None,
    clock: Clock,
) -> int:
    """Re-issue what a rule change changes, or say what it would change.

    Raises:
        MadrobError: the settings cannot be used, or not the processes or the cluster.
    """
    from madrob_console.archive.rule_change import RuleChange
    from madrob_console.config import load_settings

    dry: bool = arguments.dry_run
    reason = arguments.reissue.strip()
    referee = load_settings(arguments.settings).competition.referee
    change = RuleChange(reason, rules, referee, clock.now_ns() / 1e9)
    totals = ChangeTotals()
    with Complaints() as bad:
        _go_through(arguments, runs, change, clock, totals, bad)
        if not dry:
            _renew_reports(arguments, runs, change, bad)
    for line in totals.lines(bad.count, dry=dry):
        print(line)
    return BAD_INPUT if bad.count else 0


def _go_through(
    arguments: argparse.Namespace,
    runs: Sequence[RunPath],
    change: RuleChange,
    clock: Clock,
    totals: ChangeTotals,
    bad: Complaints,
) -> None:
    """Every run: what the rule change changes of it is said, and written if it is to be."""
    from madrob_console.archive.rule_change import UnwrittenError

    dry: bool = arguments.dry_run
    work = partial(made_issue, change=change, files=not dry)
    issues = shared(arguments, work, runs, _lost, at_once=_AT_ONCE)
    with closing(issues) as made, progress("runs") as tell:
        tell(0, len(runs))
        for number, (run, one) in enumerate(zip(runs, made, strict=True), start=1):
            tell(number, len(runs))
            issues_before = totals.issues
            try:
                for issue in _settled(run, one, change, clock, dry=dry):
                    totals.add(issue)
                    print(terminal_safe(f"{run.name}: {issue.words}"), flush=True)
            except MadrobError as error:
                totals.unwritten += isinstance(error, UnwrittenError)
                bad.add(error, run.name)
                continue
            totals.unchanged += totals.issues == issues_before


def _settled(
    run: RunPath, made: MadeIssue, change: RuleChange, clock: Clock, *, dry: bool
) -> Iterator[NextIssue]:
    """Write what is to be written of one run: what was journalled before, and what is new.

    Raises:
        MadrobError: it cannot be.
    """
    from madrob_console.archive.rule_change import (
        UnwrittenError,
        unwritten_issue,
        write_next_issue,
    )
    from madrob_console.cli.repairing import repair_run

    if made.out_of_date and not dry:  # an earlier re-issue was killed, or an engine
        unwritten = unwritten_issue(run.path)
        try:
            repair_run(run.path)
        except MadrobError as error:
            if unwritten is None:
                raise
            if unwritten_issue(run.path) is not None:
                raise UnwrittenError(run.path, unwritten.number, error) from None
            yield unwritten  # only its report is not there
            raise
        if unwritten is not None:
            yield unwritten
        made = made_issue(run, change=change, files=True)
    if made.problem is not None:
        raise MadrobError(made.problem)
    if made.issue is not None:
        if not dry:
            write_next_issue(made.issue, clock.now_ns() / 1e9)
        yield made.issue


def _renew_reports(
    arguments: argparse.Namespace, runs: Sequence[RunPath], change: RuleChange, bad: Complaints
) -> None:
    """Make reports again that tell of an earlier issue, when all results are there to compare."""
    from madrob_console.archive.folders import results_folder_of
    from madrob_console.cli.repairing import renew_all
    from madrob_console.report.old_reports import report_is_old

    old = [run for run in runs if report_is_old(run.path)]
    work = partial(renewed_report, time=change.time)
    with closing(shared(arguments, work, old, lost_words)) as renewed, progress("pages") as tell:
        for number, (run, problem) in enumerate(zip(old, renewed, strict=True), start=1):
            tell(number, len(old))
            if problem:
                bad.add(problem, run.name)
    for results in dict.fromkeys(results_folder_of(run.path) for run in old):
        for problem in renew_all(results):
            bad.add(problem, str(results))


def renewed_report(run: RunPath, *, time: float) -> str:
    """Make the report of a run again; says why it cannot be, empty = it is.

    That of a run that a console works on is left to it.

    Args:
        run: which one.
        time: of the rule change: what lies around runs is looked at once for each.
    """
    from madrob_console.archive.unfinished import is_held
    from madrob_console.cli.repairing import renew_report

    try:
        if is_held(run.path / JOURNAL_FILE):
            return ""
        renew_report(run.path, _around(time))
    except MadrobError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001  # a fault of ours must not stop the others either
        return f"{run.name}: no report ({error!r}): please report it"
    return ""


@lru_cache(maxsize=1)
def _around(_time: float) -> Surroundings:
    from madrob_console.report.surroundings import Surroundings

    return Surroundings()


def _lost(run: RunPath, why: str) -> MadeIssue:
    return MadeIssue(problem=lost_words(run, why))
