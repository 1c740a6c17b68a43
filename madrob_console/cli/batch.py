"""The same work on many runs, in order, by processes here or by a cluster."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument
from madrob_console.cli.output import Complaints
from madrob_console.cli.progress import counted_off
from madrob_console.cli.sharing import in_order
from madrob_console.common.errors import MadrobError

if TYPE_CHECKING:
    from madrob_console.archive.run_paths import RunPath


_Done = TypeVar("_Done")

SHARING = (
    options.JOBS,
    Argument(
        "--scheduler",
        metavar="ADDRESS",
        help="hand the runs to a running Dask cluster, tcp://HOST:8786, whose workers have the "
        "same madrob-console and see the same paths; needs `distributed`. A scheduler is "
        "trusted like a shell: it can run anything as you; use tls:// where others reach it",
    ),
)


def runs_of(arguments: argparse.Namespace) -> list[RunPath]:
    from madrob_console.archive.run_paths import all_runs_at

    paths: list[Path] = arguments.paths
    if arguments.scheduler is not None:
        if arguments.jobs is not None:
            arguments.parser.error("--jobs: not allowed with --scheduler, which has workers")
        paths = [path.absolute() for path in paths]  # workers have another working directory
    return all_runs_at(paths)


class Tried(NamedTuple, Generic[_Done]):
    """The result of the work on a run, or the reason of its failure."""

    done: _Done | None = None
    problem: str = ""


def tried(run: RunPath, *, work: Callable[[RunPath], _Done]) -> Tried[_Done]:
    """Do the work on a run. Never raises: one bad run must not stop the others."""
    try:
        return Tried(work(run))
    except MadrobError as error:
        return Tried(problem=str(error))
    except Exception as error:  # noqa: BLE001  a fault of ours must not stop the others either
        return Tried(problem=f"{run.name}: not done ({error!r}): please report it")


def each_run(
    arguments: argparse.Namespace,
    work: Callable[[RunPath], _Done],
    runs: Sequence[RunPath],
    bad: Complaints,
    *,
    at_once: int | None = None,
) -> Generator[tuple[RunPath, _Done | None], None, None]:
    """Do the work on every run, where the arguments say; yield what was done, in order.

    None = it was not done: `bad` says why. `work`, its argument and its result must be importable
    by name. `at_once` limits the results in memory; None = they are small. Close the generator:
    that ends the work in progress.
    """
    scheduler: str | None = getattr(arguments, "scheduler", None)
    work_on = partial(tried, work=work)
    if scheduler is None or not runs:
        outcomes = in_order(work_on, runs, _lost, arguments.jobs, at_once)
    else:
        from madrob_console.cli.cluster import on_cluster

        named = [*(path.absolute() for path in arguments.paths), runs[0].path, runs[-1].path]
        there = [path for path in named if path.exists()]
        outcomes = on_cluster(work_on, runs, scheduler, there, _lost, at_once=at_once)
    with closing(outcomes), closing(counted_off(runs, "runs")) as counted:
        for run, outcome in zip(counted, outcomes, strict=True):
            if outcome.problem:
                bad.add_complaint(outcome.problem, run.name)
            yield run, outcome.done


def _lost(run: RunPath, why: str) -> Tried[Any]:
    return Tried(problem=f"{run.name}: {why}")
