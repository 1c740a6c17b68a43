"""What systemd hears of the engine.

The service manager is told by datagrams (sd_notify(3)). The watchdog hears of the core: a core
that hangs is ended and started again; a disk that hangs is no reason.
"""

from __future__ import annotations

import faulthandler
import os
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.engine_interface import EngineClient
from madrob_console.engine.snapshot import Snapshot

HANGING = 2
"""A core that has not moved for longer hangs, s: the watchdog gets no more signs of life."""

_PERIOD = 1.0
_LAST_WORDS = 0.5
"""Time to tell the screens that the engine has failed, s."""


class ServiceManager:
    """The systemd that started this process, if `present`.

    It expects a sign of life of the core within `watchdog` s; None = it does not.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self.present = self._address.startswith(("/", "\0"))
        self.watchdog = _watchdog(environment) if self.present else None

    def send_assignments(self, *assignments: str) -> None:
        """Send `NAME=value` assignments; never waits, and needs no receiver."""
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


def keep_told(
    manager: ServiceManager,
    engine: EngineClient,
    words: Callable[[Snapshot], str],
    over: SimpleQueue[None],
) -> None:
    """Report that the engine is ready, then its state in the log; until it is over or fails.

    The watchdog ends a process by SIGABRT: then the log says where each thread was.
    """
    if manager.present:
        faulthandler.enable()
    manager.send_assignments("READY=1")
    period = _PERIOD if manager.watchdog is None else min(_PERIOD, manager.watchdog / 4)
    logged = shown = ""
    while True:
        try:
            snapshot = engine.snapshot()
        except MadrobError as error:
            manager.send_assignments(f"STATUS={error}")
            with suppress(Empty):
                over.get(timeout=_LAST_WORDS)
            return
        news = []
        if snapshot.pulse.core <= HANGING:
            news.append("WATCHDOG=1")
        if (status := words(snapshot)) != logged:
            logged = status
            if manager.present:
                sys.stderr.write(f"{terminal_safe(status)}\n")
        status = terminal_safe("; ".join((status, *_faults(snapshot)[:1])))
        if status != shown:
            shown = status
            news.append(f"STATUS={status}")
        manager.send_assignments(*news)
        with suppress(Empty):
            over.get(timeout=period)
            return


def _faults(snapshot: Snapshot) -> list[str]:
    return [*filter(None, (snapshot.pulse.words,)), *snapshot.faults]


class FallenThreads:
    """Threads that ended with an unforeseen error: their work is missing from then on."""

    def __init__(self) -> None:
        self.problem: str | None = None

    def note(self, fallen: threading.ExceptHookArgs) -> None:
        """A hook for `threading.excepthook`; the log has the traceback."""
        name = "?" if fallen.thread is None else fallen.thread.name
        why = str(fallen.exc_value or "") or fallen.exc_type.__name__
        self.problem = terminal_safe(
            f"a part of the engine has ended ({name}: {why}): start it again after the run"
        )
        threading.__excepthook__(fallen)
