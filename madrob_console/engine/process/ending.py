"""Ending an engine's process, whatever its version and whether it still answers."""

from __future__ import annotations

import os
import select
import signal
import socket
from contextlib import suppress
from types import TracebackType
from typing import Self

from madrob_console.engine.process.engines import FoundEngine
from madrob_console.engine.process.owned import Peer, address_of, holder_of, peer_of
from madrob_console.errors import MadrobError


class EngineHandle:
    """Holds on to the process of an engine that was found: no other one can take its number.

    Args:
        found: the engine.

    Raises:
        MadrobError: its process cannot be reached from here.
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
        """Wait at most `patience` s for its end; returns whether it has ended."""
        poll = select.poll()
        poll.register(self._process, select.POLLIN)
        return bool(poll.poll(1000 * patience))

    def terminate(self) -> None:
        """Ask it to end in order: a run that goes on is kept as interrupted."""
        for number in (signal.SIGTERM, signal.SIGCONT):  # one that was stopped has to go on for it
            self._send(number)

    def kill(self) -> None:
        """End it at once: the next engine finds what it leaves behind."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._process, number)


def _is_still(found: FoundEngine) -> bool:
    """Whether the engine still listens, and the process is its own and this user's."""
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
