from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator

import pytest

from tests.madrob_console.ros_peer import Peer

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
