"""Every engine of this user: those that answer, those that hang, those of other versions.

They are found by the names that they own, and by the sockets in the runtime folders, which is all
that engines had before they owned names.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import socket
import time
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.engine.process.control import PATIENCE, Inquiry, WhoAnswer, ask, who_answer_in
from madrob_console.engine.process.owned import (
    LOCK_FILE,
    names_in_use,
    peer_of,
)
from madrob_console.engine.process.place import runtime_folders
from madrob_console.engine.shown import wire
from madrob_console.engine.shown.requests import Role
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.names import terminal_safe

_PROCESSES = Path("/proc")
_LONGEST_REFUSAL = 4096
_SPEAKS = re.compile(rb"the engine speaks version ([0-9]{1,6})")
"""In what an engine says to a screen of another version."""


@dataclass(frozen=True, slots=True)
class FoundEngine:
    """An engine that was found.

    Attributes:
        pid: its process; 0 where that cannot be seen.
        names: what it owns, as far as it was asked for; empty for one of an older version.
        path: the socket at which one was found that owns no name; else None.
        presence: what it says of itself; None where it says nothing.
        silent: whether it takes no notice of who calls.
        since: when its process began, s since the epoch; None where that cannot be seen.
        speaks: the version of the protocol, of one that says nothing else; None = unknown.
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
        """Its testbed, for people."""
        if self.presence is not None and self.presence.testbed:
            return terminal_safe(self.presence.testbed)
        if self.domain is not None:
            return f"LIVE ros domain {self.domain}"
        return f"{self.kind} testbed" if self.kind else "an engine"

    @property
    def who(self) -> str:
        """Which one it is, for people."""
        return f"{self.label}, {self.process}"

    @property
    def process(self) -> str:
        """Its process, for people: `pid 123, since 07:03`."""
        pid = f"pid {self.pid}" if self.pid else "in another container"
        return pid if self.since is None else f"{pid}, since {_clock_time(self.since)}"

    @property
    def kind(self) -> str:
        """Of its testbed; empty where that is not known."""
        if self.presence is not None and self.presence.kind:
            return self.presence.kind
        first = self.testbed.partition("/")[0]
        return SourceKind.ROS.value if first == "domain" else first

    @property
    def domain(self) -> int | None:
        """Its ROS domain; None without one."""
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
        """Where it keeps the runs; None where it keeps none, or does not say."""
        return Path(self.presence.results) if self.presence and self.presence.results else None

    @property
    def locked_folder(self) -> Path | None:
        """The results folder that its process holds, whether it answers or not; None = unseen."""
        for thread in self._threads:
            with suppress(OSError):
                for file in (thread / "fd").iterdir():
                    with suppress(OSError):
                        if (path := file.readlink()).name == LOCK_FILE:
                            return path.parent
        return None

    @property
    def _threads(self) -> list[Path]:
        """What the system shows of its threads: the first may be gone while another one hangs."""
        with suppress(OSError):
            return list((_PROCESSES / str(self.pid) / "task").iterdir())
        return []

    @property
    def killed(self) -> bool:
        """Whether it was killed and goes on all the same, as while the machine waits for a disk."""
        pending = []
        for thread in self._threads:
            with suppress(OSError):
                lines = (thread / "status").read_text().splitlines()
                told = [line.split()[1] for line in lines if line.startswith(("SigPnd", "ShdPnd"))]
                pending += [int(mask, 16) for mask in told]
        return any(mask >> (signal.SIGKILL - 1) & 1 for mask in pending)

    def attach_line(self, command: str = "console") -> str:
        """What to type to attach to it; empty where that is not known.

        Args:
            command: `console` or `watch`.
        """
        if self.presence is None or not self.presence.console:
            return ""
        return terminal_safe(shlex.join(["madrob", command, *self.presence.console]))

    @property
    def end_words(self) -> str:
        """What ends it and no other, for people."""
        return f"`{self.stop_line}` ends it" if self.pid else "end it there, where it runs"

    @property
    def stop_line(self) -> str:
        """What to type to end it and no other, where its process is seen."""
        if self.domain is not None:
            what = ["--testbed", "ros", "--domain", str(self.domain)]
        elif self.results is not None:
            what = ["--results", str(self.results)]
        else:
            what = ["--pid", str(self.pid)]
        return terminal_safe(shlex.join(["madrob", "engine", "stop", *what]))


def found_at(name: str, patience: float = PATIENCE) -> FoundEngine | None:
    """The engine that owns a name; None if nobody does.

    Args:
        name: what it owns.
        patience: one that has not answered after this time is silent, s.

    Raises:
        MadrobError: another user's process has it.
    """
    heard = ask(name, Inquiry("who"), patience)
    if heard is None:
        return None
    pid = heard.peer.pid
    presence = who_answer_in(heard.line) if heard.line else None
    return FoundEngine(pid, (name,), None, presence, not heard.line, began(pid))


def all_engines(names: Iterable[str] = ()) -> tuple[tuple[FoundEngine, ...], tuple[str, ...]]:
    """Every engine of this user, and what could not be looked at, in words.

    Args:
        names: to be asked for even where the system does not show which ones are in use.
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

    It is greeted by a screen of no version, which engines of all versions send away.
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
    """When a process began, s since the epoch; None where that cannot be seen."""
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
