"""The same work on many items, in order, by workers that may die."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from madrob_console.cli.output import complain

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from types import FrameType

WORTH_A_PROCESS = 10
"""By default a process gets at least this many items: it needs a second to start."""

_AHEAD = 4
"""Items handed out at once for each process."""

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")
_Item_contra = TypeVar("_Item_contra", contravariant=True)
_Done_co = TypeVar("_Done_co", covariant=True)


class DeadWorkerError(Exception):
    """The worker died that worked on an item; says in words what to do."""


class AgainError(Exception):
    """An item is to be handed out again: nothing came of it, by no fault of its own."""


class Workers(Protocol[_Item_contra, _Done_co]):
    """They work on items; a handle stands for an item that was handed out."""

    def hand_out(self, item: _Item_contra) -> object: ...

    def wait(self, handles: Sequence[Any]) -> Iterable[object]:
        """Wait for finished items: at least one, or none after a timeout."""
        ...

    def answer(self, handle: Any) -> _Done_co:  # noqa: ANN401  its own
        """The result of an item; raises `DeadWorkerError`, `AgainError`."""
        ...

    def cancel(self, handles: Sequence[Any]) -> None:
        """End the work in progress."""
        ...


def results(
    workers: Workers[_Item, _Done],
    items: Sequence[_Item],
    lost: Callable[[_Item, str], _Done],
    ahead: int,
) -> Generator[_Done, None, None]:
    """Yield the results in the order of the items, as they get ready.

    At most `ahead` are handed out or ready at once. An item whose worker died is tried once more
    alone, and then given up: `lost` makes its result from the reason in words. Closing the
    generator ends the work in progress.
    """
    waiting: dict[object, int] = {}
    ready: dict[int, _Done] = {}
    suspects: list[int] = []
    left = iter(range(len(items)))
    alone = False
    try:
        for number in range(len(items)):
            while number not in ready:
                alone = bool(suspects) if not waiting else alone
                room = 0 if suspects or alone else ahead - len(waiting) - len(ready)
                chosen = [suspects.pop()] if alone and not waiting else islice(left, max(room, 0))
                waiting.update({workers.hand_out(items[place]): place for place in chosen})
                for handle in workers.wait(list(waiting)):
                    place = waiting.pop(handle)
                    try:
                        ready[place] = workers.answer(handle)
                    except AgainError:
                        waiting[workers.hand_out(items[place])] = place
                    except DeadWorkerError as error:
                        if alone:
                            ready[place] = lost(items[place], str(error))
                        else:
                            suspects.append(place)
            yield ready.pop(number)
    finally:
        workers.cancel(list(waiting))


def in_order(
    work: Callable[[_Item], _Done],
    items: Sequence[_Item],
    lost: Callable[[_Item, str], _Done],
    jobs: int | None = None,
    at_once: int | None = None,
) -> Generator[_Done, None, None]:
    """Do the work on every item here; as `results`.

    Few items, or one job, are worked on in this process. `work`, its argument and its result must
    be importable by name. `jobs` None = as many as there are cores and enough to do. `at_once`
    limits the results in memory; None = they are small.
    """
    count = len(items) // WORTH_A_PROCESS if jobs is None else min(jobs, len(items))
    if jobs is None:
        count = min(count, len(os.sched_getaffinity(0)))
    if count < 2:
        return (work(item) for item in items)
    try:
        workers = _Processes(work, count)
    except OSError as error:  # hardened machines have no shared memory
        complain(f"no processes beside this one: {error.strerror}; it goes on alone")
        return (work(item) for item in items)
    ahead = _AHEAD * count
    return results(workers, items, lost, ahead if at_once is None else min(ahead, at_once))


class _Processes(Generic[_Item, _Done]):
    """Processes here; when one dies, all are started anew."""

    def __init__(self, work: Callable[[_Item], _Done], count: int) -> None:
        self._work = work
        self._count = count
        self._pool = self._new_pool()

    def _new_pool(self) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor

        # of its own program: a fork would copy the threads of numpy in the middle of their work
        return ProcessPoolExecutor(self._count, multiprocessing.get_context("spawn"))

    def hand_out(self, item: _Item) -> Future[_Done]:
        from concurrent.futures.process import BrokenProcessPool

        with children_spared():
            with suppress(BrokenProcessPool):
                return self._pool.submit(self._work, item)
            self._pool = self._new_pool()
            return self._pool.submit(self._work, item)

    def wait(self, handles: Sequence[Future[_Done]]) -> Iterable[Future[_Done]]:
        from concurrent.futures import FIRST_COMPLETED, wait

        return wait(handles, return_when=FIRST_COMPLETED).done

    def answer(self, handle: Future[_Done]) -> _Done:
        from concurrent.futures.process import BrokenProcessPool

        try:
            return handle.result()
        except BrokenProcessPool:
            raise DeadWorkerError(
                "the process died that worked on it: too little memory, or a fault of it"
            ) from None

    def cancel(self, handles: Sequence[Future[_Done]]) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.kill()  # one that just begins would complain of its end


@contextmanager
def children_spared() -> Iterator[None]:
    """Keep Ctrl+C from processes started while inside; it takes effect here afterwards.

    A terminal sends it to all processes, and each of them would print a traceback of its own.
    """
    from multiprocessing.resource_tracker import ensure_running

    interrupted = False

    def note(_number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True

    ensure_running()  # starting it would unblock the signal
    usual = signal.signal(signal.SIGINT, note)  # a thread of a library may get it, too
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # they inherit this for good
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        signal.signal(signal.SIGINT, usual)
    if interrupted:
        signal.raise_signal(signal.SIGINT)
