"""An engine and its screens: who may act, who only watches, and that nobody holds it up."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from queue import Empty
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.ipc import client as screens
from madrob_console.engine.ipc import greeting, wire
from madrob_console.engine.ipc.client import snapshot_of
from madrob_console.engine.ipc.engine_interface import EngineClient, UnsureError, given_up
from madrob_console.engine.ipc.server import MOST_UNDER_WAY, TOO_MANY
from madrob_console.engine.playback import (
    NO_REPLAY,
    Faster,
    JumpTo,
    PlaybackCommand,
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
    Role,
    TakeOver,
)
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.replay import Replay
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import ACTS, Abort, AddNote, Finalise, SetUp, Start
from madrob_console.referee.competition_plan import (
    Attempts,
    Plan,
    PlanLine,
    PlannedAttempt,
    PlanProgress,
    Task,
)
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.engine.served import Served, act, simulated, start, told_by
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write
from tests.watching import until

pytestmark = pytest.mark.machine


ENDLESS = pytest.mark.parametrize("served", [Scenario.NO_TOUCH], indirect=True)
"""The run is still there, however busy the machine is."""


@pytest.fixture
def served(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Served]:
    scenario = getattr(request, "param", Scenario.NOMINAL)
    served = Served(tmp_path, engine=simulated(tmp_path / "runs", scenario=scenario))
    yield served
    served.close()


@ENDLESS
def test_a_run_goes_on_when_its_screen_has_gone_and_another_one_finds_it(served: Served) -> None:
    """Nor can those end it who only watch: they see everything and can do nothing."""
    watchers, client = [served.attach(Role.WATCH) for _ in range(5)], served.attach()
    start(client)
    client.close()
    for watcher in watchers:
        until(lambda w=watcher: w.snapshot().run.phase is Phase.RUNNING)  # type: ignore[misc]
        assert act(watcher, Abort("me")) == "this screen only watches"
        assert watcher.send_request(TakeOver()) == "this screen only watches"
        for name in (*(each.name for each in ACTS), TakeOver.name, ExportTeam.name):
            assert "only watches" in str(watcher.snapshot().refusal(name))
        watcher.close()
    with closing(served.attach()) as later:
        assert later.snapshot().run.phase is Phase.RUNNING
        assert act(later, Abort("enough")) is None


def test_a_second_console_may_act_only_after_a_take_over_that_the_first_one_sees(
    served: Served,
) -> None:
    with closing(served.attach(who="ada@hall")) as ada, closing(served.attach(who="bo@tent")) as bo:
        assert act(ada, SetUp(make_setup())) is None
        assert act(bo, AddNote("mine")) == "ada@hall has the right to act"
        refused = "ada@hall has the right to act; here an act asks before it takes it over"
        assert bo.snapshot().refusal("note") == refused
        assert bo.send_request(TakeOver()) is None
        assert act(bo, AddNote("mine")) is None
        taken = "bo@tent has the right to act; here an act asks before it takes it over"
        until(lambda: ada.snapshot().notice == taken)
        assert act(ada, AddNote("no")) == "bo@tent has the right to act"
        bo.close()  # the right is free again
        until(lambda: ada.snapshot().refusal("note") is None)
        assert act(ada, AddNote("mine again")) is None


def test_a_replay_is_moved_over_the_socket_by_the_console_that_may_act(tmp_path: Path) -> None:
    config, types = EngineConfig(tmp_path, DEFAULT_MAPPINGS, disk_needed=0), MessageTypes()
    engine = Engine.of_recording(Replay(completed(), types), config, types)
    with (
        closing(Served(tmp_path, engine=engine)) as replayed,
        closing(replayed.attach(who="ada@hall")) as ada,
        closing(replayed.attach(who="bo@tent")) as bo,
        closing(replayed.attach(Role.WATCH)) as watcher,
    ):
        assert ada.send_request(PlayOrPause()) is None
        assert ada.send_request(JumpTo(1.5)) is None
        until(lambda: watcher.snapshot().elapsed == pytest.approx(1.5, abs=0.011))
        assert "only watches" in str(watcher.send_request(PlayOrPause()))
        assert "only watches" in str(watcher.snapshot().refusal(PlaybackCommand.name))
        assert "ada@hall" in str(bo.send_request(SetSpeed(2.0)))
        assert "nothing can be done" in str(act(ada, Abort()))
        assert ada.snapshot().refusal(PlaybackCommand.name) is None


def test_a_core_that_stands_still_is_told_and_so_is_that_it_goes_on(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, go_on = served.local._engine.source, threading.Event()
    take = source.take_messages

    def stalls(timeout: float) -> Sequence[RawMessage]:
        assert go_on.wait(30.0)
        return take(timeout)

    with closing(served.attach()) as client:
        assert not client.snapshot().pulse.stale
        monkeypatch.setattr(source, "take_messages", stalls)
        until(lambda: client.snapshot().pulse.core >= 2)
        last = client.snapshot()
        assert last.pulse.words is not None
        assert last.pulse.words.startswith("the engine has not moved for ")
        assert last.all_faults[0] == last.pulse.words
        go_on.set()
        until(lambda: client.snapshot().pulse == Pulse())
        assert client.snapshot().time > last.time


@given(data=st.binary(max_size=200))
def test_no_greeting_can_be_anything_but_a_greeting(data: bytes) -> None:
    try:
        wire.first_of(data)
    except MadrobError:
        return
    assert wire.frame(wire.first_of(data))


RIGHT = RightToAct(Role.WATCH, "ada@hall")


def test_a_screen_shows_what_the_engine_has(drive: Drive) -> None:
    drive.whole_run(make_setup())
    shown = drive.engine.snapshot()
    state = wire.State(wire.raw(shown), wire.raw(RIGHT))
    crossed = wire.message_of(wire.frame(state)[wire.LENGTH.size :])
    assert isinstance(crossed, wire.State)
    assert shown.result is not None
    assert snapshot_of(crossed) == replace(shown, right=RIGHT)
    for wrong in (wire.State(wire.raw(1), state.right), wire.State(state.snapshot, wire.raw(1))):
        with pytest.raises(MadrobError, match="not a message of an engine"):
            snapshot_of(wrong)


def test_an_engine_ends_by_itself_when_nobody_needs_it_and_its_result_is_on_disk(
    tmp_path: Path,
) -> None:
    endless = simulated(tmp_path / "runs", scenario=Scenario.NO_TOUCH)
    final = Finalise(TeamWord.ABSENT, "Ada")
    with closing(Served(tmp_path, idle_time=0.5, engine=endless)) as served:
        client, over = served.attach(), served.server.over
        start(client)
        (folder,) = (tmp_path / "runs" / "practice").glob("subject_*")
        (folder / "result.json").mkdir()  # the disk refuses the result
        assert act(client, Abort("robot unsafe")) is None
        until(lambda: client.snapshot().pulse.refused and client.snapshot().result is not None)
        # while the engine tries again, which it does often, the result is being written
        until(lambda: "NOT on disk" in str(act(client, final)))
        against = "a run is NOT ON DISK yet, a screen is attached"
        until(lambda: served.server.describe().against_stopping == against)
        assert "NOT on disk" in str(served.server.describe().remarks)
        client.close()
        with pytest.raises(Empty):
            over.get(timeout=1.5)
        later = served.attach(Role.WATCH)
        (folder / "result.json").rmdir()
        with pytest.raises(Empty):
            over.get(timeout=1.5)  # a screen is there
        later.close()
        over.get(timeout=10.0)
        assert (folder / "result.json").is_file()


def test_an_engine_that_ends_is_told_by_its_screens(served: Served) -> None:
    with closing(served.attach()) as client, closing(served.attach(Role.WATCH)) as watcher:
        served.close()
        until(lambda: "the engine has ended: Ctrl+R starts it again" in told_by(client))
        with pytest.raises(MadrobError, match=r"Ctrl\+R starts it again"):
            act(client, Start())
        until(lambda: "the next one is looked for" in told_by(watcher))
        assert "Ctrl+R" not in told_by(watcher)  # who only watches starts none


@pytest.mark.parametrize("work", ["take", "call"])
def test_a_screen_that_stands_still_for_whatever_reason_says_so(
    served: Served, monkeypatch: pytest.MonkeyPatch, work: str
) -> None:
    with closing(served.attach(Role.WATCH)) as client:
        fails = Mock(side_effect=MemoryError)
        monkeypatch.setattr(
            *{"take": (screens, "snapshot_of"), "call": (wire, "Call")}[work], fails
        )
        client.begin_request(NextRunNumber(3, 1))
        until(lambda: "failed (MemoryError): it is tried again" in told_by(client))


@ENDLESS
def test_no_number_of_requests_of_a_screen_holds_up_its_abort(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()

    def hangs(_results: Path, _subject: int, _condition: int, *, practice: bool) -> int:
        assert go_on.wait(30.0)
        return 1

    monkeypatch.setattr("madrob_console.engine.runtime.testbed_engine.next_run_number", hangs)
    with closing(served.attach()) as client:
        start(client)
        asked = [client.begin_request(NextRunNumber(3, 1)) for _ in range(MOST_UNDER_WAY + 5)]
        until(lambda: sum(answer.done() for answer in asked) == 5)
        refused = [answer.exception() for answer in asked if answer.done()]
        assert {str(error) for error in refused} == {TOO_MANY}
        began = time.monotonic()
        assert act(client, Abort("enough")) is None
        assert time.monotonic() - began < 1.0  # 0.2 s on a machine that does nothing else
        go_on.set()
        assert sum(answer.exception(30.0) is None for answer in asked) == MOST_UNDER_WAY


def test_a_screen_that_asks_and_never_reads_is_bounded_in_memory(served: Served) -> None:
    """Its requests are not taken from the socket any more."""
    call = wire.frame(wire.Call(1, time.monotonic() + 600.0, wire.raw(NextRunNumber(3, 1))))
    with served.connect() as deaf:
        deaf.sendall(wire.frame(greeting.Hello(wire.VERSION, Role.REFEREE, "deaf")))
        deaf.settimeout(1.0)
        with pytest.raises(TimeoutError):
            deaf.sendall(100_000 * call)
        screen = next(iter(served.server._screens))
        assert screen.backlog < 1_000_000
        with closing(served.attach()) as client:
            assert client.send_request(TakeOver()) is None
            assert act(client, SetUp(make_setup())) is None


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
    monkeypatch.setattr(engine, "submit", Mock(side_effect=ValueError("a bug")))
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


def test_answer_that_comes_just_too_late_counts() -> None:
    answer: Future[str | None] = Future()
    answer.set_exception(MadrobError("the run is over"))

    with pytest.raises(MadrobError, match="the run is over"):
        given_up(answer)


def test_request_that_has_begun_is_unsure() -> None:
    answer: Future[str | None] = Future()
    answer.set_running_or_notify_cancel()

    with pytest.raises(UnsureError):
        given_up(answer)
