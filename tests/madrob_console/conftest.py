from __future__ import annotations

import importlib.util
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_NB, flock
from functools import cache
from pathlib import Path

import pytest

from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.ros_peer import Peer, Taker, source


@cache
def own_domain() -> int:
    """Of this process until it ends: test processes side by side must not hear each other."""
    for number in range(100):
        domain = (os.getpid() + number) % 100 + 1
        with suppress(OSError):
            name = Path(tempfile.gettempdir(), f"madrob-test-domain-{domain}")
            flock(os.open(name, os.O_CREAT | os.O_WRONLY), LOCK_EX | LOCK_NB)  # never closed
            return domain
    pytest.fail("every ROS domain is in use by tests")


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain on this machine only; skips where ROS is not installed."""
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return own_domain()


@pytest.fixture
def peer(ros_domain: int) -> Iterator[Peer]:
    """Another participant in the domain."""
    with Peer(ros_domain) as peer:
        yield peer


@pytest.fixture
def madrob(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Madrob:
    """Types command lines, without the settings of whoever tests."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return Madrob(capsys)


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
