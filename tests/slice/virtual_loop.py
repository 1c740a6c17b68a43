"""An event loop whose time jumps to the next timer, and stands while a thread works."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

from madrob_console.common.clock import Clock, nanoseconds


class _VirtualSelector(selectors.DefaultSelector):
    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.real_work = 0

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = super().select(0)
        if timeout == 0:  # callbacks wait for their turn
            return ready
        while not ready and self.real_work:
            ready = super().select(0.001)  # real time passes, virtual time stands
        if ready or timeout is None:
            return ready or super().select(timeout)
        self.now += timeout
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """Plays an hour in the time that the work of that hour takes."""

    def __init__(self) -> None:
        self._virtual = _VirtualSelector()
        super().__init__(self._virtual)

    def time(self) -> float:
        return self._virtual.now

    def run_in_executor(  # type: ignore[override]  # it returns one more future
        self,
        executor: Executor | None,
        job: Callable[..., Any],
        *args: Any,  # noqa: ANN401
    ) -> asyncio.Future[Any]:
        future = super().run_in_executor(executor, job, *args)
        self._virtual.real_work += 1
        # Called in this loop, once the answer is here: virtual time cannot overtake it.
        future.add_done_callback(self._count_down)
        return future

    def _count_down(self, _future: asyncio.Future[Any]) -> None:
        self._virtual.real_work -= 1


class LoopClock(Clock):
    """The time of an event loop, from `start_ns` on, ns since the epoch."""

    def __init__(self, loop: asyncio.AbstractEventLoop, start_ns: int) -> None:
        self._loop = loop
        self._start = start_ns

    def now_ns(self) -> int:
        return self._start + nanoseconds(self._loop.time())

    def sleep(self, duration: float) -> None:
        """Do nothing: who waits in an event loop awaits."""
