"""The locks of an engine, held by its process: no other one on its testbed or its results folder.

The names of `owned.py` keep the engines of this user and this machine apart, without a file. A lock
file in the results folder does so for other machines that share it over a network, and for other
users. Another user may have taken the names: then the lock files alone keep engines apart.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from madrob_console.engine.process.engines import FoundEngine, found_at
from madrob_console.engine.process.owned import (
    LOCK_FILE,
    HeldError,
    Owned,
    address_of,
    results_name,
)
from madrob_console.engine.process.place import place_of
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

_BACKLOG = 128
_PATIENCE = 1.0
_LOCKS = Path("/proc/locks")

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Holding:
    """What an engine holds.

    Attributes:
        listening: on each of its names; whoever connects is to be answered.
        lock: the file descriptor of the locked file; None without one.
        remarks: what could not be held, and what that means, in words.
    """

    listening: tuple[socket.socket, ...]
    lock: int | None
    remarks: tuple[str, ...]

    def keep(self) -> None:
        """Do not let go before the process ends: some of it waits for a disk and still writes."""
        for held in (*(one.fileno() for one in self.listening), self.lock):
            if held is not None:
                os.dup(held)


@contextmanager
def held(owned: Owned, *, lock_testbed: bool = False) -> Iterator[Holding]:
    """Hold everything that an engine owns while inside; waits for nobody.

    The results folder is made if there is none.

    Args:
        owned: by it.
        lock_testbed: hold the testbed's lock file in the runtime folder, too.

    Raises:
        HeldError: another engine has some of it; the message names that and what to do.
    """
    remarks, lock = [], None
    with ExitStack() as stack:
        names = {owned.testbed: owned.words}
        if owned.results is not None:
            try:
                name = _in_time(partial(_results_name, owned.results))
            except TimeoutError:
                remarks.append(f"{owned.results} does not answer: other engines are not kept out")
            else:
                names |= {} if name is None else {name: str(owned.results)}
        listening = []
        for each, words in names.items():
            try:
                bound = _bound(each, words, same=each == owned.testbed)
            except HeldError:
                raise
            except MadrobError as stranger:
                remarks.append(
                    f"{stranger}; until then a lock file alone keeps other engines off {words}"
                )
            else:
                listening.append(stack.enter_context(bound))
        if lock_testbed:
            stack.enter_context(place_of(owned).taken())
        if owned.results is not None and len(names) > 1:
            lock, problem = stack.enter_context(_locked(owned.results))
            remarks += [] if problem is None else [problem]
        yield Holding(tuple(listening), lock, tuple(remarks))


def _results_name(folder: Path) -> str | None:
    """The name of the results folder; None where there can be none: then nothing is recorded."""
    if not folder.is_dir():  # else not even that is written: the disk may hang
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return None
    return results_name(folder)


def _bound(name: str, words: str, *, same: bool) -> socket.socket:
    """A socket that listens on a name.

    Raises:
        HeldError: another engine has it.
        MadrobError: a process has it that is no engine of this user.
    """
    end = time.monotonic() + _PATIENCE
    while (listening := _free(name)) is None:
        if (found := found_at(name)) is not None:
            raise HeldError(_taken(words, found), same=same)
        if time.monotonic() > end:  # it has neither ended, nor does it begin to listen
            raise MadrobError(f"a process that does not listen has the name {name}: have it ended")
        time.sleep(0.01)
    return listening


def _free(name: str) -> socket.socket | None:
    """A socket that listens on a name; None where some process has the name."""
    listening = socket.socket(socket.AF_UNIX)
    try:
        listening.bind(address_of(name))
        listening.listen(_BACKLOG)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise
    return listening


def _taken(words: str, found: FoundEngine) -> str:
    """That another engine has it, which one, and what to do."""
    line = found.attach_line()
    attach = f"`{line}` attaches to it, " if line else ""
    said = f"{words} has an engine already ({found.who}): {attach}{found.end_words}"
    return said if words.startswith(("ROS", "this")) else f"{said}, or use another --results"


@contextmanager
def _locked(folder: Path) -> Iterator[tuple[int | None, str | None]]:
    """Hold the lock file of a results folder while inside.

    Yields:
        The file, and why it could not be held, in words; one of them is None.

    Raises:
        HeldError: another engine holds it.
    """
    path = folder / LOCK_FILE
    with ExitStack() as stack:
        lock = problem = None
        try:
            lock = _in_time(partial(_lock, path))
            stack.callback(os.close, lock)
        except OSError as error:
            holder = _holder_of(path)
            if holder not in (None, os.getpid()):  # this one may have it, and a disk that hangs
                raise HeldError(_elsewhere(folder, f"pid {holder}"), same=False) from None
            why = error.strerror or "it does not answer"
            problem = f"{path}: {why}: other users and other machines are not kept out"
        yield lock, problem


def _lock(path: Path) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    lock = os.open(path, flags, 0o600)
    try:
        if not stat.S_ISREG(os.fstat(lock).st_mode):
            raise OSError(errno.EINVAL, "no plain file")  # noqa: TRY301
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise HeldError(_elsewhere(path.parent, _said_in(lock)), same=False) from None
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"pid {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
    except BaseException:
        os.close(lock)
        raise
    return lock


def _in_time(job: Callable[[], _T]) -> _T:
    """Do what may wait for a disk.

    Raises:
        TimeoutError: it is not done in time, and left to itself.
    """
    answer: Future[_T] = Future()

    def work() -> None:
        try:
            answer.set_result(job())
        except BaseException as error:  # noqa: BLE001  whoever waits gets it
            answer.set_exception(error)

    threading.Thread(target=work, name="holding", daemon=True).start()
    return answer.result(_PATIENCE)


def _elsewhere(folder: Path, who: str) -> str:
    return (
        f"{folder} has an engine already ({who}), of another user, another machine or another "
        "container: end it there, or use another --results"
    )


def _said_in(lock: int) -> str:
    try:
        said = os.pread(lock, 200, 0).decode(errors="replace")
    except OSError:
        said = ""
    return terminal_safe(said.strip()) or "it does not say which"


def _holder_of(path: Path) -> int | None:
    """The process that holds the lock on a file of another user; None where none is seen."""
    try:
        found = path.lstat()
        device = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}:{found.st_ino}"
        for line in _LOCKS.read_text().splitlines():
            words = line.split()
            if "FLOCK" in words and device in words and "->" not in words:
                return int(words[words.index(device) - 1])
    except (OSError, ValueError):
        pass
    return None
