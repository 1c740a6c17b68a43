"""The disk of a run: one job after the other, and nobody waits for it longer than he wants."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

from madrob_console.common.errors import MadrobError

RETRY_PERIOD = 0.2
"""Pause before a required job that the disk refused is tried again, s."""


@dataclass(eq=False)
class Job:
    """Work that waits for the disk.

    Attributes:
        work: does it; OSError or MadrobError where the disk refuses.
        required: whether it is tried again until it is done.
        answer: what it returned or raised; who cancels it wants it no more.
        begun: whether the disk has it in hand: it may be done even if it is cancelled now.
        undo: what becomes of a result that nobody wants any more.
    """

    work: Callable[[], Any]
    required: bool
    answer: asyncio.Future[Any]
    begun: bool = False
    undo: Callable[[Any], None] | None = None


class Disk:
    """Does jobs in their order, in a thread of its own."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "disk")
        self._jobs: asyncio.Queue[Job] = asyncio.Queue()
        self._begun_at: float | None = None
        self.refused = ""

    @property
    def silent(self) -> float:
        """How long it has not answered, s."""
        if self._begun_at is None:
            return 0.0
        return asyncio.get_running_loop().time() - self._begun_at

    def queue(self, work: Callable[[], Any], *, required: bool) -> Job:
        """Have a job done after those that wait."""
        job = Job(work, required, asyncio.get_running_loop().create_future())
        self._jobs.put_nowait(job)
        return job

    async def work_off(self) -> None:
        """Do the jobs, as long as the program runs."""
        while True:
            await self._finish(await self._jobs.get())
            self._jobs.task_done()

    async def all_done(self) -> None:
        """Wait until no job is left."""
        await self._jobs.join()

    async def _finish(self, job: Job) -> None:
        while not job.answer.done():
            job.begun = True
            self._begun_at = asyncio.get_running_loop().time()
            try:
                result = await self.run(job.work)
            except (OSError, MadrobError) as error:
                await self._note_refusal(job, error)
                continue
            finally:
                self._begun_at = None

            self.refused = ""
            if not job.answer.done():
                job.answer.set_result(result)
            elif job.undo is not None:
                await self.run(partial(job.undo, result))

    async def _note_refusal(self, job: Job, error: Exception) -> None:
        self.refused = str(error)
        if job.required:
            await asyncio.sleep(RETRY_PERIOD)
        elif not job.answer.done():
            job.answer.set_exception(error)

    async def run(self, work: Callable[[], Any]) -> Any:  # noqa: ANN401  whatever the work returns
        """Do one job now.

        Tests put a slow or silent disk here.
        """
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)
