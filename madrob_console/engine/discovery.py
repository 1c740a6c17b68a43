"""Finds, locks and ends the engines of this user."""

from __future__ import annotations

import os
import select
import shlex
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.engine import wire
from madrob_console.engine.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    connect_to,
    files_of,
    holder_in,
    holder_of,
    listen_on,
    lock_file,
    names_in_use,
    state_folder,
    testbed_in,
    threads_of,
)

PATIENCE = 2.0
"""An engine without an answer for this long is silent, s."""

_LOCKING_TIME = 1.0
"""A disk without an answer for this long hangs, s."""

_PROCESSES = Path("/proc")

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class FoundEngine:
    """An engine that was found by its name.

    Attributes:
        answer: what it says of itself; None = it is silent.
        since: start of its process, s since the epoch; None where that cannot be seen.
    """

    name: str
    pid: int
    answer: wire.WhoAnswer | None
    since: float | None

    @property
    def label(self) -> str:
        if self.answer is not None and self.answer.testbed:
            return terminal_safe(self.answer.testbed)
        if self.domain is not None:
            return f"LIVE ros domain {self.domain}"
        return f"{self.kind} testbed"

    @property
    def who(self) -> str:
        return f"{self.label}, {self.process}"

    @property
    def process(self) -> str:
        since = "" if self.since is None else f", since {_clock_time(self.since)}"
        return f"pid {self.pid}{since}"

    @property
    def testbed(self) -> str:
        """As in `Owned`."""
        return testbed_in(self.name)

    @property
    def kind(self) -> str:
        first = self.testbed.partition("/")[0]
        return SourceKind.ROS.value if first == "domain" else first

    @property
    def domain(self) -> int | None:
        kind, _, key = self.testbed.partition("/")
        return int(key) if kind == "domain" and key.isdecimal() else None

    @property
    def results(self) -> Path | None:
        """Of a silent engine the folder that it has locked; None where there is none."""
        if self.answer is not None:
            return Path(self.answer.results) if self.answer.results else None
        return next((file.parent for file in files_of(self.pid) if file.name == LOCK_FILE), None)

    def has_results_in(self, folder: Path) -> bool:
        """Whether it keeps its runs there, whatever path leads there."""
        results = self.results
        with suppress(OSError):
            return results is not None and (results == folder or results.samefile(folder))
        return False

    @property
    def killed(self) -> bool:
        """Whether it was killed and still runs, as while the machine waits for a disk."""
        pending = []
        for thread in threads_of(self.pid):
            with suppress(OSError):
                lines = (thread / "status").read_text().splitlines()
                told = [line.split()[1] for line in lines if line.startswith(("SigPnd", "ShdPnd"))]
                pending += [int(mask, 16) for mask in told]
        return any(mask >> (signal.SIGKILL - 1) & 1 for mask in pending)

    def attach_line(self, command: str = "console") -> str:
        if self.answer is None or not self.answer.console:
            return ""
        return terminal_safe(shlex.join(["madrob", command, *self.answer.console]))

    @property
    def end_words(self) -> str:
        return f"`{self.stop_line}` ends it"

    @property
    def stop_line(self) -> str:
        if self.domain is not None:
            what = ["--testbed", "ros", "--domain", str(self.domain)]
        elif self.results is not None:
            what = ["--results", str(self.results)]
        else:
            what = ["--pid", str(self.pid)]
        return terminal_safe(shlex.join(["madrob", "engine", "stop", *what]))


def ask(name: str, question: wire.First, patience: float = PATIENCE) -> wire.FromEngine | None:
    """Ask the engine of this user that has a name; None = it has none, or has just ended.

    Raises:
        TimeoutError: it is silent.
        MadrobError: it answers something else.
    """
    try:
        connection, _ = connect_to(name, patience)
        with connection:
            connection.sendall(wire.frame(question))
            return wire.receive(connection)
    except TimeoutError:
        raise
    except OSError:
        return None


def found_at(name: str) -> FoundEngine | None:
    """The engine of this user that has a name, even if it is silent."""
    answer: wire.FromEngine | None = None
    with suppress(TimeoutError, MadrobError):
        if (answer := ask(name, wire.Who())) is None:
            return None
    if (pid := holder_of(name)) is None:
        return None
    return FoundEngine(
        name, pid, answer if isinstance(answer, wire.WhoAnswer) else None, began(pid)
    )


def running_engines(
    testbed: str | None = None, besides: str | None = None
) -> tuple[FoundEngine, ...]:
    """Every engine of this user, or those of a testbed; but the one with the name `besides`."""
    names = sorted(names_in_use(testbed).keys() - {besides})
    with ThreadPoolExecutor() as pool:  # one that hangs holds up nobody else's answer
        return tuple(found for found in pool.map(found_at, names) if found is not None)


