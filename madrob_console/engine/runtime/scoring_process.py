"""A scorer in a process of its own. A crash or a busy scorer does not affect the engine."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult, ScoringRequest
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.supervisor import LOOK_PERIOD, Worker, delay_after

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.runtime.scoring_worker")

SOON = 3.0
"""After this, screens say that the result is being computed and why it takes longer, s."""

FEW = 3
"""After so many failures the referee is told what to do."""

_RESULT = msgspec.msgpack.Decoder(RenderedResult)
_EARLIER_RUN = msgspec.msgpack.Decoder(EarlierRun, dec_hook=lambda kind, value: kind(value))


@dataclass(slots=True, eq=False)
class _CurrentResult:
    """The missing result of the current run, and who gets it. It is retried without end.

    `problem` says why the last try failed; `due` is when this one may begin, monotonic s.
    """

    run: ScoringRequest
    on_result: Callable[[RenderedResult], None]
    answer: Future[RenderedResult]
    due: float
    failures: int = 0
    problem: str = ""


class ScoringProcess(Worker, Scorer):
    """Has runs scored in a process of its own.

    The process gets the samples of a run with the first request for its result, and keeps them.
    """

    loss = "the scoring process is started again"

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        super().__init__(command)
        # Of the engine's thread.
        self._current: _CurrentResult | None = None
        self._cached: tuple[int | None, Path] | None = None  # process, and run whose samples it has

    def problem(self, place: str) -> str | None:
        current = self._current
        if current is None or current.answer.done():
            return self.trouble or None
        why = self.trouble or current.problem
        if self.hopeless:
            name = current.run.folder.name
            return (
                f"no result after {current.failures} tries: {why}. It is tried again; {place}. "
                f"Set up the next one, then `madrob score {name}` computes it, too"
            )
        now = time.monotonic()
        if not why and now - current.due > SOON:
            still = now - max(self.moved, current.due)
            why = f"the scoring process {'works on it' if still < SOON else 'does not move'}"
        return f"the result is being computed: {why}; {place}" if why else None

    @property
    def hopeless(self) -> bool:
        return self._current is not None and self._current.failures >= FEW

    def warm(self) -> None:
        """The supervisor has started its process."""

    def read(self, folder: Path, deadline: float = math.inf) -> Future[EarlierRun]:
        return self.ask(folder, _EARLIER_RUN, deadline=deadline)

    def score(self, wanted: ScoringRequest, done: Callable[[RenderedResult], None]) -> None:
        self.forget()
        now, cached = time.monotonic(), self._cached == (self.pid, wanted.folder)
        question = replace(wanted, assessment=None) if cached else wanted
        self._current = _CurrentResult(wanted, done, self._ask_for(question, now), now)

    def _ask_for(self, wanted: ScoringRequest, due: float) -> Future[RenderedResult]:
        return self.ask(wanted, _RESULT, due=due, retries=0)

    def forget(self) -> None:
        current, self._current = self._current, None
        if current is not None:
            current.answer.cancel()

    def deliver(self) -> None:
        current = self._current
        if current is None or not current.answer.done():
            return
        if (problem := current.answer.exception()) is None:
            self._current, self._cached = None, (self.pid, current.run.folder)
            current.on_result(current.answer.result())
            return
        current.problem = str(problem)
        current.due = time.monotonic() + delay_after(current.failures)
        current.failures += 1
        current.answer = self._ask_for(current.run, current.due)

    def wait_until_idle(self, limit: float) -> bool:
        end = time.monotonic() + limit
        self.deliver()
        while self._current is not None and (rest := end - time.monotonic()) > 0:
            if self.hopeless:
                break
            wait([self._current.answer], min(rest, LOOK_PERIOD))
            self.deliver()
        return self._current is None
