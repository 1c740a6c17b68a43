"""Other programs of a ROS domain: what they may call, what they hear, how they name things."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.common.clock import SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import RemoteService
from madrob_console.config import Settings
from madrob_console.engine.core import Engine
from madrob_console.engine.disk import DiskThreads, InlineDisk
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.engine.engine_thread import LocalEngine
from madrob_console.engine.requests import Perform
from madrob_console.engine.service import Attendant
from madrob_console.messages.codec import DEFAULT_MAPPINGS, REFEREE_STATE_TOPIC
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import Origin, read_journal
from madrob_console.referee.run import Phase
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import RosObject, load_module
from madrob_console.testbeds.ros.neighbours import TOO_MANY
from scoring.protocol import Outcome
from tests.madrob_console import said
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.held_disk import HeldDisk
from tests.madrob_console.ros_peer import BOOL, KEPT, Peer, Taker, latch, source, truth
from tests.watching import until

START, ABORT, TIMEOUT = RemoteService
GUIDE = Path(__file__).parents[4] / "madrob_console" / "guide" / "robots.md"
BUSY = 2.0
"""s more than the promised 0.2 s that a call may take beside other programs."""


class Hall:
    """An engine in the domain, on a disk that can be held, and another program."""

    def __init__(self, results: Path, peer: Peer) -> None:
        self.disk, self.peer = HeldDisk(), peer
        clock, types = SystemClock(), MessageTypes()
        self.source = RosSource(DEFAULT_MAPPINGS, types, clock)
        config = EngineConfig(results, DEFAULT_MAPPINGS, disk_needed=0)
        keepers = DiskThreads(self.disk, InlineDisk(), monotonic=time.monotonic)
        self.engine = LocalEngine(Engine(self.source, clock, config, types, keepers=keepers))
        self.source.attend(Attendant(self.engine, tuple(RemoteService), 50.0))
        self._clients: dict[RemoteService, RosObject] = {}
        self._number = 0

    @property
    def phase(self) -> Phase:
        return self.engine.snapshot().run.phase

    def make_ready(self) -> None:
        """A run is set up, and what no testbed says is waived."""
        self._number += 1
        setup = make_setup(run_number=self._number, countdown=0.3)
        assert self.engine.send_request(Perform.of(SetUp(setup))) is None
        until(lambda: blocking(self.engine.snapshot().checks))
        while blocks := blocking(self.engine.snapshot().checks):
            assert self.engine.send_request(Perform.of(Waive(blocks[0].name, "no testbed"))) is None

    def call(self, service: RemoteService) -> RosObject:
        """A call, and the answer to come."""
        if service not in self._clients:
            trigger = load_module("std_srvs.srv").Trigger
            name = f"{self.source._console.get_fully_qualified_name()}/{service}"
            client = self._clients[service] = self.peer.own.create_client(trigger, name)
            self.peer.until(client.service_is_ready)
        client = self._clients[service]
        return client.call_async(client.srv_type.Request())

    def answer(self, service: RemoteService) -> tuple[bool, str]:
        answer = self.call(service)
        self.peer.until(answer.done)
        return answer.result().success, answer.result().message

    def close(self) -> None:
        self.disk.come_back()
        self.engine.close()


@pytest.fixture
def hall(tmp_path: Path, peer: Peer) -> Iterator[Hall]:
    hall = Hall(tmp_path, peer)
    try:
        yield hall
    finally:
        hall.close()


def test_a_call_has_the_checks_and_words_of_the_key_and_its_own_origin_in_the_journal(
    hall: Hall,
) -> None:
    for service in (START, ABORT):
        assert hall.answer(service) == (False, f"Refused: {service}: no run is set up yet")
    hall.make_ready()
    assert hall.answer(START) == (True, "Done: start")
    until(lambda: hall.phase is Phase.RUNNING)
    assert hall.answer(START) == (False, "Refused: start: a run is going on")
    assert hall.answer(TIMEOUT) == (True, "Done: declare timeout")
    until(lambda: hall.phase is Phase.STOPPED)
    assert hall.answer(ABORT) == (
        False,
        "Refused: abort: the run has stopped: void it instead",
    )
    snapshot = hall.engine.snapshot()
    assert snapshot.run.outcome is Outcome.TIMEOUT
    assert snapshot.run.outcome_reason == "called over ROS"
    lines, _ = read_journal(Path(snapshot.folder or "") / "journal.jsonl")
    called = [line for line in lines if line.origin is Origin.REMOTE]
    assert [(line.what, line.referee) for line in called] == [
        ("start", ""),
        ("declare timeout", ""),
    ]
    assert called[0].id


def test_an_abort_is_done_at_once_in_a_flood_of_calls_which_is_refused_in_words(
    hall: Hall,
) -> None:
    hall.make_ready()
    assert hall.engine.send_request(Perform.of(Start())) is None
    until(lambda: hall.phase is Phase.RUNNING)
    assert not hall.answer(START)[0]
    flood = [hall.call(START) for _ in range(150)]
    called = time.monotonic()
    abort = hall.call(ABORT)
    until(lambda: hall.phase is Phase.STOPPED)
    took = time.monotonic() - called
    hall.peer.until(abort.done)
    assert abort.result().success
    assert took < 0.2 + BUSY
    hall.peer.until(lambda: any(a.done() and a.result().message == TOO_MANY for a in flood))
    assert not any(answer.result().success for answer in flood if answer.done())
    assert hall.engine.snapshot().pulse.core == 0
    print(f"stopped {took:.3f} s after the call")


def test_a_start_that_the_disk_does_not_answer_holds_up_neither_diagnostics_nor_an_abort(
    hall: Hall,
) -> None:
    heard = hall.peer.listen("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    hall.make_ready()
    hall.disk.held = True
    start = hall.call(START)
    hall.peer.until(lambda: hall.engine._engine.writing)
    before = len(heard)
    hall.peer.until(lambda: len(heard) > before)
    assert not start.done()
    assert hall.answer(ABORT) == (True, "Done: abort")
    hall.peer.until(start.done)
    assert start.result().message == (
        "Refused: start: aborted before the countdown began: called over ROS: it is withdrawn"
    )
    assert hall.answer(START) == (
        False,
        "Refused: start: the disk did not take it within 2 s: it is withdrawn",
    )
    assert hall.phase is Phase.READY


def test_diagnostics_say_each_second_what_the_screens_say(hall: Hall) -> None:
    heard = hall.peer.listen("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    publisher = hall.peer.publisher("/madrob/door/locked", BOOL)
    hall.peer.until(publisher.get_subscription_count)
    publisher.publish(truth(True))
    hall.peer.until(lambda: len(heard) > 1)
    snapshot = hall.engine.snapshot()
    told = {status.name: status for status in heard[-1].status}
    assert set(told) == {
        "madrob: engine",
        "madrob: recorder",
        "madrob: disk",
        *(f"madrob: {view.topic}" for view in snapshot.topics),
    }
    for view in snapshot.topics:
        status = told[f"madrob: {view.topic}"]
        assert status.level == (b"\0" if view.optional else b"\2")
        assert view.optional or status.message == view.problem
    stamps = [a.header.stamp.sec + a.header.stamp.nanosec / 1e9 for a in heard[:2]]
    assert 0.5 < stamps[1] - stamps[0] < 1.5 + BUSY


@pytest.mark.parametrize("allowed", [Settings().ros.services, (ABORT,)])
def test_what_is_not_allowed_cannot_be_called(hall: Hall, allowed: tuple[RemoteService]) -> None:
    with Taker(source()) as other:
        other.source.attend(Attendant(hall.engine, allowed, 50.0))
        offered = [s.srv_name for s in other.source._console.services]
    assert offered == [f"~/{service}" for service in allowed]


@pytest.mark.parametrize(("namespace", "called"), [("", "madrob"), ("/hall2", "hall2")])
def test_a_service_has_the_name_of_the_guide_where_the_node_is_given_one(
    namespace: str, called: str, hall: Hall
) -> None:
    ros_args = ["-r", "__node:=referee", *(["-r", f"__ns:={namespace}"] if namespace else [])]
    named = RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args)
    with Taker(named):
        named.attend(Attendant(hall.engine, (ABORT,), 50.0))
        (service,) = named._console.services
        assert service.service_name == f"/{called}/referee/abort"
    assert f"`/{called}/referee/abort`" in GUIDE.read_text()


def test_a_launch_file_moves_topics_into_its_namespace_and_gives_them_other_names(
    peer: Peer,
) -> None:
    ros_args = ["-r", "__ns:=/hall2", "-r", "__node:=referee", "-r", "door/locked:=/lab/latch"]
    moved = RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args)
    publisher = peer.publisher("/lab/latch", BOOL)
    with Taker(moved) as taker:
        peer.until(lambda: taker.matched("/madrob/door/locked"))
        publisher.publish(truth(True))
        peer.until(lambda: taker.has(1))
        assert taker.taken[0].topic == "/madrob/door/locked"  # as the settings call it
        states = peer.listen("/hall2/referee/state", "std_msgs/msg/String", KEPT)
        taker.source.publish(said.state("idle"))
        peer.until(lambda: states)
        infos = peer.own.get_publishers_info_by_topic("/hall2/referee/state")
        assert [(i.node_namespace, i.node_name) for i in infos] == [("/hall2", "referee")]
        assert not peer.own.get_publishers_info_by_topic(REFEREE_STATE_TOPIC)
        assert taker.source.other_referee is None  # not even itself, by another name


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("ros_args", [["-r"], ["--nonsense"], ["-r", "__ns:=hall 2"]])
def test_arguments_that_ros_does_not_understand_are_named_in_one_line(
    ros_args: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MadrobError, match=r"^`--ros-args .*correct it$") as caught:
        RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args).open()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
