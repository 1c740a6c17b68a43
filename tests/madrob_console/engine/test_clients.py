"""What a screen can rely on, in the engine's process and over a socket."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.engine_interface import EngineClient
from madrob_console.engine.playback import (
    NO_REPLAY,
    Faster,
    JumpTo,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
)
from madrob_console.engine.requests import (
    NO_ANSWER,
    ExportDossier,
    ExportTeam,
    GiveCurves,
    GiveFrames,
    GivePlan,
    NextRunNumber,
    OpenRun,
    Perform,
    Request,
    TakeOver,
)
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.referee.acts import Abort, SetUp, Start
from madrob_console.referee.competition_plan import (
    Attempts,
    Plan,
    PlanLine,
    PlannedAttempt,
    PlanProgress,
    Task,
)
from madrob_console.referee.run import Phase
from recorder.bag import RawMessage
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.engine.served import Served, act, simulated
from tests.madrob_console.run_folders import summary, write
from tests.watching import until

pytestmark = pytest.mark.machine
WAYS = ("in this process", "over a socket")

EXAMPLES: tuple[Request[Any], ...] = (
    Perform.of(Abort("why")),
    NextRunNumber(3, 1),
    OpenRun("subject_003_cond_001_run_001_20231114_221320"),
    ExportTeam(3),
    ExportDossier("subject_003_cond_001_run_001_20231114_221320"),
    GiveCurves(),
    GiveFrames(),
    GivePlan(),
    TakeOver(),
    PlayOrPause(),
    Faster(),
    Slower(),
    SetSpeed(2.0),
    Skip(1.0),
    JumpTo(1.0),
)


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    return simulated(tmp_path / "runs")


@pytest.fixture(params=WAYS)
def client(
    request: pytest.FixtureRequest, engine: Engine, tmp_path: Path
) -> Iterator[EngineClient]:
    if request.param == WAYS[0]:
        with closing(LocalEngine(engine, no_reporting(tmp_path))) as local:
            yield local
        return
    with (
        closing(Served(tmp_path, engine=engine)) as served,
        closing(served.attach()) as remote,
    ):
        yield remote


def test_the_plan_and_what_is_done_of_it_come_from_the_engine(
    client: EngineClient, engine: Engine, tmp_path: Path
) -> None:
    assert client.send_request(GivePlan()) == PlanProgress()
    task = Task(3, 1)
    engine.set_plan(Plan((PlanLine(task, 2),), ("plan.csv line 2: no",), "plan.csv"))
    until(lambda: client.snapshot().plan.lines)
    assert client.snapshot().plan.problems == ("plan.csv line 2: no",)
    for run_number, competition in ((1, ""), (2, "Spring Cup")):
        write(tmp_path / "runs", summary(3, 1, run_number, competition=competition))
    found = client.send_request(GivePlan())
    assert found.tasks == (Attempts(task, 2, 1, 1, 6),)
    assert found.next == PlannedAttempt(task, 2, 2)
    assert found.problems == ("plan.csv line 2: no",)


NOT_AN_ACT: tuple[Request[Any], ...] = (
    OpenRun("../../etc"),
    Perform("abort", {"reason": 3}),
    Perform("set up", {}),
    Perform("rm -rf", {}),
)


def test_what_is_refused_or_fails_comes_back_in_words_and_what_was_done_shows_next(
    client: EngineClient,
) -> None:
    assert act(client, Start()) == "no run is set up yet"
    assert client.send_request(JumpTo(1.0)) == NO_REPLAY
    for request in NOT_AN_ACT:
        with pytest.raises(MadrobError, match=r"no run folder|'abort'|'set up'|no act"):
            client.send_request(request)
    assert client.snapshot().run.phase is Phase.IDLE
    assert act(client, SetUp(make_setup())) is None
    assert client.snapshot().run.phase is Phase.READY


def test_every_request_is_carried_out(client: EngineClient) -> None:
    assert {type(example) for example in EXAMPLES} == set(wire.REQUESTS)
    for example in EXAMPLES:
        if type(example) in (OpenRun, GiveFrames):
            with pytest.raises(MadrobError, match=r"No such file|this is no replay"):
                client.send_request(example)
        else:
            client.send_request(example)


def test_a_request_that_a_screen_was_refused_never_happens_later(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, go_on = threading.Event(), threading.Event()
    take = engine.source.take_messages

    def stalls(timeout: float) -> list[RawMessage]:
        held.set()
        assert go_on.wait(30.0)
        return list(take(timeout))

    monkeypatch.setattr(engine.source, "take_messages", stalls)
    monkeypatch.setattr(Perform, "timeout", Perform.effect_time + 0.3)
    assert held.wait(30.0)
    with pytest.raises(MadrobError, match=NO_ANSWER):
        act(client, SetUp(make_setup()))
    go_on.set()
    assert client.send_request(Skip(1.0)) == NO_REPLAY  # whatever came before it has had its turn
    assert client.snapshot().run.phase is Phase.IDLE


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_engine_that_fails_says_so_at_once(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_arguments: object, **_options: object) -> None:
        raise ValueError("a bug")

    monkeypatch.setattr(engine, "submit", fails)
    began = time.monotonic()
    with pytest.raises(MadrobError, match="the engine has failed: a bug"):
        act(client, Start())
    assert time.monotonic() - began < 3.0
    until(lambda: not any(thread.name == "engine" for thread in threading.enumerate()))
    with pytest.raises(MadrobError, match="the engine has"):
        act(client, Start())


def test_one_that_waits_does_not_hold_up_the_others(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag is read for as long as it takes; an abort goes past it."""
    reading, go_on = threading.Event(), threading.Event()

    def reads(_folder: Path) -> None:
        reading.set()
        assert go_on.wait(30.0)
        raise MadrobError("its bag is gone")

    monkeypatch.setattr("madrob_console.engine.runtime.scorer.open_run", reads)
    with ThreadPoolExecutor() as pool:
        opening = pool.submit(client.send_request, EXAMPLES[2])
        assert reading.wait(30.0)
        assert act(client, SetUp(make_setup())) is None
        go_on.set()
        with pytest.raises(MadrobError, match="its bag is gone"):
            opening.result()
