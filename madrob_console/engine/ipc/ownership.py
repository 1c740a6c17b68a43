"""Takes the locks of an engine: on its testbed and on its results folder.

Only this user can hold the first; another user or another machine may hold the second.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from madrob_console.engine.ipc.discovery import FoundEngine, find_engine, holder_of, running_engines
from madrob_console.engine.ipc.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    holder_in,
    lock_file,
    lock_results,
)
from madrob_console.engine.ipc.engine_sockets import listen_as, no_state, state_folder

_LOCKING_TIME = 1.0
"""A disk without an answer for this long hangs, s."""

_T = TypeVar("_T")


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
            engine = find_engine(owned.stem) or holder_of(owned.stem, None)
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
