"""Two engines in one ROS domain: each says so, neither starts a run unasked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.clock import SystemClock
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.process.local import LocalEngine
from madrob_console.engine.shown.requests import Perform
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes
from madrob_console.referee.acts import SetUp
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import CheckState
from madrob_console.testbeds.ros import RosSource
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.watching import until

SOON = 2.0
"""s; and as long as DDS takes beside two busy cores."""
BUSY = 8.0


@pytest.fixture
def local(ros_domain: int, tmp_path: Path) -> Iterator[LocalEngine]:
    """An engine that no lock of this machine keeps out: as one of another machine."""
    clock, types = SystemClock(), MessageTypes()
    source = RosSource(DEFAULT_MAPPINGS, types, clock, ros_domain)
    config = EngineConfig(tmp_path / "own", DEFAULT_MAPPINGS, disk_needed=0)
    engine = LocalEngine(Engine(source, clock, config, types))
    try:
        yield engine
    finally:
        engine.close()


def referee_check(snapshot: Snapshot) -> tuple[CheckState, str]:
    check = next(c for c in snapshot.checks if c.name is CheckName.REFEREE)
    return check.state, check.reason


def named(snapshot: Snapshot) -> bool:
    return any(line.startswith("another referee: ") for line in snapshot.faults)


def test_each_of_two_engines_in_a_domain_names_the_other_and_one_that_was_killed_is_gone(
    local: LocalEngine, tmp_path: Path
) -> None:
    assert not named(local.snapshot())
    with EngineProcess(tmp_path / "other", None) as other:
        there = time.monotonic()
        until(lambda: named(local.snapshot()) and named(other.snapshot()), SOON + BUSY)
        print(f"both named after {time.monotonic() - there:.2f} s")
        for engine in (local, other.client):
            assert engine.ask(Perform.of(SetUp(make_setup()))) is None
            until(lambda engine=engine: engine.snapshot().run.setup is not None)  # type: ignore[misc]
            state, reason = referee_check(engine.snapshot())
            assert state is CheckState.FAILED  # one of those that block a start
            assert "publishes" in reason
        # a publisher may be known before the name of its node
        until(lambda: f"(pid {other.process.pid} on " in referee_check(local.snapshot())[1])
        other.process.kill()
        other.process.wait()
        killed = time.monotonic()
        until(lambda: not named(local.snapshot()), SOON + BUSY)
        print(f"gone after {time.monotonic() - killed:.2f} s")
    assert referee_check(local.snapshot())[0] is CheckState.OK
