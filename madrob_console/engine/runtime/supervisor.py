"""Child processes that work for the engine, and the one supervisor that keeps them running.

What a child sends are frames as those of screens (`engine/ipc/wire.py`), and so is what it gets
from `Worker.send`.
"""

from __future__ import annotations

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
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.wire import LENGTH, frame
from recorder.errors import remedy

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


class _Frame:
    """The length of a message or the message itself, until it is whole.

    A result of a long run has 100 MB. The kernel makes this memory page by page as it is filled;
    clearing or copying it at once would hold up all threads.
    """

    def __init__(self, length: int, *, is_body: bool = False) -> None:
        self.data = self.rest = memoryview(mmap.mmap(-1, length, mmap.MAP_PRIVATE))
        self.is_body = is_body


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
        self._frame = _Frame(LENGTH.size)
        self._looked = self.moved_at = time.monotonic()
        self._used = ""
        self._stopped: float | None = None

    def receive(self) -> memoryview | None:
        """Take what has come; a frame once it is whole.

        Raises:
            EOFError: the process has ended.
        """
        frame = self._frame
        try:
            received = self.link.recv_into(frame.rest)
        except BlockingIOError:
            return None
        if not received:
            raise EOFError
        frame.rest = frame.rest[received:]
        if frame.rest:
            return None
        if frame.is_body:
            self._frame = _Frame(LENGTH.size)
            return frame.data
        (length,) = LENGTH.unpack(frame.data)
        if not 0 < length <= LARGEST_FRAME:
            raise MadrobError(f"not a message: {length} bytes")
        self._frame = _Frame(length, is_body=True)
        return None

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
        told = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return told[0], " ".join(told[11:13])

    @property
    def ended(self) -> str:
        """How it ended, in words; empty while it runs."""
        code = self.process.poll()
        if code is None:
            return ""
        if code < 0:
            return f"it was ended by {signal.Signals(-code).name}"
        return f"it ended with code {code}"

    def ended_by(self, deadline: float) -> bool:
        """Wait until it has ended, or until the `deadline`, monotonic s."""
        while not self.ended and time.monotonic() < deadline:
            time.sleep(0.01)
        return bool(self.ended)


