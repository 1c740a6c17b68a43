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
from madrob_console.common.file_locks import is_held
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    connect_to,
    holder_in,
    listen_as,
    lock_file,
    lock_results,
    no_state,
    state_folder,
)

PATIENCE = 2.0
"""An engine without an answer for this long is silent, s."""

_LOCKING_TIME = 1.0
"""A disk without an answer for this long hangs, s."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class FoundEngine:
    """The engine of a testbed.

    Attributes:
        stem: names the testbed, as in `Owned`.
        results: where it records; None = nowhere.
        since: when it began, s since the epoch.
        answer: what it says of itself; None = it is silent.
    """

    stem: str
    pid: int
    results: Path | None
    since: float
    answer: wire.WhoAnswer | None

    @property
    def label(self) -> str:
        if self.answer is not None and self.answer.testbed:
            return terminal_safe(self.answer.testbed)
        if self.domain is not None:
            return f"LIVE ros domain {self.domain}"
        return f"{self.kind} testbed"

    @property
    def who(self) -> str:
        began = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.since))
        return f"{self.label}, pid {self.pid}, since {began}"

    @property
    def kind(self) -> str:
        return self.stem.partition("_")[0]

    @property
    def domain(self) -> int | None:
        last = self.stem.rpartition("_")[2]
        return int(last) if self.kind == SourceKind.ROS and last.isdecimal() else None

    def attach_line(self, command: str = "console") -> str:
        if self.answer is None or not self.answer.console:
            return ""
        return terminal_safe(shlex.join(["madrob", command, *self.answer.console]))

    @property
    def end_words(self) -> str:
        return f"`{self.stop_line}` ends it"

    @property
    def stop_line(self) -> str:
        return f"madrob engine stop --pid {self.pid}"


def ask(stem: str, question: wire.First, patience: float = PATIENCE) -> wire.FromEngine | None:
    """Ask the engine of a testbed; None = there is none, or it has just ended.

    Raises:
        TimeoutError: it is silent.
        MadrobError: it answers something else.
    """
    try:
        with connect_to(stem, patience) as connection:
            connection.sendall(wire.frame(question))
            return wire.receive(connection)
    except TimeoutError:
        raise
    except OSError:
        return None


def find_engine(stem: str) -> FoundEngine | None:
    """The engine of a testbed, even if it is silent."""
    answer: wire.FromEngine | None = None
    with suppress(TimeoutError, MadrobError):
        if (answer := ask(stem, wire.Who())) is None:
            return None
    return _holder_of(stem, answer)


def _holder_of(stem: str, answer: wire.FromEngine | None) -> FoundEngine | None:
    """The engine that holds the lock of a testbed: whoever else answers is none."""
    path = state_folder() / f"{stem}.lock"
    holder = holder_in(path)
    if not is_held(path) or not holder.pid:
        return None
    results = Path(holder.results) if holder.results else None
    description = answer if isinstance(answer, wire.WhoAnswer) else None
    return FoundEngine(stem, holder.pid, results, holder.since, description)


def running_engines(besides: str = "") -> tuple[FoundEngine, ...]:
    """Every engine of this user but that of the testbed `besides`."""
    stems = sorted({path.stem for path in state_folder().glob("*.sock")} - {besides})
    with ThreadPoolExecutor() as pool:  # one that hangs holds up nobody else's answer
        return tuple(engine for engine in pool.map(find_engine, stems) if engine is not None)


# The locks of an engine: on its testbed, which only this user can have, and on its results folder,
# which another user or another machine may have.


@dataclass(frozen=True, slots=True)
class EngineLocks:
    """What an engine holds.

    Attributes:
        listening: the testbed's socket; whoever connects must be answered.
        remarks: what could not be locked and the consequence, in words.
    """

    listening: socket.socket
    locks: tuple[int, ...]
    remarks: tuple[str, ...]

    def keep(self) -> None:
        """Keep all of it until the process ends: a thread may wait for a disk and still write."""
        for handle in (*self.locks, self.listening.fileno()):
            os.dup(handle)


@contextmanager
def held(owned: Owned) -> Iterator[EngineLocks]:
    """Hold everything that an engine owns while inside; never waits for another process.

    Creates the results folder if there is none.

    Raises:
        HeldError: another engine holds some of it; the message names that and what to do.
    """
    folder, remarks = state_folder(), list[str]()
    with ExitStack() as stack:
        try:
            locks = [lock_file(folder / f"{owned.stem}.lock", owned.results)]
            stack.callback(os.close, locks[0])
            listening = stack.enter_context(listen_as(owned.stem))
        except BlockingIOError:
            engine = find_engine(owned.stem) or _holder_of(owned.stem, None)
            raise HeldError(_taken(owned.words, engine), same=True) from None
        except OSError as error:
            raise no_state(folder, error) from None
        if owned.results is not None:
            try:
                locks.append(_in_time(partial(lock_results, owned.results)))
                stack.callback(os.close, locks[1])
            except OSError as error:
                if refusal := _refusal(owned.results, error, owned.stem):
                    raise HeldError(refusal, same=False) from None
                why = error.strerror or "it does not answer"
                if not isinstance(error, FileExistsError):  # whoever writes there says so
                    remarks.append(
                        f"{owned.results}: {why}: other engines are not kept off this folder"
                    )
        yield EngineLocks(listening, tuple(locks), tuple(remarks))


def _refusal(results: Path, error: OSError, own: str) -> str:
    """Why a results folder is refused: it has an engine, or may have another user's."""
    lock, other = results / LOCK_FILE, "or use another --results"
    for engine in running_engines(besides=own):
        if engine.results == results:
            return f"{_taken(str(results), engine)}, {other}"
    if isinstance(error, BlockingIOError):
        holder = holder_in(lock).words
        return f"{results} has an engine already ({holder}): end it there, {other}"
    if isinstance(error, PermissionError) and os.path.lexists(lock):
        return f"{lock} is another user's: delete it, {other}"
    return ""


def _taken(words: str, engine: FoundEngine | None) -> str:
    if engine is None:
        return f"{words} has had an engine a moment ago: try it again"
    line = engine.attach_line()
    attach = f"`{line}` attaches to it, " if line else ""
    return f"{words} has an engine already ({engine.who}): {attach}{engine.end_words}"


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
def process_of(engine: FoundEngine) -> Iterator[int]:
    """A handle of its process while inside: no other process can take its number.

    Raises:
        ProcessLookupError: it has ended meanwhile.
    """
    process = os.pidfd_open(engine.pid)
    try:
        now = _holder_of(engine.stem, None)
        if now is None or now.pid != engine.pid:
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
