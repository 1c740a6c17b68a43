"""A scorer in a process of its own: neither its load nor its end is the engine's."""

from __future__ import annotations

import itertools
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.engine_thread import fail
from madrob_console.engine.scorer import EarlierRun, RenderedResult, ToScore
from madrob_console.engine.scoring_protocol import (
    FEW,
    Asked,
    Failed,
    Made,
    Questions,
    ReadBack,
    Ready,
    Remark,
    Score,
    ToEngine,
    answer_of_process,
    delay_after,
    parts_in_memory,
)
from madrob_console.engine.wire import frame
from madrob_console.engine.worker import END_TIME, LOOK_PERIOD, Child
from madrob_console.referee.run import Run
from scoring.evaluate import LiveAssessment
from scoring.signals import Sample

COMMAND = (sys.executable, "-P", "-m", "madrob_console.engine.scoring_worker")

FEED_PERIOD = 0.1
"""How often samples are handed on, s."""

PATIENCE = 20.0
"""A process with a question hangs if it shows no activity for this long, s."""

SOON = 3.0
"""After this, screens say that the result is being computed and why it takes longer, s."""

_SAFE = "the run is safe on disk"


class _Forwarded(LiveAssessment):
    hand_on: Callable[[Sample | Remark], None]

    def feed(self, sample: Sample) -> None:
        super().feed(sample)
        self.hand_on(sample)

    def report_problem(self, text: str) -> None:
        super().report_problem(text)
        self.hand_on(Remark(text))


