"""`madrob score`: recorded runs to results, one or ten thousand of them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from textwrap import indent

from madrob_console.archive.run_paths import runs_at
from madrob_console.cli.arguments_common import BAD_INPUT
from madrob_console.cli.arguments_results import BOTH_RULESETS
from madrob_console.cli.batch import in_order
from madrob_console.cli.score_run import Told, Wanted, tell
from madrob_console.names import terminal_safe
from scoring.rulesets import RulesetName

DIFFERENCES = 1
"""Exit code of `--check` where a result is not what its recording gives."""

STOPPED = 130
"""Exit code after Ctrl+C, as shells have it."""

_A_FEW = 4
"""So many runs need no progress bar."""


def main(arguments: argparse.Namespace) -> int:
    """Score every run at the paths; a bad one is named and does not stop the rest."""
    runs = [run for path in arguments.paths for run in runs_at(path)]
    wanted = Wanted(_rules(arguments.ruleset), arguments.check, arguments.json)
    told = in_order(partial(tell, wanted=wanted), runs, arguments.jobs, arguments.backend)
    if len(runs) > _A_FEW and sys.stderr.isatty():
        told = _with_bar(told, len(runs))
    try:
        bad, differing = _print(told, as_json=arguments.json)
    except KeyboardInterrupt:
        print("madrob: stopped", file=sys.stderr)
        return STOPPED
    if arguments.check and len(runs) > 1 and not arguments.json:
        agreeing = len(runs) - bad - differing
        print(f"{agreeing} agree, {differing} differ, {bad} could not be checked")
    if differing:
        return DIFFERENCES
    return BAD_INPUT if bad else 0


def _rules(name: str | None) -> tuple[RulesetName | None, ...]:
    if name == BOTH_RULESETS:
        return tuple(RulesetName)
    return (None if name is None else RulesetName(name),)


def _print(told: Iterable[Told], *, as_json: bool) -> tuple[int, int]:
    """Print what is said of each run as soon as it is; how many were bad, and how many differ."""
    bad, differing, printed = 0, 0, 0
    if as_json:
        print('{\n  "runs": [', end="")
    for one in told:
        if one.problem is not None:
            print(f"madrob: {terminal_safe(one.problem)}", file=sys.stderr, flush=True)
            bad += 1
            continue
        if as_json:
            print("," if printed else "", indent(one.text, "    "), sep="\n", end="", flush=True)
        else:
            print(one.text, flush=True)
        printed += 1
        differing += one.differs
    if as_json:
        print("\n  ]\n}" if printed else "]\n}")
    return bad, differing


def _with_bar(told: Iterable[Told], total: int) -> Iterator[Told]:
    """The same, with a progress bar on the terminal below what is printed."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    progress = Progress(
        "runs",
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),
    )
    with progress:
        yield from progress.track(told, total=total)
