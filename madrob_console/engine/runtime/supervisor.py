"""Child processes that work for the engine, and the threads that keep them running.

A worker answers questions (`Worker.ask`); one that reports unasked overrides the hooks. What a
child sends are frames as those of screens (`engine/ipc/wire.py`).
"""

from __future__ import annotations

import itertools
import math
import mmap
import os
import select
import signal
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.engine_interface import fail
from madrob_console.engine.ipc.wire import LENGTH, Reply, decoded, frame
from madrob_console.engine.requests import NO_ANSWER
from madrob_console.engine.runtime.worker_questions import question_parts

T = TypeVar("T")

LARGEST_FRAME = 256_000_000
"""Bytes; a larger frame is no message."""

LOOK_PERIOD = 0.5
"""How often a process is checked for activity, s."""

STOPPED_TIME = 2.0
"""A process that somebody stopped (SIGSTOP) is given up after this time, s."""

END_TIME = 2.0
"""Wait for the end of a process that is no longer needed, s."""

DELAYS = (0.0, 1.0, 5.0, 30.0)
"""Pause before the next try after so many failures, s."""


def delay_after(failures: int) -> float:
    """In s."""
    return DELAYS[min(failures, len(DELAYS) - 1)]


_STOPPED = "T"

_BUSY = ("R", "D")
"""States of a process that waits for the processor or a disk (proc(5))."""


class Child:
    """A process, its socket and its signs of life.

    The `command` gets the handle of its end of the socket as last word.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.link, theirs = socket.socketpair()
        with theirs:
            try:
                self.process = subprocess.Popen(
                    [*command, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # a thread costs memory
                    start_new_session=True,  # no hang-up and no Ctrl+C of a terminal reaches it
                )
            except BaseException:
                self.link.close()
                raise
        self.link.setblocking(False)
        self.out: deque[memoryview] = deque()
        self._is_body = False  # of what is received now
        self._data = self._rest = memoryview(b"")
        self._expect(LENGTH.size)
        self._looked = self.moved_at = time.monotonic()
        self._used = ""
        self._stopped: float | None = None

    def receive(self) -> memoryview | None:
        """Take what has come; a frame once it is whole.

        Raises:
            EOFError: the process has ended.
        """
        try:
            received = self.link.recv_into(self._rest)
        except BlockingIOError:
            return None
        if not received:
            raise EOFError
        self._rest = self._rest[received:]
        if self._rest:
            return None
        data, self._is_body = self._data, not self._is_body
        if not self._is_body:
            self._expect(LENGTH.size)
            return data
        (length,) = LENGTH.unpack(data)
        if not 0 < length <= LARGEST_FRAME:
            raise MadrobError(f"not a message: {length} bytes")
        self._expect(length)
        return None

    def _expect(self, length: int) -> None:
        """Receive so many bytes: the length of a message or the message itself.

        A result of a long run has 100 MB. The kernel makes this memory page by page as it is
        filled; clearing or copying it at once would hold up all threads.
        """
        self._data = self._rest = memoryview(mmap.mmap(-1, length, mmap.MAP_PRIVATE))

    def send_waiting(self) -> None:
        """Send what waits in `out`, as far as the socket takes it."""
        with suppress(BlockingIOError):
            while self.out:
                self.out[0] = self.out[0][self.link.send(self.out[0]) :]
                if not self.out[0]:
                    self.out.popleft()

    def moved(self, now: float) -> float:
        """When it last used the processor, waited for it or waited for a disk, s.

        Raises:
            MadrobError: somebody has stopped it.
        """
        if now - self._looked < LOOK_PERIOD:
            return self.moved_at
        self._looked = now
        with suppress(OSError):  # it has ended: its socket says so
            state, used = self._state()
            if state in _BUSY or used != self._used:
                self.moved_at, self._used = now, used
            if state != _STOPPED:
                self._stopped = None
            elif self._stopped is None:
                self._stopped = now
            elif now - self._stopped >= STOPPED_TIME:
                raise MadrobError(f"it was stopped for {STOPPED_TIME:g} s")
        return self.moved_at

    @property
    def stopped(self) -> bool:
        with suppress(OSError):
            return self._state()[0] == _STOPPED
        return False

    def _state(self) -> tuple[str, str]:
        """State and processor time (proc(5)); `OSError` once it has ended."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return fields[0], " ".join(fields[11:13])

    @property
    def ended(self) -> str:
        """How it ended, in words; empty while it runs."""
        code = self.process.poll()
        if code is None:
            return ""
        if code < 0:
            return f"it was ended by {signal.Signals(-code).name}"
        return f"it ended with code {code}"


_ENDED = "the engine has ended"

_replies = msgspec.msgpack.Decoder(Reply)


