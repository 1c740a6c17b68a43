"""An engine in a thread of its own, as the screens see it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from madrob_console.clock import SystemClock
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.process.local import LocalEngine
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import make_setup

pytestmark = pytest.mark.machine
SPEED = 8.0


@pytest.fixture
def client(tmp_path: Path) -> Iterator[LocalEngine]:
    clock, types = SystemClock(SPEED), MessageTypes()
    source = SimulatedSource(SimulatedTestbed(), clock, types)
    config = EngineConfig(tmp_path, DEFAULT_MAPPINGS, disk_needed=0)
    engine = LocalEngine(Engine(source, clock, config, types))
    yield engine
    engine.close()


def wait(done: Callable[[], bool], patience: float = 30.0) -> None:
    end = time.monotonic() + patience
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def start(client: LocalEngine) -> None:
    assert client.act(SetUp(make_setup(countdown=5.0))) is None
    wait(lambda: len(client.snapshot().topics) > 0 and client.snapshot().handle.force is not None)
    time.sleep(1.5 / SPEED)
    for act in (ZeroHandle(), ConfirmPose(), Start()):  # on a busy machine a topic may be stale
        wait(lambda act=act: client.act(act) is None)  # type: ignore[misc]


def test_a_run_goes_on_while_the_screen_only_looks(client: LocalEngine) -> None:
    start(client)
    wait(lambda: client.snapshot().result is not None)
    shown = client.snapshot()
    assert shown.run.outcome is Outcome.COMPLETED
    assert shown.recorder.dropped == 0
    assert shown.folder is not None
    assert (Path(shown.folder) / "result.json").is_file()


def test_an_act_shows_in_the_next_snapshot(client: LocalEngine) -> None:
    start(client)
    assert client.snapshot().run.phase is Phase.COUNTDOWN
    assert client.act(Abort("enough")) is None
    assert client.snapshot().run.phase is Phase.STOPPED


def test_a_refusal_comes_back_in_words(client: LocalEngine) -> None:
    assert client.act(Abort()) == "no run is set up yet"


def test_after_the_end_every_question_gets_an_answer(client: LocalEngine) -> None:
    client.close()
    with pytest.raises(MadrobError, match="engine has ended"):
        client.act(ConfirmPose())
    assert not any(thread.name == "engine" for thread in threading.enumerate())


def test_the_next_run_number_is_asked_of_the_engine(client: LocalEngine) -> None:
    assert client.next_run_number(3, 1) == 1
