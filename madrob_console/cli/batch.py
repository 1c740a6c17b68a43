"""The same work on many things, in several processes or on a cluster, in order."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack
from itertools import islice
from typing import Any, TypeVar

from madrob_console.cli.interrupting import children_spared
from madrob_console.errors import MadrobError

DEFAULT_BACKEND = "loky"
"""joblib's own processes."""

WORTH_A_PROCESS = 10
"""By default a process gets at least this many items: it needs a second to get ready."""

_BLOCK = 256
"""Items handed at once to a backend that does not give results as they come."""

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")


def in_order(
    work: Callable[[_Item], _Done],
    items: Sequence[_Item],
    jobs: int | None = None,
    backend: str | None = None,
) -> Generator[_Done, None, None]:
    """Do the work on every item; what comes of it, in the order of the items, as it gets ready.

    Few items, or one job, are worked on here, without joblib. Closed, it ends what still works.

    Args:
        work: what to do; it must be importable by name, and so must what it takes and gives.
        items: on what.
        jobs: how many at once; None = as many as there are cores and enough to do, or as the
            backend has.
        backend: joblib's name of it; None = processes on this machine.

    Raises:
        MadrobError: joblib knows no such backend, it does not start, or a process died.
    """
    here = backend is None and jobs is None and _worthwhile(items) == 1
    if len(items) < 2 or jobs == 1 or here:
        return (work(item) for item in items)
    return _parallel(work, items, jobs, DEFAULT_BACKEND if backend is None else backend)


def _worthwhile(items: Sequence[object]) -> int:
    """How many processes have enough to do."""
    return max(1, len(items) // WORTH_A_PROCESS)


def _parallel(
    work: Callable[[_Item], _Done], items: Sequence[_Item], jobs: int | None, backend: str
) -> Generator[_Done, None, None]:
    import joblib

    count = jobs or -1
    if backend == DEFAULT_BACKEND:
        count = min(jobs or joblib.cpu_count(), len(items) if jobs else _worthwhile(items))
    try:
        chosen = joblib.parallel_config(backend=backend, n_jobs=count)
    except (ValueError, ImportError) as error:
        raise MadrobError(f"--backend {backend}: {' '.join(str(error).split())}") from None
    return _results(chosen, (joblib.delayed(work)(item) for item in items))


def _results(
    chosen: AbstractContextManager[object], calls: Iterator[Any]
) -> Generator[Any, None, None]:
    from joblib.externals.loky.backend.resource_tracker import ensure_running
    from joblib.parallel import Parallel, get_active_backend

    with chosen, warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"joblib\.")  # results that nobody waits for
        try:
            if get_active_backend()[0].supports_return_generator:
                # of the folders that it cleans up after Ctrl+C
                os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
                ensure_running()  # or its start would let Ctrl+C through to the workers
                with ExitStack() as stack:
                    with children_spared():
                        results = Parallel(return_as="generator", batch_size=1)(calls)
                        stack.callback(results.close)  # it kills what still works
                    yield from results
                return
            while block := list(islice(calls, _BLOCK)):
                yield from Parallel()(block)
        except BrokenProcessPool:
            raise MadrobError(
                "a worker process died: make memory free, or use --jobs 1 to see at which run"
            ) from None