class Worker:
    """A job that a child process does; the `Supervisor` keeps the process running.

    A process that ends, hangs or is stopped is started again after a growing pause. Subclasses
    override the hooks, which the supervisor's thread calls: none of them may wait.

    Attributes:
        patience: time without activity, while an answer is due, after which it hangs, s.
        longest: the same for one that is active (an endless loop), s.
        failures: starts in a row after which no message came.
    """

    patience = 20.0
    longest = math.inf

    def __init__(self, command: Sequence[str]) -> None:
        self.failures = 0
        self.ring: Callable[[], None] = lambda: None
        self._command = tuple(command)
        self._child: Child | None = None
        self._leaving: Child | None = None
        self._left_at = self._next_start = -math.inf
        self._why: str | None = ""

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

    def work(self, now: float) -> float:
        """Send what waits; returns how long nothing is to be done, s. `now` is monotonic, s."""
        return LOOK_PERIOD

    def take(self, data: memoryview) -> None:
        """Take a message of the process."""
        raise NotImplementedError

    def lose(self, why: str) -> None:
        """Its process has ended, and why in words; it is started again."""

    def due(self) -> float | None:
        """Since when an answer is due, monotonic s; None = none is."""
        return None

    # ------------------------------------------------------------------ for subclasses

    @property
    def pid(self) -> int | None:
        """Of its process; from any thread."""
        child = self._child
        return None if child is None else child.process.pid

    def send(self, message: msgspec.Struct) -> None:
        self.send_parts([frame(message)])

    def send_parts(self, parts: Iterable[bytes]) -> None:
        """Send bytes, which are no frame, without copying them."""
        assert self._child is not None
        self._child.out.extend(map(memoryview, parts))

    @property
    def moved(self) -> float:
        """When its process was last seen active, monotonic s; from any thread."""
        child = self._child
        return -math.inf if child is None else child.moved_at

    def wait_until_left(self, limit: float) -> None:
        """Wait for the end of a process that is not wanted any more, `limit` s at most."""
        end = time.monotonic() + limit
        while (self._child or self._leaving) is not None and time.monotonic() < end:
            time.sleep(0.01)

    # ------------------------------------------------------------------ for the supervisor

    @property
    def link(self) -> tuple[socket.socket, int] | None:
        """The socket of its process, and the events to poll for."""
        child = self._child
        if child is None:
            return None
        return child.link, select.POLLIN | (select.POLLOUT if child.out else 0)

    def step(self, now: float) -> float:
        """Do what is to be done now; returns the time until the next step, s."""
        try:
            if self._leaving is not None:
                return self._reap(now, self._leaving)
            if self._child is None:
                return self._start(now)
            return self._serve(now, self._child)
        except (EOFError, ConnectionError):
            self._give_up("")
        except MadrobError as error:
            self._give_up(str(error))
        except Exception as error:  # noqa: BLE001  one bug costs one process: the thread goes on
            self._give_up(terminal_safe(repr(error)))
        return 0.0

    def _start(self, now: float) -> float:
        if not self.wanted:
            return LOOK_PERIOD
        if now < self._next_start:
            self.work(now)
            return self._next_start - now
        self.failures += 1
        try:
            self._child = Child(self._command)
        except (OSError, MemoryError, subprocess.SubprocessError) as error:
            told = getattr(error, "strerror", None) or repr(error)
            hint = f"; {what}" if (what := remedy(error)) else ""
            self._pause(f"no process can be started ({told}){hint}")
            return 0.0
        self.begin()
        return 0.0

    def _serve(self, now: float, child: Child) -> float:
        if (data := child.receive()) is not None:
            self.failures = 0
            self.take(data)
        rest = self.work(now)
        child.send_waiting()
        if not self.wanted:
            child.process.terminate()
            self.failures = 0
            self._give_up(None)
            return 0.0
        moved, due = child.moved(now), self.due()
        if due is not None and now - max(moved, due) > self.patience:
            raise MadrobError(f"it did not move for {self.patience:g} s")
        if due is not None and now - due > self.longest:
            raise MadrobError(f"it gave no answer for {now - due:.0f} s")
        return min(rest, LOOK_PERIOD)

    def _give_up(self, why: str | None) -> None:
        """Leave its process to itself; one of which something is known is killed.

        None = it was not wanted any more.
        """
        self._leaving, self._child = self._child, None
        self._why, self._left_at = why, time.monotonic()
        if self._leaving is not None:
            self._leaving.link.close()
            if why:
                self._leaving.process.kill()

    def _reap(self, now: float, child: Child) -> float:
        ended, waited = child.ended, now - self._left_at
        may_go_on = self.goes_on and not self.wanted and not child.stopped
        if not ended and waited < END_TIME:
            return 0.05
        if not ended and not may_go_on and waited < 2 * END_TIME:
            child.process.kill()  # it may hang in a disk: then nobody can end it
            return 0.05
        self._leaving = None
        if self._why is not None:
            self._pause(self._why or ended or "it did not end by itself")
        return 0.0

    def _pause(self, why: str) -> None:
        self._next_start = time.monotonic() + delay_after(self.failures)
        self.lose(why)

    def end(self, deadline: float) -> None:
        """End its process, which has until the `deadline` (monotonic s) to end by itself."""
        child, self._child = self._child or self._leaving, None
        self._leaving = None
        if child is None:
            return
        with suppress(OSError):
            child.send_waiting()
        child.link.close()
        if not child.ended_by(deadline) and (not self.goes_on or child.stopped):
            child.process.kill()
            child.ended_by(deadline + END_TIME / 2)


class Supervisor:
    """Keeps the processes of all `workers` running, in one thread, until it is closed."""

    def __init__(self, *workers: Worker) -> None:
        self._workers = workers
        self._closed = False
        self._lock = threading.Lock()  # of the bell
        self._bell: int | None = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        for worker in workers:
            worker.ring = self.ring
        self._thread = threading.Thread(target=self._work, name="workers", daemon=True)
        self._thread.start()

    def ring(self) -> None:
        """Have all workers looked after now; from any thread."""
        with self._lock, suppress(BlockingIOError):  # it rings already
            if self._bell is not None:
                os.eventfd_write(self._bell, 1)

    def close(self) -> None:
        """End all processes; those that go on alone get what waits for them."""
        self._closed = True
        self.ring()
        self._thread.join(2 * END_TIME + 1.0)

    def _work(self) -> None:
        bell = self._bell
        assert bell is not None
        while not self._closed:
            now = time.monotonic()
            rest = min((worker.step(now) for worker in self._workers), default=LOOK_PERIOD)
            poll = select.poll()
            poll.register(bell, select.POLLIN)
            for worker in self._workers:
                if worker.link is not None:
                    poll.register(*worker.link)
            poll.poll(1000 * rest)
            with suppress(BlockingIOError):
                os.eventfd_read(bell)
        deadline = time.monotonic() + END_TIME
        for worker in self._workers:
            with suppress(Exception):  # this program is at its end
                worker.work(time.monotonic())
            worker.end(deadline)
        with self._lock:
            self._bell = None
        os.close(bell)
