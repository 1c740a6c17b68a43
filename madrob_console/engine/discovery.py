"""Finds, locks and ends the engines of this user.

They are found by the names that they own, and by the sockets in the runtime folders, which is all
that engines had before they owned names.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import select
import shlex
import signal
import socket
import stat
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.engine import wire
from madrob_console.engine.control import PATIENCE, Inquiry, WhoAnswer, ask_owner, who_answer_in
from madrob_console.engine.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    Peer,
    address_of,
    holder_of,
    names_in_use,
    peer_of,
    place_of,
    results_name,
    runtime_folders,
)
from madrob_console.engine.requests import Role

_PROCESSES = Path("/proc")
_LONGEST_REFUSAL = 4096
_SPEAKS = re.compile(rb"the engine speaks version ([0-9]{1,6})")


@dataclass(frozen=True, slots=True)
class FoundEngine:
    """An engine that was found.

    Attributes:
        pid: its process; 0 where that cannot be seen.
        names: those it owns, of the ones asked for; empty for an older version.
        path: its socket if it owns no name.
        silent: whether it ignores callers.
        since: start of its process, s since the epoch; None where that cannot be seen.
        speaks: protocol version of one that says nothing else.
    """

    pid: int
    names: tuple[str, ...]
    path: Path | None
    presence: WhoAnswer | None
    silent: bool
    since: float | None
    speaks: int | None = None

    @property
    def label(self) -> str:
        if self.presence is not None and self.presence.testbed:
            return terminal_safe(self.presence.testbed)
        if self.domain is not None:
            return f"LIVE ros domain {self.domain}"
        return f"{self.kind} testbed" if self.kind else "an engine"

    @property
    def who(self) -> str:
        return f"{self.label}, {self.process}"

    @property
    def process(self) -> str:
        pid = f"pid {self.pid}" if self.pid else "in another container"
        return pid if self.since is None else f"{pid}, since {_clock_time(self.since)}"

    @property
    def kind(self) -> str:
        if self.presence is not None and self.presence.kind:
            return self.presence.kind
        first = self.testbed.partition("/")[0]
        return SourceKind.ROS.value if first == "domain" else first

    @property
    def domain(self) -> int | None:
        if self.presence is not None:
            return self.presence.domain
        kind, _, key = self.testbed.partition("/")
        return int(key) if kind == "domain" and key.isdecimal() else None

    @property
    def testbed(self) -> str:
        """As in `Owned`; empty where only its results folder is known."""
        if self.path is not None:
            return self.path.stem.removeprefix("ros_").replace("_", "/", 1)
        return next((name for name in self.names if not name.startswith("results/")), "")

    @property
    def results(self) -> Path | None:
        return Path(self.presence.results) if self.presence and self.presence.results else None

    @property
    def locked_folder(self) -> Path | None:
        """The results folder that its process has locked, even if it is silent; None = unseen."""
        for thread in self._threads:
            with suppress(OSError):
                for file in (thread / "fd").iterdir():
                    with suppress(OSError):
                        if (path := file.readlink()).name == LOCK_FILE:
                            return path.parent
        return None

    @property
    def _threads(self) -> list[Path]:
        """Its threads in /proc: the first may be gone while another one hangs."""
        with suppress(OSError):
            return list((_PROCESSES / str(self.pid) / "task").iterdir())
        return []

    @property
    def killed(self) -> bool:
        """Whether it was killed and still runs, as while the machine waits for a disk."""
        pending = []
        for thread in self._threads:
            with suppress(OSError):
                lines = (thread / "status").read_text().splitlines()
                told = [line.split()[1] for line in lines if line.startswith(("SigPnd", "ShdPnd"))]
                pending += [int(mask, 16) for mask in told]
        return any(mask >> (signal.SIGKILL - 1) & 1 for mask in pending)

    def attach_line(self, command: str = "console") -> str:
        if self.presence is None or not self.presence.console:
            return ""
        return terminal_safe(shlex.join(["madrob", command, *self.presence.console]))

    @property
    def end_words(self) -> str:
        return f"`{self.stop_line}` ends it" if self.pid else "end it there, where it runs"

    @property
    def stop_line(self) -> str:
        if self.domain is not None:
            what = ["--testbed", "ros", "--domain", str(self.domain)]
        elif self.results is not None:
            what = ["--results", str(self.results)]
        else:
            what = ["--pid", str(self.pid)]
        return terminal_safe(shlex.join(["madrob", "engine", "stop", *what]))


def found_at(name: str, patience: float = PATIENCE) -> FoundEngine | None:
    """The engine that owns a name; one without an answer for `patience` s is silent."""
    heard = ask_owner(name, Inquiry("who"), patience)
    if heard is None:
        return None
    pid = heard.peer.pid
    presence = who_answer_in(heard.line) if heard.line else None
    return FoundEngine(pid, (name,), None, presence, not heard.line, began(pid))


def all_engines(names: Iterable[str] = ()) -> tuple[tuple[FoundEngine, ...], tuple[str, ...]]:
    """Every engine of this user, and what could not be examined, in words.

    The `names` are asked for even where the system does not show which ones are in use.
    """
    unseen: list[str] = []
    found: dict[object, FoundEngine] = {}
    for one in _by_name(names, unseen):
        key: object = one.pid or one.names
        known = found.get(key)
        if known is None:
            found[key] = one
        else:
            best = one if known.presence is None else known
            found[key] = replace(best, names=(*known.names, *one.names))
    old = _by_socket({one.pid for one in found.values()}, unseen)
    return (*found.values(), *old), tuple(unseen)


def _by_name(wanted: Iterable[str], unseen: list[str]) -> Iterator[FoundEngine]:
    names = set(wanted)
    try:
        names.update(names_in_use())
    except OSError as error:
        unseen.append(
            f"/proc/net/unix cannot be read ({error.strerror}): an engine whose runtime folder is "
            "lost is not listed; `engine stop` with --testbed, --domain or --results finds it"
        )
    with ThreadPoolExecutor() as pool:  # one that hangs holds up nobody else's answer
        for asked in [pool.submit(found_at, name) for name in sorted(names)]:
            try:
                found = asked.result()
            except MadrobError as error:
                unseen.append(str(error))
            else:
                if found is not None:
                    yield found


def _by_socket(known: Collection[int], unseen: list[str]) -> Iterator[FoundEngine]:
    folders, problems = runtime_folders()
    unseen.extend(problems)
    for folder in folders:
        with suppress(OSError):
            for path in sorted(folder.glob("*.sock")):
                if (found := found_behind(path, known)) is not None:
                    yield found


def found_behind(path: Path, known: Collection[int] = ()) -> FoundEngine | None:
    """The engine that listens on a socket in a runtime folder, unless its process is known.

    The greeting names no version: engines of all versions reject it.
    """
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(PATIENCE)
        pid, silent, speaks = 0, False, None
        try:
            connection.connect(str(path))
            peer = peer_of(connection)
            pid = peer.pid
            if peer.user != os.getuid() or pid in known:
                return None
            connection.sendall(wire.frame(wire.Hello(0, Role.WATCH, "madrob engine status")))
            if not (said := connection.recv(_LONGEST_REFUSAL)):
                return None  # it has just ended
            if (found := _SPEAKS.search(said)) is not None:
                speaks = int(found[1])
        except (TimeoutError, BlockingIOError):
            silent = True
        except OSError:
            return None
    return FoundEngine(pid, (), path, None, silent, began(pid) if pid else None, speaks)


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


# The locks of an engine on its testbed and its results folder.
#
# The names of `engine_lock.py` keep apart the engines of this user on this machine, without a
# file. A lock file in the results folder also keeps out other machines that share it over a
# network, and other users. If another user has taken the names, the lock files alone keep engines
# apart.


_BACKLOG = 128
_PATIENCE = 1.0
_LOCKS = Path("/proc/locks")

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Holding:
    """What an engine holds.

    Attributes:
        listening: one socket for each of its names; whoever connects must be answered.
        remarks: what could not be held and the consequence, in words.
    """

    listening: tuple[socket.socket, ...]
    lock: int | None
    remarks: tuple[str, ...]

    def keep(self) -> None:
        """Keep the locks until the process ends: a thread may wait for a disk and still write."""
        for held in (*(one.fileno() for one in self.listening), self.lock):
            if held is not None:
                os.dup(held)


@contextmanager
def held(owned: Owned, *, lock_testbed: bool = False) -> Iterator[Holding]:
    """Hold everything that an engine owns while inside; never waits for another process.

    Creates the results folder if there is none. With `lock_testbed` it also holds the testbed's
    lock file in the runtime folder.

    Raises:
        HeldError: another engine holds some of it; the message names that and what to do.
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
    """None where there can be no results folder: then nothing is recorded."""
    if not folder.is_dir():  # else not even that is written: the disk may hang
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return None
    return results_name(folder)


