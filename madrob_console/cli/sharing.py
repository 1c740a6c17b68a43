"""How a command shares work on many runs: processes here, a cluster, or one shard of several."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from madrob_console.cli import options
from madrob_console.errors import MadrobError

if TYPE_CHECKING:  # what a help text needs is here sooner without them
    from madrob_console.archive.run_paths import RunPath
    from madrob_console.archive.shards import Shard

_Done = TypeVar("_Done")


def add(parser: argparse.ArgumentParser, done: str) -> None:
    """How the work is shared; `done` is what is done with the runs."""
    options.add_jobs(parser, done)
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        default=None,
        help="hand the runs to a running Dask cluster, tcp://HOST:8786, whose workers have the "
        "same madrob-console and see the same paths; needs the extra `cluster`. A scheduler is "
        "trusted like a shell: it can run anything as you; use tls:// where others reach it",
    )
    parser.add_argument(
        "--shard",
        type=_shard,
        metavar="I/N",
        default=None,
        help="only share I of N of the runs, for arrays of Slurm or Kubernetes: which one a run is "
        "in follows from the name of its folder, and all shares together are every run once",
    )


def _shard(text: str) -> Shard:
    from madrob_console.archive.shards import Shard

    try:
        return Shard.parse(text)
    except MadrobError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def runs_of(arguments: argparse.Namespace) -> list[RunPath]:
    """The runs at the paths that are named, of the shard; options that contradict end it."""
    from madrob_console.archive.run_paths import all_runs_at
    from madrob_console.archive.shards import shared_out

    if arguments.scheduler is not None:
        for name in ("jobs", "backend"):
            if getattr(arguments, name) is not None:
                arguments.parser.error(f"--{name}: not allowed with --scheduler, which has workers")
    paths: list[Path] = arguments.paths
    if arguments.scheduler is not None:  # workers have another working directory
        paths = [path.absolute() for path in paths]
    if arguments.shard is not None:  # one task of many would say so, and the others be content
        for path in paths:
            if not path.exists():
                raise MadrobError(f"{path}: no such file or directory: every share needs all paths")
    return shared_out(all_runs_at(paths), arguments.shard)


def shared(
    arguments: argparse.Namespace,
    work: Callable[[RunPath], _Done],
    runs: Sequence[RunPath],
    lost: Callable[[RunPath, str], _Done],
    *,
    at_once: int | None = None,
) -> Generator[_Done, None, None]:
    """Do the work on every run, where the arguments say; what comes of it, in order.

    Args:
        arguments: of the command.
        work: what to do; it must be importable by name, and so must what it takes and gives.
        runs: on what.
        lost: what stands for a run that no worker of a cluster survives, from why, in words.
        at_once: of what comes of them so many are in memory; None = they are small.

    Raises:
        MadrobError: the processes or the cluster cannot be used.
    """
    if arguments.scheduler is None or not runs:
        from madrob_console.cli.batch import in_order

        jobs, backend = arguments.jobs, arguments.backend
        if at_once is None:
            return in_order(work, runs, jobs, backend)
        blocks = [runs[begin : begin + at_once] for begin in range(0, len(runs), at_once)]
        return _one_by_one(partial(in_order, work, jobs=jobs, backend=backend), blocks)
    from madrob_console.cli.cluster import on_cluster

    named = [*(path.absolute() for path in arguments.paths), runs[0].path, runs[-1].path]
    there = [path for path in named if path.exists()]
    return on_cluster(work, runs, arguments.scheduler, there, lost, at_once=at_once)


def _one_by_one(
    share: Callable[[Sequence[RunPath]], Generator[_Done, None, None]],
    blocks: Sequence[Sequence[RunPath]],
) -> Generator[_Done, None, None]:
    for block in blocks:
        with closing(share(block)) as done:
            yield from done


def lost_words(run: RunPath, why: str) -> str:
    """What is said of a run that no worker survives."""
    return f"{run.name}: cannot be scored: {why}"
