"""`madrob tidy`: room on the disk, by the evidence of old runs."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints, says_yes, somebody_there
from madrob_console.cli.parsing import period, size, whole_within
from madrob_console.cli.progress import counted_off
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import free_space
from madrob_console.common.formatting import counted, format_size
from madrob_console.common.names import terminal_safe
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.archive.evidence_removal import RunEvidence, TidyLimits

NOT_REMOVED = 1
"""Exit code if the user said no."""


@command(
    "tidy",
    "make room: remove the evidence of old runs",
    "Evidence is what cameras and other topics brought. Recordings of what is scored, results, "
    "reports and pictures stay. So does the evidence of a run that was ever protested or still "
    "can be in time, goes on or is open in a console, of an official one that is not final, of "
    "the last run and of the last practice run. It says what goes and what stays and why, and "
    "asks. Each run's journal and report say what was removed. Give --keep-runs, --older-than or "
    "--until-free, or several of them: what one keeps stays.",
    options=(
        Argument(
            "--keep-runs",
            type=whole_within(0),
            metavar="N",
            help="keep that of the last N runs, and of the last N practice runs",
        ),
        Argument(
            "--older-than",
            type=period,
            metavar="TIME",
            help="keep that of younger runs: 12h, 7d, 2w",
        ),
        Argument(
            "--until-free",
            type=size,
            metavar="SIZE",
            help="keep what is left once so much of the disk is free: 50GB",
        ),
        Argument("--dry-run", action="store_true", help="only say what would go"),
        Argument("--yes", action="store_true", help="do not ask"),
        *options.RESULTS,
        options.SETTINGS,
    ),
    examples=(
        "madrob tidy --older-than 7d --dry-run",
        "madrob tidy --keep-runs 20 --until-free 50GB    # only as much as it takes",
    ),
)
def tidy(arguments: argparse.Namespace) -> int:
    with imports_kept():
        from madrob_console.archive.evidence_removal import evidence_at, run_going_on

    settings = option_values.settings_of(arguments)
    limits = _limits(arguments)
    root = option_values.results_folder(arguments, settings)
    if not root.is_dir():
        raise MadrobError(f"{root}: no such results folder; name one with --results")
    free = free_space(root)
    if free is None:
        raise MadrobError(f"{root}: its disk does not say how much is free; try again")
    now = time.time()
    evidence = evidence_at(root, limits, now, free)
    for line in _lines(evidence, now):
        print(terminal_safe(line))
    going = [run for run in evidence if not run.why_kept]
    room = sum(run.size for run in going)
    stays = format_size(sum(run.size for run in evidence) - room)
    then = f"{format_size(free)} free now, {format_size(free + room)} then"
    runs = counted(len(going), "run")
    print(f"evidence of {runs}, {format_size(room)}, can go; {stays} stay; {then}")
    if lacking := _lacking(limits, free + room):
        print(lacking)
    if not going or arguments.dry_run:
        return 0
    if (name := run_going_on(root)) is not None:  # large files that go hold up a disk for seconds
        raise MadrobError(f"{name}: this run goes on: tidy after it")
    if not arguments.yes:
        if not somebody_there():
            raise MadrobError("nobody is there to be asked: --yes removes without asking")
        if not says_yes(f"Remove the evidence of {runs} for good? [y/N] "):
            print("nothing was removed")
            return NOT_REMOVED
    return _remove(going, root, limits)


def _limits(arguments: argparse.Namespace) -> TidyLimits:
    from madrob_console.archive.evidence_removal import TidyLimits

    keep, age, free = arguments.keep_runs, arguments.older_than, arguments.until_free
    if keep is None and age is None and free is None:
        raise MadrobError("say what stays: --keep-runs, --older-than or --until-free")
    return TidyLimits(keep or 0, age or 0.0, free)


def _lacking(limits: TidyLimits, free: float) -> str:
    wanted = limits.until_free
    if wanted is None or free >= wanted:
        return ""
    lacking = format_size(wanted - free)
    return f"--until-free {format_size(wanted)} is not reached: {lacking} are lacking"


def _lines(evidence: Sequence[RunEvidence], now: float) -> list[str]:
    rows = [
        (each.run.folder, _age(now - each.run.started), format_size(each.size), each.why_kept)
        for each in evidence
    ]
    longest = max((len(row[0]) for row in rows), default=0)
    return [
        f"{folder:<{longest}}  {age:>6}  {amount:>7}  {f'stays: {why}' if why else 'goes'}"
        for folder, age, amount, why in rows
    ]


def _age(seconds: float) -> str:
    return f"{seconds / 86400:.0f} d" if seconds >= 2 * 86400 else f"{seconds / 3600:.1f} h"


def _remove(going: Sequence[RunEvidence], root: Path, limits: TidyLimits) -> int:
    from madrob_console.archive.evidence_removal import remove_evidence
    from madrob_console.cli.repairing import renew_reports
    from madrob_console.pages.related_runs import RelatedRuns, has_report

    removed: list[RunEvidence] = []
    with Complaints() as bad:
        for each in counted_off(going, "runs"):
            with bad.complaining(each.folder):
                remove_evidence(each, time.time())
                removed.append(each)
        reported = filter(has_report, (each.folder for each in removed))
        for problem in renew_reports(reported, RelatedRuns()):
            bad.add_complaint(problem, problem.partition(":")[0])
    free = free_space(root)
    total = format_size(sum(each.size for each in removed))
    left = "" if free is None else f"; {format_size(free)} free"
    print(f"removed {total} of evidence of {len(removed)} of {len(going)} runs{left}")
    if free is not None and (lacking := _lacking(limits, free)):
        print(lacking)
    return BAD_INPUT if bad.count else 0
