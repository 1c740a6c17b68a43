"""The runs that a command line names, and the same work on all of them, in order."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument
from madrob_console.cli.options import results_folder, settings_of
from madrob_console.cli.output import Complaints, complain, counted_off
from madrob_console.cli.parsing import whole_within
from madrob_console.cli.sharing import in_order
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.archive.run_paths import RunPath
    from madrob_console.config import Settings
    from madrob_console.pages.competition import CompetitionStandings

_Done = TypeVar("_Done")


# How the work on many runs is shared: processes here, or a cluster.


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
    """What came of the work on a run: what was done, or why not, in words."""

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


# The runs of one competition, as the options of a command choose them.


WHICH_RUNS = (
    Argument(
        "--best",
        type=whole_within(0),
        metavar="N",
        help="only the N best runs of each team in each condition, 0 = all; else setting "
        "`competition.best_runs`",
    ),
    options.PRACTICE,
)


def standings(
    arguments: argparse.Namespace,
    settings: Settings,
    collection: Collection,
    teams: Mapping[int, str],
) -> CompetitionStandings:
    from madrob_console.pages.competition import competition_standings

    chosen: int | None = arguments.best
    best = settings.competition.best_runs if chosen is None else chosen
    return competition_standings(
        collection.runs,
        made=time.time(),
        competition=arguments.competition,
        official=not arguments.practice,
        best=best,
        listed=teams,
    )


def name_practice_alone(published: CompetitionStandings, collection: Collection) -> None:
    """Print a note where official runs were asked for and there is practice only."""
    practice = sum(run.practice for run in collection.runs)
    if published.official and practice and not any(run.official for run in collection.runs):
        complain(f"note: no official run, {practice} of practice: --practice shows them")


def demand_results(arguments: argparse.Namespace, settings: Settings) -> None:
    results = results_folder(arguments, settings)
    if not arguments.paths and not results.is_dir():
        raise MadrobError(f"{results}: no such results folder; name one with --results")


def named_places(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    where = [f"--results={results_folder(arguments, settings)}"]
    if arguments.settings is not None:
        where.append(f"--settings={arguments.settings}")
    if arguments.teams is not None:
        where.append(f"--teams={arguments.teams}")
    return where


def site_arguments(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    """Arguments of `madrob publish` after each result; empty where it is not wanted."""
    if not settings.results.publish:
        return []
    more = [] if arguments.plan is None else [f"--plan={arguments.plan}"]
    site = Path(settings.results.publish).expanduser()
    of = f"--competition={settings.competition.name}"
    return [str(site), *named_places(arguments, settings), *more, of]


# Runs that a command line names by path or by folder name.


_ONE = ("run", "rest", "weight")
"""Arguments that take one run or recording; `paths` takes any number, `testbed` one to replay."""


def find_runs(arguments: argparse.Namespace) -> None:
    """Replace the names of runs by their paths in all arguments that take runs."""
    for name in _ONE:
        if isinstance(named := getattr(arguments, name, None), Path):
            setattr(arguments, name, _run_folder(named, arguments))
    if paths := getattr(arguments, "paths", None):
        arguments.paths = [_run_folder(path, arguments) for path in paths]
    testbed: list[str] = getattr(arguments, "testbed", None) or []
    if testbed[:1] == [SourceKind.REPLAY]:
        arguments.testbed = [testbed[0], str(_run_folder(Path(testbed[1]), arguments))]


def _run_folder(name: Path, arguments: argparse.Namespace) -> Path:
    """An existing path, or one that is no run name, is returned unchanged."""
    from madrob_console.archive.folders import PRACTICE_FOLDER, parse_folder_name

    name = name.expanduser()
    if parse_folder_name(str(name)) is None or name.exists():
        return name

    settings = settings_of(arguments)
    results = results_folder(arguments, settings)
    official, practice = results / name, results / PRACTICE_FOLDER / name
    if official.exists() and practice.exists():
        raise MadrobError(f"{name}: two runs are called so: give {official} or {practice}")
    return practice if practice.exists() else official