@dataclass(slots=True, eq=False)
class WorkerQuestion:
    """A question until it is answered.

    Attributes:
        due, deadline: earliest and latest time to begin, monotonic s.
        retries: how often it survives the end of the process.
        sent_at: when it was sent to the present process, monotonic s; None = not yet.
    """

    number: int
    content: Any
    decoder: msgspec.msgpack.Decoder[Any]
    due: float
    deadline: float
    urgency: int
    retries: int
    answer: Future[Any] = field(default_factory=Future)
    sent_at: float | None = None


class Worker:
    """A job that a child process does; the `Supervisor` keeps the process running.

    A process that ends, hangs or is stopped is started again after a growing pause. The worker's
    thread calls the hooks: none of them may wait. As they are here they ask the questions, one
    after the other.

    Attributes:
        loss: what it means that the process was lost, in words.
        patience: time without activity, while an answer is due, after which it hangs, s.
        longest: the same for one that is active (an endless loop), s.
        most_sent: how many questions the process may have at a time.
        failures: starts in a row after which no message came.
        trouble: why there is no working process, in words; empty = there is.
    """

    loss = "its process is started again"
    patience = 20.0
    longest = math.inf
    most_sent: float = 1

    def __init__(self, command: Sequence[str]) -> None:
        self.failures = 0
        self.trouble = ""
        self._command = tuple(command)
        self._child: Child | None = None
        self._next_start = -math.inf
        self._over = False
        self._lock = threading.Lock()  # of the bell
        self._bell: int | None = None
        self._numbers = itertools.count(1)
        # Any thread puts in, the worker's takes out.
        self._questions: dict[int, WorkerQuestion] = {}

    def ask(
        self,
        content: object,
        decoder: msgspec.msgpack.Decoder[T],
        *,
        due: float = -math.inf,
        deadline: float = math.inf,
        urgency: int = 0,
        retries: int = 1,
    ) -> Future[T]:
        """Ask the process something; never waits. From any thread.

        The answer, read by `decoder`, is set in the worker's thread. It fails with a
        `MadrobError` if the process refuses, if it was lost more than `retries` times, or if the
        question was not sent by the `deadline`, monotonic s. A lower `urgency` comes first.
        """
        number = next(self._numbers)
        question = WorkerQuestion(number, content, decoder, due, deadline, urgency, retries)
        self._questions[number] = question
        if self._over:
            self._refuse(question, _ENDED)
        self.ring()
        return question.answer

    def due_questions(self) -> list[WorkerQuestion]:
        """Those that may begin or have begun, the most urgent first. From any thread."""
        now = time.monotonic()
        due = [each for each in self.questions() if each.due <= now and not each.answer.cancelled()]
        return sorted(due, key=lambda each: (each.urgency, each.number))

    def questions(self) -> list[WorkerQuestion]:
        """All until what follows from their answers has happened. From any thread."""
        return list(self._questions.values())

    # ------------------------------------------------------------------ hooks

    @property
    def wanted(self) -> bool:
        """Whether its process should run now; one that is not wanted any more is ended."""
        return True

    @property
    def goes_on(self) -> bool:
        """Whether a process that is not wanted any more finishes its work alone."""
        return False

    def begin(self) -> None:
        """Tell a new process what it must know, by `send`."""
        for question in self.questions():
            question.sent_at = None

    def work(self, now: float) -> float:
        """Send what waits; returns how long nothing is to be done, s. `now` is monotonic, s."""
        questions = self.questions()
        for question in questions:
            unsent = question.sent_at is None
            if unsent and (question.deadline < now or question.answer.cancelled()):
                self._refuse(question, NO_ANSWER)
        for question in self.due_questions() if self.pid is not None else ():
            sent = sum(each.sent_at is not None for each in questions)
            if question.sent_at is None and sent < self.most_sent:
                question.sent_at = now
                self.send_parts(question_parts(question.number, question.content))
        return min((each.due - now for each in questions if each.due > now), default=LOOK_PERIOD)

    def take(self, data: memoryview) -> None:
        """Take a message of the process."""
        reply = decoded(_replies, data, "a message of a worker")
        question = self._questions.get(reply.number)
        if question is None:  # it is ready
            return
        if reply.failed is not None:
            fail(question.answer, terminal_safe(reply.failed))
        else:
            value = decoded(question.decoder, reply.value, "a message of a worker")
            with suppress(InvalidStateError):  # it was cancelled
                question.answer.set_result(value)
        del self._questions[reply.number]

    def lose(self, why: str) -> None:
        """Its process has ended, and why in words; it is started again."""
        questions = self.due_questions()
        for question in [each for each in questions if each.sent_at is not None] or questions[:1]:
            question.retries -= 1
            if question.retries < 0:
                self._refuse(question, f"{self.loss}: {why}")

    def due(self) -> float | None:
        """Since when an answer is due, monotonic s; None = none is."""
        sent = (each.sent_at for each in self.questions())
        return min((at for at in sent if at is not None), default=None)

    def _refuse(self, question: WorkerQuestion, why: str) -> None:
        fail(question.answer, why)
        self._questions.pop(question.number, None)

    # ------------------------------------------------------------------ for subclasses

    @property
    def pid(self) -> int | None:
        """Of its process; from any thread."""
        child = self._child
        return None if child is None else child.process.pid

    def send(self, message: msgspec.Struct) -> None:
        self.send_parts([frame(message)])

    def send_parts(self, parts: Iterable[bytes | memoryview]) -> None:
        """Send bytes, which are no frame, without copying them."""
        assert self._child is not None
        self._child.out.extend(map(memoryview, parts))

    @property
    def moved(self) -> float:
        """When its process was last seen active, monotonic s; from any thread."""
        child = self._child
        return -math.inf if child is None else child.moved_at

    def ring(self) -> None:
        """Have `wanted` and `work` looked at now; from any thread."""
        with self._lock, suppress(BlockingIOError):  # it rings already
            if self._bell is not None:
                os.eventfd_write(self._bell, 1)

    # ------------------------------------------------------------------ for the supervisor

    def run(self) -> None:
        """Keep its process running until it is closed; then end the process."""
        self._bell = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        while not self._over:
            pause = self._next_start - time.monotonic()
            if self.wanted and pause <= 0:
                self._run_process()
                continue
            with suppress(Exception):  # one bug: the thread goes on
                self.work(time.monotonic())
            self._rest(pause if pause > 0 else LOOK_PERIOD)
        for question in self.questions():
            self._refuse(question, _ENDED)
        with self._lock:
            os.close(self._bell)
            self._bell = None

    @property
    def is_over(self) -> bool:
        """Whether it was told to end: whatever is asked from now on is refused at once."""
        return self._over

    def end(self) -> None:
        """A process that goes on alone gets what waits for it."""
        self._over = True
        self.ring()

    def _run_process(self) -> None:
        """Start it, serve it until it is lost or not needed any more, and see it end."""
        self.failures += 1
        try:
            child = Child(self._command)
        except (OSError, MemoryError, subprocess.SubprocessError) as error:
            words = getattr(error, "strerror", None) or repr(error)
            self._note_loss(f"no process can be started ({words})")
            return
        self._child = child
        try:
            self.begin()
            why = self._serve(child)
        except (EOFError, ConnectionError):
            why = ""
        except MadrobError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001  one bug costs one process: the thread goes on
            why = terminal_safe(repr(error))
        self._child = None
        self._see_off(child, killed=bool(why))
        if why is not None:
            self._note_loss(why or child.ended or "it did not end by itself")

    def _serve(self, child: Child) -> str | None:
        """Until it is lost, and why in words, or not needed any more: None."""
        while True:
            now = time.monotonic()
            if (data := child.receive()) is not None:
                self.failures, self.trouble = 0, ""
                self.take(data)
            rest = self.work(now)
            child.send_waiting()
            if self._over:
                return None
            if not self.wanted:
                child.process.terminate()
                self.failures = 0
                return None
            moved, due = child.moved(now), self.due()
            if due is not None and now - max(moved, due) > self.patience:
                return f"it did not move for {self.patience:g} s"
            if due is not None and now - due > self.longest:
                return f"it gave no answer for {now - due:.0f} s"
            self._rest(min(rest, LOOK_PERIOD), child)

    def _rest(self, limit: float, child: Child | None = None) -> None:
        """Until the bell rings or the process says or takes something, `limit` s at most."""
        bell, poll = self._bell, select.poll()
        assert bell is not None
        poll.register(bell, select.POLLIN)
        if child is not None:
            poll.register(child.link, select.POLLIN | (select.POLLOUT if child.out else 0))
        poll.poll(1000 * limit)
        with suppress(BlockingIOError):
            os.eventfd_read(bell)

    def _see_off(self, child: Child, *, killed: bool) -> None:
        """Wait for its end; one that may not go on alone is killed after a while."""
        child.link.close()
        if killed:
            child.process.kill()
        with suppress(subprocess.TimeoutExpired):
            child.process.wait(END_TIME)
        may_go_on = self.goes_on and (self._over or not self.wanted) and not child.stopped
        if not child.ended and not may_go_on:
            child.process.kill()
            with suppress(subprocess.TimeoutExpired):  # it may hang in a disk: nobody can end it
                child.process.wait(END_TIME)

    def _note_loss(self, why: str) -> None:
        self._next_start = time.monotonic() + delay_after(self.failures)
        self.trouble = f"{self.loss}: {why}"
        self.lose(why)


class Supervisor:
    """Keeps the processes of all `workers` running, each in a thread, until it is closed."""

    def __init__(self, *workers: Worker) -> None:
        self._workers = workers
        self._threads = [
            threading.Thread(target=worker.run, name=type(worker).__name__, daemon=True)
            for worker in workers
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all processes; those that go on alone get what waits for them."""
        for worker in self._workers:
            worker.end()
        for thread in self._threads:
            thread.join(2 * END_TIME + 1.0)