class ScoringProcess:
    """Has runs scored in a process of its own; a `Scorer`.

    The process gets the samples as they come, so that a result is there soon. If it fails, only
    that try is lost: it is started again, and the run is read from its bag.
    """

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self.problem: str | None = None
        self.hopeless = False
        self._command = tuple(command)
        self._numbers = itertools.count(1)
        # Of the engine's thread.
        self._key = 0
        self._record: RunRecord | None = None
        self._stored = False
        self._wanted: int | None = None
        self._answers: SimpleQueue[Callable[[], None]] = SimpleQueue()
        # Of both threads.
        self._questions = Questions()
        self._closed = False
        self._lock = threading.Lock()  # of the bell
        self._bell: int | None = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        # Of the scorer's thread.
        self._process: Child[ToEngine] | None = None
        self._starts_failed = 0
        self._thread: threading.Thread | None = None

    # ------------------------------------------------------------------ the engine's thread

    def warm(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="scorer", daemon=True)
            self._thread.start()

    @property
    def pid(self) -> int | None:
        process = self._process
        return None if process is None else process.pid

    def follow(self, record: RunRecord, start: float) -> LiveAssessment:
        self._take_up(next(self._numbers), record, stored=False)
        self._questions.follow(self._key, record, start)
        self._ring()
        assessment = record.assessed_by(_Forwarded, start)
        assessment.hand_on = partial(self._questions.hand_on, self._key)
        return assessment

    def look_back(self, earlier: EarlierRun) -> None:
        self._take_up(earlier.key, earlier.scored.record, stored=True)

    def _take_up(self, key: int, record: RunRecord, *, stored: bool) -> None:
        self.warm()
        self._forget_wanted()
        self._key, self._record, self._stored = key, record, stored

    def _forget_wanted(self) -> None:
        self.hopeless = False
        if self._wanted is not None:
            self._questions.forget(self._wanted)
            self._wanted = None

    def read(self, folder: Path) -> Future[EarlierRun]:
        answer: Future[EarlierRun] = Future()
        question = ReadBack(next(self._numbers), next(self._numbers), self._key, str(folder))

        def take(made: Made, memory: int) -> None:
            if made.record is None or made.run is None:
                raise MadrobError("not a run that was read")
            scored = _rendered(made, memory, made.record, made.run)
            earlier = EarlierRun(folder, made.entries, scored, question.key, made.out_of_date)
            with suppress(Exception):  # it was given up
                answer.set_result(earlier)

        self.warm()
        self._ask(Asked(question, take, lambda why: fail(answer, why)))
        return answer

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        number, run = next(self._numbers), wanted.run
        assert self._record is not None
        record = self._record.corrected(run)
        folder, missing = str(wanted.folder), tuple(wanted.missing)
        question = Score(
            number, self._key, record, run, folder, missing, self._stored, wanted.files
        )

        def take(made: Made, memory: int) -> None:
            rendered = _rendered(made, memory, record, run)

            def deliver() -> None:
                if self._wanted == number:
                    self._wanted = None
                    done(rendered)

            self._answers.put(deliver)

        self._forget_wanted()
        self._wanted = number
        self._questions.end_following()
        self._ask(Asked(question, take))

    def deliver(self) -> None:
        with suppress(Empty):
            while True:
                self._answers.get_nowait()()

    def wait_until_idle(self, limit: float) -> bool:
        end = time.monotonic() + limit
        self.deliver()
        while self._wanted is not None and (rest := end - time.monotonic()) > 0:
            if self.hopeless:
                break
            with suppress(Empty):
                self._answers.get(timeout=min(rest, FEED_PERIOD))()
        return self._wanted is None

    def close(self) -> None:
        self._closed = True
        self._ring()
        if self._thread is not None:
            self._thread.join(2 * END_TIME + 1.0)

    def _ask(self, asked: Asked) -> None:
        self._questions.queue_question(asked)
        self._ring()

    def _ring(self) -> None:
        with self._lock, suppress(BlockingIOError):  # it rings already
            if self._bell is not None:
                os.eventfd_write(self._bell, 1)

    # ------------------------------------------------------------------ the scorer's thread

    def _work(self) -> None:
        """Keep a process running; no error ends the thread before `close`."""
        while not self._closed:
            why = f"the scoring process is started again: {self._one_process()}"
            if self._closed:
                break
            self._questions.all_failed(why, self._starts_failed)
            self._tell(why)
            self._pause(delay_after(self._starts_failed))
        with self._lock:
            bell, self._bell = self._bell, None
        assert bell is not None
        os.close(bell)
        for asked in self._questions.left():
            if asked.refuse is not None:
                asked.refuse("the engine has ended")

    def _one_process(self) -> str:
        self._starts_failed += 1
        try:
            self._process = process = Child(self._command, answer_of_process)
        except (OSError, MemoryError, subprocess.SubprocessError) as error:
            return f"no process can be started ({getattr(error, 'strerror', None) or error!r})"
        why = ""
        try:
            self._serve(process)
        except (EOFError, ConnectionError):
            pass
        except MadrobError as error:
            why = str(error)
            process.kill()
        except Exception as error:  # noqa: BLE001  one bug costs one process: the thread goes on
            why = terminal_safe(repr(error))
            process.kill()
        self._process = None
        ended = process.end()
        return why or ended

    def _serve(self, process: Child[ToEngine]) -> None:
        assert self._bell is not None
        poll = select.poll()
        poll.register(self._bell, select.POLLIN)
        out = memoryview(b"")
        while not self._closed:
            now = time.monotonic()
            out = out or memoryview(b"".join(map(frame, self._questions.next(now))))
            poll.register(process.link, select.POLLIN | (select.POLLOUT if out else 0))
            rest = 0.0 if self._questions.more and not out else self._rest(process, now)
            for handle, event in poll.poll(1000 * rest):
                if handle == self._bell:
                    os.eventfd_read(self._bell)
                    continue
                if event & ~select.POLLOUT:
                    for answer in process.receive():
                        self._take(process, answer)
                if event & select.POLLOUT:
                    with suppress(BlockingIOError):
                        out = out[process.link.send(out) :]

    def _rest(self, process: Child[ToEngine], now: float) -> float:
        """Time without anything to do, s."""
        ends = [now + (FEED_PERIOD if self._questions.following else LOOK_PERIOD)]
        moved = process.moved(now)
        for asked in self._questions.left():
            if asked.due > now:
                ends.append(asked.due)
                continue
            still = now - max(moved, asked.due)
            if still > PATIENCE:
                raise MadrobError(f"it did not move for {PATIENCE:g} s")
            if not asked.failures and now - asked.due > SOON and isinstance(asked.question, Score):
                why = "works on it" if still < SOON else "does not move"
                self.problem = f"the result is being computed: the scoring process {why}; {_SAFE}"
        return max(0.0, min(ends) - now)

    def _take(self, process: Child[ToEngine], answer: ToEngine) -> None:
        match answer:
            case Ready():
                self._starts_failed = 0
            case Failed(number, why):
                self._questions.has_failed(number, terminal_safe(why))
            case Made(number):
                if not process.memories:
                    raise MadrobError("its answer did not arrive: is there a file handle left?")
                memory = process.memories.popleft()
                try:
                    if (asked := self._questions.question_of(number)) is not None:
                        asked.take(answer, memory)
                        self._questions.forget(number)
                finally:
                    os.close(memory)
        self._tell("")

    def _tell(self, why: str) -> None:
        scores = [a for a in self._questions.left() if isinstance(a.question, Score)]
        asked = scores[-1] if scores else None
        failures = max(asked.failures if asked else 0, self._starts_failed - 1)
        self.problem = None
        self.hopeless = asked is not None and failures >= FEW
        if asked is not None and (failures or why):
            folder = Path(asked.question.folder).name
            why = why or asked.why
            self.problem = f"the result is being computed: {why}; {_SAFE}"
            if self.hopeless:
                self.problem = (
                    f"no result after {failures} tries: {why}. It is tried again; {_SAFE}. "
                    f"Set up the next one, then `madrob score {folder}` computes it, too"
                )
        elif why:
            self.problem = why

    def _pause(self, duration: float) -> None:
        assert self._bell is not None
        end = time.monotonic() + duration
        poll = select.poll()
        poll.register(self._bell, select.POLLIN)
        while not self._closed and (rest := end - time.monotonic()) > 0:
            if poll.poll(1000 * rest):
                os.eventfd_read(self._bell)


def _rendered(made: Made, memory: int, record: RunRecord, run: Run) -> RenderedResult:
    files, curves, report = parts_in_memory(memory, made)
    return RenderedResult(record, run, made.result, made.past, files, curves, report)
