"""What the service manager hears, in a process that plays it; `whole` has a real engine."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.service import (
    HANGING,
    ServiceManager,
    keep_told,
)
from madrob_console.engine.snapshot import Pulse, Snapshot
from tests.madrob_console.engine.drive import Drive


@pytest.fixture
def heard(tmp_path: Path) -> Iterator[socket.socket]:
    """Where a service manager listens."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        yield listening


def manager_at(listening: socket.socket, **more: str) -> ServiceManager:
    return ServiceManager({"NOTIFY_SOCKET": str(listening.getsockname()), **more})


def taken(listening: socket.socket) -> list[str]:
    """Every datagram so far."""
    found: list[str] = []
    while True:
        try:
            found.append(listening.recv(4096).decode())
        except BlockingIOError:
            return found


class Told:
    """An engine that shows one snapshot after the other, then fails."""

    def __init__(self, *snapshots: Snapshot) -> None:
        self._left = list(snapshots)

    def snapshot(self) -> Snapshot:
        if not self._left:
            raise MadrobError("the engine has failed: no memory")
        return self._left.pop(0)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        raise AssertionError(name)


def test_nobody_is_told_where_there_is_no_service_manager() -> None:
    for environment in ({}, {"NOTIFY_SOCKET": "nowhere"}, {"NOTIFY_SOCKET": "/nowhere/at/all"}):
        manager = ServiceManager({**environment, "WATCHDOG_USEC": "1000000"})
        manager.send_assignments("READY=1")
        assert manager.present is environment.get("NOTIFY_SOCKET", "").startswith("/")


@pytest.mark.parametrize(
    ("given", "period"),
    [
        ({"WATCHDOG_USEC": "15000000", "WATCHDOG_PID": str(os.getpid())}, 15.0),
        ({"WATCHDOG_USEC": "500000"}, 0.5),
        ({"WATCHDOG_USEC": "15000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_that_of_this_process(
    given: dict[str, str], period: float | None, heard: socket.socket
) -> None:
    assert manager_at(heard, **given).watchdog == period


def test_the_watchdog_hears_of_a_core_that_moves_whatever_the_disk_does(
    heard: socket.socket, tmp_path: Path
) -> None:
    idle = Drive(tmp_path).engine.snapshot()
    engine = Told(
        idle,
        replace(idle, pulse=Pulse(disk=3600)),
        replace(idle, pulse=Pulse(core=HANGING)),
        replace(idle, pulse=Pulse(core=HANGING + 1)),
        replace(idle, pulse=Pulse(core=HANGING + 2)),
    )
    keep_told(
        manager_at(heard, WATCHDOG_USEC="4000"),
        engine,
        lambda snapshot: f"phase {snapshot.run.phase}",
        SimpleQueue(),
    )
    ready, *others, failed = taken(heard)
    assert (ready, failed) == ("READY=1", "STATUS=the engine has failed: no memory")
    assert ["WATCHDOG=1" in told for told in others] == [True, True, True, False, False]
    assert "STATUS=phase idle; disk silent for 3600 s" in others[1]
    assert "the engine has not moved for 3 s" in others[3]
