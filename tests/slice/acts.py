"""Performs the referee's acts: at most once, in effect when on disk, within 2 s or never."""

from __future__ import annotations

import asyncio
from functools import partial

from madrob_console.referee.acts import Abort, Act, Consequence, act_details
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from tests.slice.current_run import CurrentRun
from tests.slice.disk import Job

DURABLE_WITHIN = 2.0
"""An act takes effect within this time after it was asked for, or never, s."""


class Acts:
    """Performs one durable act at a time.

    Those that take effect at once never wait.

    Attributes:
        pending: the act that waits for the disk; None = none does.
    """

    def __init__(self, current: CurrentRun) -> None:
        self._current = current
        self._performed: dict[str, asyncio.Task[str | None]] = {}
        self._job: Job | None = None
        self.pending: Act | None = None

    async def perform(self, act: Act, act_id: str) -> str | None:
        """Perform an act and return its refusal, or None. The same id is performed once."""
        if act_id not in self._performed:
            self._performed[act_id] = asyncio.create_task(self._perform(act, act_id))
        # A screen that is gone does not stop what it has asked for.
        return await asyncio.shield(self._performed[act_id])

    async def _perform(self, act: Act, act_id: str) -> str | None:
        current = self._current

        # An abort before the run is active takes back what waits for the disk.
        if isinstance(act, Abort) and self._job is not None and not current.run.active:
            self._job.answer.cancel()
            return None
        if refusal := act.refusal(current.situation()):
            return refusal
        if self.pending is not None and not (act.at_once and current.run.active):
            return f"the disk has not taken the {self.pending.name} yet: wait for it"

        act = act.settled(current.situation())
        starts = Consequence.RECORDING in act.consequences
        if act.at_once or (current.recording is None and not starts):
            current.apply(act, self._line(act))
            return None
        return await self._perform_durable(act, act_id, starts=starts)

    async def _perform_durable(self, act: Act, act_id: str, *, starts: bool) -> str | None:
        entry = self._line(act, act_id)
        job = self._current.open_recording(entry) if starts else self._current.write(entry)
        self._job = job
        self.pending = act
        try:
            # `wait` leaves the job alone at the timeout: it may reach the disk later.
            await asyncio.wait([job.answer], timeout=DURABLE_WITHIN)
        finally:
            self._job = None
            self.pending = None

        if job.answer.done() and not job.answer.cancelled() and (error := job.answer.exception()):
            return f"{error}: see to the disk, then try again"
        # The run may have changed while the disk was writing.
        refusal = _withdrawn(job) or act.refusal(self._current.situation())
        if refusal:
            self._withdraw(job, entry, refusal, starts=starts)
            return f"{refusal}: it is withdrawn"

        if starts:
            self._current.begin_recording(job.answer.result())
        self._current.take_effect(act, entry)
        return None

    def _withdraw(self, job: Job, entry: Entry, refusal: str, *, starts: bool) -> None:
        """Cancel what was written, or may still be: the next line takes it back."""
        details = {"id": entry.id, "act": entry.what}
        now = self._current.now()
        withdrawal = Entry(now, Origin.SYSTEM, Change.WITHDRAWN, reason=refusal, details=details)
        was_opened = job.answer.done() and not job.answer.cancelled()
        job.answer.cancel()
        if not starts and job.begun:
            self._current.queue_line(withdrawal)
        elif was_opened:
            opened = job.answer.result()
            self._current.disk.queue(partial(opened.give_up, withdrawal), required=False)
        else:
            job.undo = lambda opened: opened.give_up(withdrawal)

    def _line(self, act: Act, act_id: str = "") -> Entry:
        current = self._current
        return Entry(
            current.now(),
            Origin.REFEREE,
            act.name,
            current.run.referee,
            act.reason_given,
            act_details(act),
            act_id,
        )


def _withdrawn(job: Job) -> str:
    """Why the disk's answer is not waited for any more.

    Empty = it is there.
    """
    if job.answer.cancelled():
        return "taken back by the referee"
    if not job.answer.done():
        return f"the disk did not take it within {DURABLE_WITHIN:g} s"
    return ""
