"""An engine in this process, on a socket, and what its screens do."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

from madrob_console.common.clock import SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.ipc.engine_interface import EngineClient
from madrob_console.engine.ipc.engine_sockets import connect_to, listen_as
from madrob_console.engine.ipc.greeting import WhoAnswer
from madrob_console.engine.ipc.server import EngineServer
from madrob_console.engine.requests import Perform, Role
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.reports import Reporting
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.engine.runtime.supervisor import Supervisor
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Act, ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.watching import until

SPEED = 8.0
"""Times as fast as a run of a competition."""


def simulated(
    results: Path,
    speed: float = SPEED,
    scenario: Scenario = Scenario.NOMINAL,
    scorer: Scorer | None = None,
) -> Engine:
    clock, types = SystemClock(speed), MessageTypes()
    source = SimulatedSource(SimulatedTestbed(scenario), clock, types)
    config = EngineConfig(results, DEFAULT_MAPPINGS, disk_needed=0)
    return Engine(source, clock, config, types, disk=DiskThreads.threads(), scorer=scorer)


W = TypeVar("W", bound=ScoringProcess)


@contextmanager
def kept_running(scorer: W) -> Iterator[W]:
    """A supervisor keeps its process running, inside."""
    with closing(Supervisor(scorer)):
        scorer.warm()
        yield scorer


class Served:
    """An engine and its server in this process; a simulated one if none is given."""

    def __init__(
        self,
        folder: Path,
        idle_time: float = 60.0,
        engine: Engine | None = None,
        reporting: Reporting | None = None,
    ) -> None:
        engine = engine or simulated(folder / "runs")
        self.reporting = reporting
        self.local = LocalEngine(engine, reporting or no_reporting(engine.config.results))
        self.stem = f"simulated_{secrets.token_hex(4)}"
        self._listening = listen_as(self.stem)
        known = WhoAnswer(wire=wire.VERSION)
        self.server = EngineServer(self._listening, known).__enter__()
        self.server.admit_screens(self.local, known, idle_time)

    def attach(self, role: Role = Role.REFEREE, who: str = "ada@hall (1)") -> RemoteEngine:
        return RemoteEngine(self.stem, role, who)

    def connect(self) -> socket.socket:
        """A caller that says nothing yet."""
        return connect_to(self.stem, 10.0)

    def close(self) -> None:
        if self._listening.fileno() < 0:
            return  # it has ended before
        self.server.dismiss_screens()
        self.local.close()
        self.server.__exit__(None, None, None)
        self._listening.close()
        if self.reporting is not None:
            self.reporting.finish()


def act(client: EngineClient, act: Act) -> str | None:
    """Hand in an act of the referee."""
    return client.send_request(Perform.of(act))


def start(client: EngineClient) -> None:
    """A run goes on."""
    assert act(client, SetUp(make_setup(countdown=5.0, timeout=600.0))) is None
    until(lambda: client.snapshot().handle.force is not None)
    fresh = client.snapshot().time
    until(lambda: client.snapshot().time > fresh + 1.1)  # the handle's zero is the mean of a second
    acts = (ZeroHandle(), ConfirmPose(), Start())  # on a busy machine a topic may be stale
    # a zero that was taken while samples were missing is taken again
    until(lambda: next(filter(None, (act(client, each) for each in acts)), None) is None)
    until(lambda: client.snapshot().run.phase is Phase.RUNNING)


def told_by(client: RemoteEngine) -> str:
    """What a screen says instead of a state; empty = it has one."""
    try:
        client.snapshot()
    except MadrobError as error:
        return str(error)
    return ""
