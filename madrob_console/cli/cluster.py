"""The same work on many things, on a running Dask cluster, in order."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from madrob_console.cli.output import complain
from madrob_console.cli.sharing import AgainError, DeadWorkerError, results
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

if TYPE_CHECKING:
    from distributed import Client, Future

ANSWERS_WITHIN = 10.0
"""Timeout for the scheduler to answer, s."""

_AHEAD, _LEAST_AHEAD = 4, 256
"""Items handed out at once: per thread, and in all, which tells an adaptive cluster to grow."""

_LOOK = 10.0
"""Interval at which workers are counted while no item finishes, s."""

_CANCELLED = (asyncio.CancelledError, concurrent.futures.CancelledError)

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")


class WrongVersion(NamedTuple):
    """A worker's answer if its results would not be those of this machine; `why` in words."""

    worker: str
    why: str


def versions() -> tuple[str, ...]:
    """Versions of the software and of its libraries."""
    from madrob_console.common.version import software_version
    from scoring.result import libraries_here

    return (software_version(), *astuple(libraries_here()))


def why_unfit(wanted: tuple[str, ...], paths: Sequence[str] = ()) -> str | None:
    """Said by a worker: why its results would not be those of the asking machine; None = fits.

    `asked` are the versions of that machine; the worker must see the `paths`.
    """
    for there, here in zip(versions(), wanted, strict=True):
        if there != here:
            return (
                f"has other versions ({there} there, {here} here), which round otherwise: install "
                "the same there"
            )
    unseen = next((path for path in paths if not Path(path).exists()), None)
    return unseen and f"does not see {unseen}: name paths on a disk that all workers share"


def answer_of(
    work: Callable[[_Item], _Done], item: _Item, wanted: tuple[str, ...]
) -> _Done | WrongVersion:
    """Do the work on an item, which may write files, if the worker fits."""
    from distributed import get_worker

    why = why_unfit(wanted)
    return work(item) if why is None else WrongVersion(str(get_worker().contact_address), why)


def on_cluster(
    work: Callable[[_Item], _Done],
    items: Sequence[_Item],
    address: str,
    paths: Iterable[Path],
    lost: Callable[[_Item, str], _Done],
    *,
    at_once: int | None = None,
) -> Generator[_Done, None, None]:
    """Do the work on every item; yield the results in the order of the items, as they get ready.

    Items of a worker that dies go to others, and so do those of a worker with other versions, which
    may have joined late. An item on which worker after worker dies is tried once more alone, and
    then given up: `lost` makes its result from the reason in words. Closing the generator cancels
    the work in progress. `work` must be importable by name on the workers, which must see `paths`.
    `at_once` limits the items handed out or in memory; None = as many as keep the cluster busy.

    Raises:
        MadrobError: `distributed` is not installed, the scheduler does not answer or goes away, or
            no worker fits, or one that is there at the start does not.
    """
    with _connected(address) as client:
        _demand_fitting(client, address, [str(path) for path in paths])
        threads = sum(client.nthreads().values())
        ahead = max(_LEAST_AHEAD, _AHEAD * threads)
        ahead = ahead if at_once is None else min(ahead, at_once)
        yield from results(_ClusterWorkers(client, work), items, lost, ahead)


class _ClusterWorkers(Generic[_Item, _Done]):
    """The workers of a cluster that fit; one that does not gets nothing after its first item."""

    def __init__(self, client: Client, work: Callable[[_Item], _Done]) -> None:
        self._client = client
        self._work = work
        self._misfits: dict[str, WrongVersion] = {}

    def hand_out(self, item: _Item) -> Future:
        fitting = None
        if self._misfits:
            fitting = [each for each in self._client.nthreads() if each not in self._misfits]
            if not fitting:
                *_, misfit = self._misfits.values()
                raise MadrobError(
                    f"no worker is left that fits: worker {misfit.worker} {misfit.why}"
                )
        return self._client.submit(
            answer_of,
            self._work,
            item,
            versions(),
            pure=False,
            workers=fitting,
            allow_other_workers=fitting is not None,  # once all of these are gone
        )

    def wait(self, handles: Sequence[Future]) -> Iterable[Future]:
        from distributed import wait

        try:
            done: set[Future] = wait(handles, timeout=_LOOK, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if not self._client.nthreads():
                complain("the cluster has no workers: waiting for some; Ctrl+C stops")
            return ()
        except _CANCELLED:
            raise _gone() from None
        return done

    def answer(self, handle: Future) -> _Done:
        from distributed import KilledWorker

        try:
            answer: _Done | WrongVersion = handle.result(timeout=_LOOK)
        except _CANCELLED:
            raise _gone() from None
        except KilledWorker:
            why = "every worker died that worked on it: too little memory, or a fault of it"
            raise DeadWorkerError(why) from None
        except Exception as error:  # noqa: BLE001  of this item and no other
            if handle.status != "error":  # it went with its worker before it was taken: once more
                raise AgainError from None
            why = f"the cluster could not do it ({type(error).__name__}: {str(error)[:200]})"
            raise DeadWorkerError(terminal_safe(why)) from None
        if not isinstance(answer, WrongVersion):
            return answer
        if answer.worker not in self._misfits:
            complain(f"worker {answer.worker} {answer.why}; others do its share")
        self._misfits[answer.worker] = answer
        raise AgainError

    def cancel(self, handles: Sequence[Future]) -> None:
        if handles:
            self._client.cancel(list(handles), force=True)


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        import distributed
    except ImportError:
        raise MadrobError(
            "--scheduler needs Dask: install the package `distributed`, here and on the workers"
        ) from None
    for name in [*logging.root.manager.loggerDict, "asyncio"]:
        if name.partition(".")[0] in {"asyncio", "distributed", "tornado"}:  # what matters is told
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # here; threads outlive this
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"(distributed|dask|tornado)\.")
        asyncio.run(_ask(address))  # a client that finds nobody takes a minute to give up
        with distributed.Client(address, timeout=ANSWERS_WITHIN) as client:
            yield client


async def _ask(address: str) -> None:
    from distributed.core import rpc
    from distributed.security import Security

    try:
        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=ANSWERS_WITHIN, connection_args=arguments) as there:
            identity = await asyncio.wait_for(there.identity(), ANSWERS_WITHIN)
            if identity["type"] == "Scheduler":
                return
    except (OSError, ValueError, TypeError, KeyError, ImportError):
        pass
    raise MadrobError(
        f"--scheduler {terminal_safe(address)}: no Dask scheduler answers there: give the address "
        "that it prints, as in tcp://10.0.0.5:8786"
    )


def _demand_fitting(client: Client, address: str, paths: Sequence[str]) -> None:
    try:
        client.wait_for_workers(1, timeout=ANSWERS_WITHIN)
    except TimeoutError:
        raise MadrobError(
            f"--scheduler {address}: it has no workers: start `dask worker {address}`"
        ) from None
    try:
        why_unfit_by_worker: dict[str, object] = client.run(why_unfit, versions(), list(paths))
    except Exception as error:  # noqa: BLE001  whatever it is, they cannot
        raise MadrobError(
            f"--scheduler {address}: its workers cannot run this program "
            f"({type(error).__name__}: {terminal_safe(str(error)[:200])}): install the same "
            "madrob-console there"
        ) from None
    for worker, why in sorted(why_unfit_by_worker.items()):
        if why is not None:
            raise MadrobError(f"worker {worker} {why}")


def _gone() -> MadrobError:
    return MadrobError("the scheduler went away: start it, and this command, again")