def _bound(name: str, words: str, *, same: bool) -> socket.socket:
    end = time.monotonic() + _PATIENCE
    while (listening := _free(name)) is None:
        if (found := found_at(name)) is not None:
            raise HeldError(_taken(words, found), same=same)
        if time.monotonic() > end:  # it has neither ended, nor does it begin to listen
            raise MadrobError(f"a process that does not listen has the name {name}: have it ended")
        time.sleep(0.01)
    return listening


def _free(name: str) -> socket.socket | None:
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
    line = found.attach_line()
    attach = f"`{line}` attaches to it, " if line else ""
    said = f"{words} has an engine already ({found.who}): {attach}{found.end_words}"
    return said if words.startswith(("ROS", "this")) else f"{said}, or use another --results"


@contextmanager
def _locked(folder: Path) -> Iterator[tuple[int | None, str | None]]:
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
    """Do a job that a disk may hold up; `TimeoutError` leaves a late one to itself."""
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


# Ending an engine's process, whatever its version and whether or not it answers.


class EngineHandle:
    """Holds the process of an engine that was found: no other process can take its number.

    Raises:
        MadrobError: the process cannot be reached from here.
        ProcessLookupError: it has ended meanwhile.
    """

    def __init__(self, found: FoundEngine) -> None:
        if not found.pid:
            raise MadrobError(f"{found.who}: its process is not seen from here, end it there")
        self._process = os.pidfd_open(found.pid)
        if not _is_still(found):
            os.close(self._process)
            raise ProcessLookupError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        os.close(self._process)

    def ended(self, patience: float) -> bool:
        """Wait at most `patience` s for its end."""
        poll = select.poll()
        poll.register(self._process, select.POLLIN)
        return bool(poll.poll(1000 * patience))

    def terminate(self) -> None:
        """Ask it to end in order: the current run is kept as interrupted."""
        for number in (signal.SIGTERM, signal.SIGCONT):  # one that was stopped has to go on for it
            self._send(number)

    def kill(self) -> None:
        """End it at once: the next engine recovers what it leaves behind."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._process, number)


def _is_still(found: FoundEngine) -> bool:
    ours = Peer(found.pid, os.getuid())
    places = [(address_of(name), name) for name in found.names]
    if found.path is not None:
        places.append((str(found.path), ""))
    for address, name in places:
        with socket.socket(socket.AF_UNIX) as knock:
            knock.settimeout(1.0)
            try:
                knock.connect(address)
                peer = peer_of(knock)
            except BlockingIOError:  # its backlog is full; only this user can make the path
                peer = holder_of(name) if name else ours
            except OSError:
                continue
            if peer == ours:
                return True
    return False
