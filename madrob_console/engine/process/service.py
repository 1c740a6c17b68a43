"""An engine that systemd runs: what it tells the service manager, and its lines in the journal.

The service manager is told by datagrams (sd_notify(3)). The watchdog hears of the core: a core that
hangs is ended and started again; a disk that hangs is no reason.
"""

from __future__ import annotations

import asyncio
import faulthandler
import io
import os
import re
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import TextIO

from madrob_console.engine.shown.client import EngineClient
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

HANGING = 2
"""A core that has not moved for longer has hung, s: the watchdog hears no more of it."""

_PERIOD = 1.0
_LAST_WORDS = 0.5
"""Screens are told by then that the engine has failed, s."""

_NUMBERED = re.compile(r"<[0-7]>")


class Priority(IntEnum):
    """Of a line in the journal (syslog)."""

    ERROR = 3
    WARNING = 4
    INFORMATION = 6


class ServiceManager:
    """Who started this process as a service, if anybody did.

    Args:
        environment: `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID`, as systemd sets them.

    Attributes:
        present: whether there is one that listens.
        watchdog: it wants to hear of the core within this time, s; None = it does not.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self.present = self._address.startswith(("/", "\0"))
        self.watchdog = _watchdog(environment) if self.present else None

    def tell(self, *assignments: str) -> None:
        """Send `NAME=value` assignments; never waits, and nobody need be there."""
        if not self.present:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            sender.sendto("\n".join(assignments).encode(), self._address)


def _watchdog(environment: Mapping[str, str]) -> float | None:
    period = environment.get("WATCHDOG_USEC", "")
    whose = environment.get("WATCHDOG_PID", "")
    if not period.isdecimal() or int(period) == 0 or whose not in ("", str(os.getpid())):
        return None
    return int(period) / 1e6


async def keep_told(
    manager: ServiceManager,
    engine: EngineClient,
    words: Callable[[Snapshot], str],
    fail: Callable[[], None],
) -> None:
    """Tell that the engine is ready, and from then on how it is; until it is cancelled or fails.

    Args:
        manager: is told.
        engine: in this process.
        words: how far the run is, in a line, which stands in the log, too.
        fail: called when the engine has failed.
    """
    manager.tell("READY=1")
    period = _PERIOD if manager.watchdog is None else min(_PERIOD, manager.watchdog / 4)
    told = shown = ""
    while True:
        try:
            snapshot = engine.snapshot()
        except MadrobError as error:
            manager.tell(f"STATUS={error}")
            await asyncio.sleep(_LAST_WORDS)
            fail()
            return
        news = []
        if snapshot.pulse.core <= HANGING:
            news.append("WATCHDOG=1")
        if (status := words(snapshot)) != told:
            told = status
            log(status, Priority.INFORMATION)
        status = terminal_safe("; ".join((status, *_faults(snapshot)[:1])))
        if status != shown:
            shown = status
            news.append(f"STATUS={status}")
        manager.tell(*news)
        await asyncio.sleep(period)


def _faults(snapshot: Snapshot) -> list[str]:
    return [*filter(None, (snapshot.pulse.words,)), *snapshot.faults]


# ---------------------------------------------------------------------- lines in the journal


class PriorityLines(io.TextIOBase):
    """A text stream that puts a priority before each line, as the journal reads it.

    Args:
        stream: the journal.
        usual: of lines that have none of their own.
    """

    def __init__(self, stream: TextIO, usual: Priority) -> None:
        self._stream = stream
        self._usual = usual
        self._begun = ""

    def write(self, text: str) -> int:
        """Write whole lines; the rest waits for its end."""
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            own = _NUMBERED.match(line) is not None
            self._stream.write(f"{line}\n" if own else f"<{self._usual}>{line}\n")
        if lines:
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        """Write what was begun."""
        if self._begun:
            self.write("\n")

    def fileno(self) -> int:
        """Of the journal."""
        return self._stream.fileno()


def log_to_journal(environment: Mapping[str, str]) -> None:
    """Where the error output goes to the journal, each line has a priority from now on.

    The watchdog ends a process by SIGABRT: then it says where each thread was.
    """
    if not _is_journal(environment):
        return
    faulthandler.enable(sys.stderr)
    sys.stderr = PriorityLines(sys.stderr, Priority.ERROR)


def log(line: str, priority: Priority) -> None:
    """Write a line to the journal; nowhere else."""
    if isinstance(sys.stderr, PriorityLines):
        sys.stderr.write(f"<{priority}>{terminal_safe(line)}\n")


def _is_journal(environment: Mapping[str, str]) -> bool:
    """Whether the error output is the stream that systemd connected to the journal."""
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return environment.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
