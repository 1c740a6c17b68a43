"""A scorer in a process of its own: neither its load nor its end is the engine's."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, InvalidStateError, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from madrob_console.common.names import terminal_safe
from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult, ToScore
from madrob_console.engine.ipc.wire import fail
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.scoring_protocol import (
    Answered,
    Failed,
    answer_of_process,
    question_parts,
)
from madrob_console.engine.runtime.supervisor import LOOK_PERIOD, Worker, delay_after

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.runtime.scoring_worker")

SOON = 3.0
"""After this, screens say that the result is being computed and why it takes longer, s."""

FEW = 3
"""After so many failures the referee is told what to do."""


@dataclass(slots=True, eq=False)
class _Asked:
    """A run to be scored or a folder to be read, until it is answered.

    Attributes:
        due: when it may be tried (again), s of the monotonic clock.
        why: the last try failed, in words.
    """

    number: int
    what: ToScore | Path
    answer: Future[Any] = field(default_factory=Future)
    due: float = field(default_factory=time.monotonic)
    sent: bool = False
    failures: int = 0
    why: str = ""

    def note_failure(self, why: str) -> None:
        self.due = time.monotonic() + delay_after(self.failures)
        self.failures += 1
        self.sent, self.why = False, why


class ScoringProcess(Worker, Scorer):
    """Has runs scored in a process of its own.

    The process gets the samples of a run once, with the first request for its result. If it fails,
    only that try is lost: it is started again, and the run is read from its bag.
    """

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        super().__init__(command)
        self._numbers = itertools.count(1)
        self._warm = False
        self._restarted = ""  # why its process is started again
        self._handed: Path | None = None  # the run whose samples the process got
        # Both threads put in and take out, each a question at a time.
        self._asked: dict[int, _Asked] = {}
        # Of the engine's thread: the current run's result, if it is missing, and who gets it.
        self._current: tuple[_Asked, Callable[[RenderedResult], None]] | None = None

    # ------------------------------------------------------------------ the engine's thread

    def problem(self, place: str) -> str | None:
        current = self._current
        if current is None or current[0].answer.done():
            return self._restarted or None
        asked, failures = current[0], self._failures_of(current[0])
        why = self._restarted or asked.why
        if failures >= FEW:
            assert isinstance(asked.what, ToScore)
            name = asked.what.folder.name
            return (
                f"no result after {failures} tries: {why}. It is tried again; {place}. "
                f"Set up the next one, then `madrob score {name}` computes it, too"
            )
        now = time.monotonic()
        if not why and now - asked.due > SOON:
            still = now - max(self.moved, asked.due)
            why = f"the scoring process {'works on it' if still < SOON else 'does not move'}"
        return f"the result is being computed: {why}; {place}" if why else None

    @property
    def hopeless(self) -> bool:
        current = self._current
        return current is not None and self._failures_of(current[0]) >= FEW

    def _failures_of(self, asked: _Asked) -> int:
        return max(asked.failures, self.failures - 1)

    def warm(self) -> None:
        self._warm = True
        self.ring()

    def read(self, folder: Path) -> Future[EarlierRun]:
        return self._ask(folder).answer

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        self.forget()
        self._current = self._ask(wanted), done

    def forget(self) -> None:
        current, self._current = self._current, None
        if current is not None:
            self._asked.pop(current[0].number, None)

    def _ask(self, what: ToScore | Path) -> _Asked:
        asked = _Asked(next(self._numbers), what)
        self._asked[asked.number] = asked
        self.warm()
        return asked

    def deliver(self) -> None:
        if self._current is not None and self._current[0].answer.done():
            (asked, done), self._current = self._current, None
            done(asked.answer.result())

    def wait_until_idle(self, limit: float) -> bool:
        end = time.monotonic() + limit
        self.deliver()
        while self._current is not None and (rest := end - time.monotonic()) > 0:
            if self.hopeless:
                break
            wait([self._current[0].answer], min(rest, LOOK_PERIOD))
            self.deliver()
        return self._current is None

    # ------------------------------------------------------------------ the supervisor's thread

    @property
    def wanted(self) -> bool:
        return self._warm

    def begin(self) -> None:
        self._handed = None

    def work(self, now: float) -> float:
        rest = LOOK_PERIOD
        for asked in list(self._asked.values()):
            if asked.due > now:
                rest = min(rest, asked.due - now)
            elif not asked.sent and self.pid is not None:
                asked.sent = True
                self.send_parts(question_parts(asked.number, self._handed_over(asked)))
        return rest

    def _handed_over(self, asked: _Asked) -> ToScore | Path:
        """With the samples, unless the process has them or could do nothing with them."""
        what = asked.what
        if isinstance(what, Path) or what.assessment is None:
            return what
        if asked.failures or what.folder == self._handed:
            return replace(what, assessment=None)
        self._handed = what.folder
        return what

    def take(self, data: memoryview) -> None:
        self._restarted = ""
        match answer_of_process(data):
            case Failed(number, why):
                if (asked := self._asked.get(number)) is not None:
                    asked.note_failure(terminal_safe(why))
                    self._refuse_reading(asked, asked.why)
            case Answered(number, scored, entries, out_of_date):
                if (asked := self._asked.pop(number, None)) is not None:
                    answer: RenderedResult | EarlierRun = scored
                    if isinstance(asked.what, Path):
                        answer = EarlierRun(asked.what, entries, scored, out_of_date)
                    with suppress(InvalidStateError):  # it was given up
                        asked.answer.set_result(answer)

    def lose(self, why: str) -> None:
        self._restarted = f"the scoring process is started again: {why}"
        for asked in list(self._asked.values()):
            if asked.sent:
                asked.note_failure(self._restarted)
            if max(asked.failures, self.failures) >= FEW:
                self._refuse_reading(asked, f"it cannot be read: {self._restarted}")

    def due(self) -> float | None:
        return min((asked.due for asked in list(self._asked.values())), default=None)

    def end(self, deadline: float) -> None:
        super().end(deadline)
        for asked in list(self._asked.values()):
            self._refuse_reading(asked, "the engine has ended")

    def _refuse_reading(self, asked: _Asked, why: str) -> None:
        """A result is tried again without end; a run that cannot be read is not opened."""
        if isinstance(asked.what, Path):
            self._asked.pop(asked.number, None)
            fail(asked.answer, why)
