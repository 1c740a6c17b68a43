"""Other programs of a ROS domain: how they abort a run, flood it, and name things."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.common.clock import SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.ipc.service import begin_abort_over_ros
from madrob_console.engine.requests import Perform
from madrob_console.engine.runtime.disk import DiskJobs, DiskThreads
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.codec import DEFAULT_MAPPINGS, REFEREE_STATE_TOPIC
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import Entry, Origin, read_journal
from madrob_console.referee.run import Phase
from madrob_console.testbeds.ros import RosSource, asks_for_sim_time
from madrob_console.testbeds.ros.abort_service import DEPTH
from madrob_console.testbeds.ros.connection import RosObject, load_module
from madrob_console.testbeds.source import CallAnswer, LookForAnswer
from scoring.protocol import Outcome
from tests.madrob_console import said
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.held_disk import HeldDisk
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.ros_peer import BOOL, KEPT, Peer, Taker, latch
from tests.watching import until

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
        disk = DiskThreads(self.disk, DiskJobs(), monotonic=time.monotonic)
        self.engine = LocalEngine(
            Engine(self.source, clock, config, types, disk=disk),
            no_reporting(config.results),
        )
        self.source.offer_abort(self.begin_abort)
        trigger = load_module("std_srvs.srv").Trigger
        name = f"{self.source._console.get_fully_qualified_name()}/abort"
        self._client = peer.own.create_client(trigger, name)
        self._number = 0

    def begin_abort(self) -> LookForAnswer:
        return begin_abort_over_ros(self.engine)

    @property
    def phase(self) -> Phase:
        return self.engine.snapshot().run.phase

    def make_ready(self) -> None:
        """A run is set up, what no testbed says is waived, and the service is found."""
        self.peer.until(self._client.service_is_ready)
        self._number += 1
        setup = make_setup(run_number=self._number, countdown=0.3)
        assert self.engine.send_request(Perform.of(SetUp(setup))) is None
        until(lambda: blocking(self.engine.snapshot().checks))
        while blocks := blocking(self.engine.snapshot().checks):
            assert self.engine.send_request(Perform.of(Waive(blocks[0].name, "no testbed"))) is None

    def start(self) -> None:
        self.make_ready()
        assert self.engine.send_request(Perform.of(Start())) is None
        until(lambda: self.phase is Phase.RUNNING)

    def call(self) -> RosObject:
        """A call, and the answer to come."""
        self.peer.until(self._client.service_is_ready)
        return self._client.call_async(self._client.srv_type.Request())

    def answer(self) -> tuple[bool, str]:
        answer = self.call()
        self.peer.until(answer.done)
        return answer.result().success, answer.result().message

    def remote_lines(self) -> list[Entry]:
        lines, _ = read_journal(Path(self.engine.snapshot().folder or "") / "journal.jsonl")
        return [line for line in lines if line.origin is Origin.REMOTE]

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


def test_a_call_has_the_checks_and_words_of_the_key_and_an_origin_of_its_own(
    hall: Hall,
) -> None:
    assert hall.answer() == (False, "Refused: abort: no run is set up yet")
    hall.start()
    assert hall.answer() == (True, "Done: the run is aborted")
    until(lambda: hall.phase is Phase.STOPPED)
    assert hall.answer() == (False, "Refused: abort: the run has stopped")
    run = hall.engine.snapshot().run
    assert (run.outcome, run.outcome_reason) == (Outcome.ABORTED, "called over ROS")
    assert [(line.what, line.referee) for line in hall.remote_lines()] == [("abort", "")]


def test_a_flood_of_calls_aborts_at_once_and_is_answered(hall: Hall) -> None:
    hall.start()
    called = time.monotonic()
    flood = [hall.call() for _ in range(150)]
    until(lambda: hall.phase is Phase.STOPPED)
    took = time.monotonic() - called
    assert took < 0.2 + BUSY
    hall.peer.until(lambda: any(answer.done() for answer in flood))
    assert hall.answer() == (False, "Refused: abort: the run has stopped")
    assert len(hall.remote_lines()) == 1
    assert hall.engine.snapshot().pulse.core == 0
    print(f"stopped {took:.3f} s after the call")


def test_no_flood_of_refusals_takes_the_place_of_the_answer_to_an_abort(
    hall: Hall,
) -> None:
    service = hall.source._abort_service
    assert service is not None
    service.close()  # so that no reply is sent
    for done, calls in ((False, 3 * DEPTH), (True, 1), (False, DEPTH)):
        service._callers = [f"{done}"] * calls
        service._answer(CallAnswer(success=done, message=""))
    assert [caller for caller, _ in service._replies] == ["True", *["False"] * DEPTH]


def test_a_start_that_the_disk_does_not_answer_holds_up_no_abort(hall: Hall) -> None:
    hall.make_ready()
    hall.disk.held = True
    start = hall.engine.begin_request(Perform.of(Start()))
    until(lambda: hall.engine._engine.writing)
    assert not start.done()
    assert hall.answer() == (True, "Done: the run is aborted")
    assert start.result(BUSY) == (
        "aborted before the countdown began: called over ROS: it is withdrawn"
    )
    assert hall.phase is Phase.READY


@pytest.mark.parametrize(("namespace", "called"), [("", "madrob"), ("/hall2", "hall2")])
def test_a_service_has_the_name_of_the_guide_where_the_node_is_given_one(
    namespace: str, called: str, hall: Hall
) -> None:
    ros_args = ["-r", "__node:=referee", *(["-r", f"__ns:={namespace}"] if namespace else [])]
    named = RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args)
    with Taker(named):
        assert not list(named._console.services)
        named.offer_abort(hall.begin_abort)
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
        peer.say(taker, publisher, True)
        assert taker.taken[0].topic == "/madrob/door/locked"  # as the settings call it
        states = peer.listen("/hall2/referee/state", "std_msgs/msg/String", KEPT)
        taker.source.publish(said.state("idle"))
        peer.until(lambda: states)

        def speakers() -> list[tuple[str, str]]:
            infos = peer.own.get_publishers_info_by_topic("/hall2/referee/state")
            return [(info.node_namespace, info.node_name) for info in infos]

        peer.until(lambda: speakers() == [("/hall2", "referee")])
        assert not peer.own.get_publishers_info_by_topic(REFEREE_STATE_TOPIC)
        assert taker.source.other_referee is None  # not even itself, by another name


@pytest.mark.parametrize(
    ("ros_args", "asks"),
    [
        ([], False),
        (["-r", "__ns:=/hall2"], False),
        (["-p", "use_sim_time:=true"], True),
        (["-p", "use_sim_time:=false"], False),
        (["-p", "other:use_sim_time:=true"], False),
        (["-r", "__node:=referee", "-r", "__ns:=/hall2", "--params-file", "{launch}"], True),
        (["-r", "__node:=other", "-r", "__ns:=/hall2", "--params-file", "{launch}"], False),
    ],
    ids=str,
)
def test_the_parameter_of_simulated_time_is_heeded_alone_or_in_a_launch_file_s_file(
    ros_args: list[str], asks: bool, ros_domain: int, tmp_path: Path
) -> None:
    launch = tmp_path / "launch_params"
    launch.write_text("/hall2/referee:\n  ros__parameters:\n    use_sim_time: true\n")
    given = [word.format(launch=launch) for word in ros_args]
    assert asks_for_sim_time(ros_domain, given) is asks


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("ros_args", [["-r"], ["--nonsense"], ["-r", "__ns:=hall 2"]])
def test_arguments_that_ros_does_not_understand_are_named_in_one_line(
    ros_args: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MadrobError, match=r"^`--ros-args .*correct it$") as caught:
        RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args).open()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