def began(pid: int) -> float | None:
    """Start of a process, s since the epoch; None where that cannot be seen."""
    try:
        ticks = int((_PROCESSES / str(pid) / "stat").read_text().rpartition(")")[2].split()[19])
        up = float((_PROCESSES / "uptime").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
    return time.time() - up + ticks / os.sysconf("SC_CLK_TCK")


def _clock_time(moment: float) -> str:
    local, now = time.localtime(moment), time.localtime()
    same_day = local[:3] == now[:3]
    return time.strftime("%H:%M" if same_day else "%Y-%m-%d %H:%M", local)


# The locks of an engine: a file in its results folder, and one for its ROS domain in a folder that
# only this user can change. Another user or another machine may hold the first, nobody the second.


@dataclass(frozen=True, slots=True)
class Holding:
    """What an engine holds.

    Attributes:
        listening: has its name; whoever connects must be answered.
        remarks: what could not be locked and the consequence, in words.
    """

    name: str
    listening: socket.socket
    locks: tuple[int, ...]
    remarks: tuple[str, ...]

    def keep(self) -> None:
        """Keep all of it until the process ends: a thread may wait for a disk and still write."""
        for handle in (*self.locks, self.listening.fileno()):
            os.dup(handle)


@contextmanager
def held(owned: Owned) -> Iterator[Holding]:
    """Hold everything that an engine owns while inside; never waits for another process.

    Creates the results folder if there is none.

    Raises:
        HeldError: another engine holds some of it; the message names that and what to do.
    """
    for found in running_engines(owned.testbed):
        raise HeldError(_taken(owned.words, found), same=True)
    wanted = {}
    if owned.domain is not None:
        wanted[state_folder() / f"domain_{owned.domain}.lock"] = owned.words
    if owned.results is not None:
        wanted[owned.results / LOCK_FILE] = str(owned.results)
    locks, remarks = [], []
    with ExitStack() as stack:
        name, listening = listen_on(owned.testbed)
        stack.enter_context(listening)
        for path, words in wanted.items():
            try:
                lock = _in_time(partial(lock_file, path))
            except OSError as error:
                _refuse_second(owned, path, words, name, locked=isinstance(error, BlockingIOError))
                if isinstance(error, FileExistsError):
                    continue  # a file is in the folder's place: whoever writes there says so
                why = error.strerror or "it does not answer"
                remarks.append(f"{path}: {why}: other engines are not kept off {words}")
            else:
                stack.callback(os.close, lock)
                locks.append(lock)
        yield Holding(name, listening, tuple(locks), tuple(remarks))


def _refuse_second(owned: Owned, path: Path, words: str, name: str, *, locked: bool) -> None:
    for found in running_engines(besides=name):
        same = found.testbed == owned.testbed
        if same or (path.name == LOCK_FILE and found.has_results_in(path.parent)):
            raise HeldError(_taken(owned.words if same else words, found), same=same)
    if locked:
        raise HeldError(
            f"{words} has an engine already ({holder_in(path)}), of another user, another machine "
            "or another container: end it there, or use another --results",
            same=False,
        )


def _taken(words: str, found: FoundEngine) -> str:
    line = found.attach_line()
    attach = f"`{line}` attaches to it, " if line else ""
    said = f"{words} has an engine already ({found.who}): {attach}{found.end_words}"
    return said if words.startswith(("ROS", "this")) else f"{said}, or use another --results"


def _in_time(job: Callable[[], _T]) -> _T:
    """Do a job that a disk may hold up; `TimeoutError` leaves a late one to itself."""
    answer: Future[_T] = Future()

    def work() -> None:
        try:
            answer.set_result(job())
        except BaseException as error:  # noqa: BLE001  whoever waits gets it
            answer.set_exception(error)

    threading.Thread(target=work, name="holding", daemon=True).start()
    return answer.result(_LOCKING_TIME)


# Ending an engine's process, whatever its version and whether or not it answers.


@contextmanager
def process_of(found: FoundEngine) -> Iterator[int]:
    """A handle of its process while inside: no other process can take its number.

    Raises:
        ProcessLookupError: it has ended meanwhile.
    """
    process = os.pidfd_open(found.pid)
    try:
        if holder_of(found.name) != found.pid:
            raise ProcessLookupError
        yield process
    finally:
        os.close(process)


def has_ended(process: int, patience: float = 0.0) -> bool:
    """Wait at most `patience` s for its end."""
    poll = select.poll()
    poll.register(process, select.POLLIN)
    return bool(poll.poll(1000 * patience))


def send_signals(process: int, *numbers: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        for number in numbers:
            signal.pidfd_send_signal(process, number)
