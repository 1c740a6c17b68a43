"""A child process of the engine, and how long it has hung by itself.

What crosses are frames as those of screens (`engine/wire.py`), and handles.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from madrob_console.common.errors import MadrobError
from madrob_console.engine.wire import LENGTH

LARGEST_FRAME = 256_000_000
"""Bytes; a larger frame is no message."""

_T = TypeVar("_T")

LOOK_PERIOD = 0.5
"""How often the process is checked for activity, s."""

STOPPED_TIME = 2.0
"""A process that somebody stopped (SIGSTOP) is given up after this time, s."""

END_TIME = 2.0
"""Wait for the end of a process that is no longer needed, s."""

_STOPPED = "T"

_BUSY = ("R", "D")
"""States of a process that waits for the processor or a disk (proc(5))."""


class Started(Protocol):
    """A process, as `subprocess.Popen` has it."""

    @property
    def pid(self) -> int: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def kill(self) -> None: ...


def start_process(command: Sequence[str], link: socket.socket) -> Started:
    """Start a process; its `link` handle is appended to the command."""
    return subprocess.Popen(
        [*command, str(link.fileno())],
        stdin=subprocess.DEVNULL,
        pass_fds=[link.fileno()],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # a thread costs memory
        start_new_session=True,  # no hang-up and no Ctrl+C of a terminal reaches it
    )


class Child(Generic[_T]):
    """One process that works for the engine.

    `read` decodes a frame. `memories` are handles that came with answers; whoever takes one
    closes it.
    """

    def __init__(self, command: Sequence[str], read: Callable[[bytes], _T]) -> None:
        self._read = read
        self.link, theirs = socket.socketpair()
        with theirs:
            try:
                self._process = start_process(command, theirs)
            except BaseException:
                self.link.close()
                raise
        self.link.setblocking(False)
        self.memories: deque[int] = deque()
        self._received = bytearray()
        self._looked = self._moved = time.monotonic()
        self._used = ""
        self._stopped: float | None = None

    @property
    def pid(self) -> int:
        return self._process.pid

    def receive(self) -> list[_T]:
        """The messages that have come; raises `EOFError` when the process has ended."""
        try:
            data, memories, _, _ = socket.recv_fds(self.link, 1 << 18, 8)
        except BlockingIOError:
            return []
        self.memories.extend(memories)
        if not data:
            raise EOFError
        self._received += data
        return [self._read(each) for each in frames(self._received)]

    def end(self) -> str:
        self.link.close()
        while self.memories:
            os.close(self.memories.popleft())
        try:
            code = self._process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            with suppress(subprocess.TimeoutExpired):  # it hangs in a disk: nobody can end it
                self._process.wait(END_TIME)
            return "it did not end by itself"
        if code < 0:
            return f"it was ended by {signal.Signals(-code).name}"
        return f"it ended with code {code}"

    def leave(self) -> str:
        """Let it end by itself: waits a little, and kills it only if it was stopped."""
        self.link.close()
        while self.memories:
            os.close(self.memories.popleft())
        try:
            self._process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            if self._state()[:1] == [_STOPPED]:
                return self.end()
        return ""

    def moved(self, now: float) -> float:
        """When it last used the processor, waited for it or waited for a disk, s.

        Raises:
            MadrobError: somebody has stopped it.
        """
        if now - self._looked < LOOK_PERIOD:
            return self._moved
        self._looked = now
        with suppress(OSError):  # it has ended: its socket says so
            told = self._state()
            state, used = told[0], " ".join(told[11:13])
            if state in _BUSY or used != self._used:
                self._moved, self._used = now, used
            if state != _STOPPED:
                self._stopped = None
            elif self._stopped is None:
                self._stopped = now
            elif now - self._stopped >= STOPPED_TIME:
                raise MadrobError(f"it was stopped for {STOPPED_TIME:g} s")
        return self._moved

    def _state(self) -> list[str]:
        """Fields of proc(5); `OSError` once it has ended."""
        return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()

    def kill(self) -> None:
        self._process.kill()


def frames(received: bytearray) -> Iterator[bytes]:
    """Whole frames; removes them from `received`."""
    while len(received) >= LENGTH.size:
        (length,) = LENGTH.unpack_from(received)
        if length > LARGEST_FRAME:
            raise MadrobError(f"not a message: {length} bytes")
        end = LENGTH.size + length
        if len(received) < end:
            return
        data = bytes(memoryview(received)[LENGTH.size : end])
        del received[:end]
        yield data


# How long a process could have worked. Waiting for a disk or a processor is no hang.


THREADS_LOOK_PERIOD = 1.0
"""How often a process's threads are read, s."""

_DISK = "D"


@dataclass(frozen=True, slots=True)
class ThreadState:
    """State of a thread as in proc(5), and its wait for a processor since it began, s."""

    state: str
    waited: float


class HangDetector:
    """Counts the time in which none of a process's threads waited for a disk or a processor.

    `now` is s of a monotonic clock in all calls; `threads` gives the threads by number.
    """

    def __init__(self, now: float, threads: Callable[[], Mapping[int, ThreadState]]) -> None:
        self._threads = threads
        self._looked = now
        self._before: Mapping[int, ThreadState] = {}
        self._time = 0.0

    def restart_count(self, now: float) -> None:
        self._looked, self._time, self._before = now, 0.0, {}

    def since(self, now: float) -> float:
        """Time counted since `restart_count`, s; reads the process's threads now and then."""
        passed = now - self._looked
        if passed < THREADS_LOOK_PERIOD:
            return self._time
        threads, before = self._threads(), self._before
        self._looked, self._before = now, threads
        if not before or any(one.state == _DISK for one in threads.values()):
            return self._time
        waited = (one.waited - before[n].waited for n, one in threads.items() if n in before)
        self._time += max(0.0, passed - max(waited, default=0.0))
        return self._time


def threads_of(pid: int) -> Mapping[int, ThreadState]:
    """Threads that end meanwhile are left out."""
    found: dict[int, ThreadState] = {}
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError, ValueError, IndexError):
                state = (task / "stat").read_text().rpartition(")")[2].split()[0]
                found[int(task.name)] = ThreadState(state, _waited(task))
    return found


def _waited(task: Path) -> float:
    """Wait for a processor, s; 0 where the kernel does not count it."""
    try:
        return int((task / "schedstat").read_text().split()[1]) / 1e9
    except (OSError, ValueError, IndexError):
        return 0.0
