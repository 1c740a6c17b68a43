from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.ros_peer import Peer, Taker, source

DOMAIN = os.getpid() % 100 + 1  # test processes side by side must not hear each other


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain on this machine only; skips where ROS is not installed."""
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return DOMAIN


@pytest.fixture
def peer(ros_domain: int) -> Iterator[Peer]:
    """Another participant in the domain."""
    with Peer(ros_domain) as peer:
        yield peer


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Drive]:
    """An engine on a simulated testbed, with the test's folder for its results."""
    drive = Drive(tmp_path)
    yield drive
    drive.engine.close()


@pytest.fixture
def taker(peer: Peer) -> Iterator[Taker]:
    """Reads the testbed of that participant."""
    with Taker(source()) as taker:
        yield taker
