from __future__ import annotations

import os
import re
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

from madrob_console.common.clock import NS, SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.core import Engine
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive
from madrob_console.referee.checks import blocking
from madrob_console.testbeds.ros import RosSource, ros_source
from recorder.bag import Durability, Qos, RawMessage, Reliability
from recorder.reader import read_bag
from scoring.protocol import Outcome, Signal
from tests.madrob_console import ros_peer, said
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.spoilt import (
    HANDLE,
    STRING,
    TYPES,
    Fault,
    Spoil,
    edited,
    set_value,
    spoiler,
)
from tests.madrob_console.ros_peer import (
    BEST_EFFORT,
    BOOL,
    FLOOD,
    KEPT,
    RELIABLE,
    Peer,
    Taker,
    latch,
    source,
    truth,
)

LOCKED = "/madrob/door/locked"


def test_messages_arrive_byte_for_byte_with_the_times_of_sending_and_arrival(peer: Peer) -> None:
    publisher = peer.publisher(LOCKED, BOOL)
    with Taker(source()) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        before = time.time_ns()
        publisher.publish(truth(True))
        peer.until(lambda: taker.has(1))
    (message,) = taker.taken
    assert (message.topic, message.type, message.data) == (LOCKED, BOOL, truth(True))
    assert before <= message.publish_ns <= message.receive_ns <= before + 1_000_000_000


@pytest.mark.slow
@pytest.mark.usefixtures("ros_domain")
def test_nothing_is_lost_of_ten_topics_at_3000_messages_a_second() -> None:
    mappings = [
        TopicMapping(Signal.DOOR, f"{FLOOD}_{i}", "std_msgs/msg/Header", "stamp.sec")
        for i in range(10)
    ]
    flood = [sys.executable, "-m", ros_peer.__name__, "10", "600", "300"]
    with (
        Taker(source(*mappings)) as taker,
        subprocess.Popen(flood, cwd=Path(__file__).parents[4]) as process,
    ):
        while process.poll() is None:
            taker.has(6000)
        assert process.returncode == 0
    taker.has(6000)
    assert [s.problem for s in taker.source.status()] == [None] * 10
    types = MessageTypes()
    for mapping in mappings:
        numbers = [
            int(types.decode(m.type, m.data).frame_id)
            for m in taker.taken
            if m.topic == mapping.topic
        ]
        assert numbers == list(range(600))
    assert [s.lost for s in taker.source.status()] == [0] * 10
    times = [m.receive_ns for m in taker.taken]
    assert times == sorted(times)


def test_a_topic_that_appears_late_is_picked_up(taker: Taker, peer: Peer) -> None:
    assert not taker.matched(LOCKED)
    publisher = peer.publisher(LOCKED, BOOL)
    peer.until(lambda: peer.reaches(taker, LOCKED))
    publisher.publish(truth(False))
    peer.until(lambda: taker.has(1))


def test_a_topic_of_another_type_is_named_with_both_types(peer: Peer) -> None:
    peer.publisher(LOCKED, "std_msgs/msg/String")
    with Taker(source()) as taker:
        peer.until(lambda: any(s.problem for s in taker.source.status()))
        status = next(s for s in taker.source.status() if s.topic == LOCKED)
    assert status.type == "std_msgs/msg/String"
    assert status.problem == (
        "its type is std_msgs/msg/String, not std_msgs/msg/Bool: correct the settings"
    )


@pytest.mark.parametrize("qos", [RELIABLE, BEST_EFFORT, KEPT])
def test_every_quality_of_service_is_received_and_noted_for_the_bag(peer: Peer, qos: Qos) -> None:
    publisher = peer.publisher(LOCKED, BOOL, qos)
    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        publisher.publish(truth(True))
        peer.until(lambda: taker.has(1))
        assert taker.source.topics()[0].qos == qos


def test_the_last_value_of_a_transient_local_topic_is_received_late(peer: Peer) -> None:
    peer.publisher(LOCKED, BOOL, KEPT).publish(truth(True))
    with Taker(source()) as taker:
        peer.until(lambda: taker.has(1))
    assert taker.taken[0].data == truth(True)


def test_two_publishers_on_one_topic_are_visible_and_make_the_loss_unknown(peer: Peer) -> None:
    publishers = [peer.publisher(LOCKED, BOOL) for _ in range(2)]
    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED, publishers=2))
        for publisher in publishers:
            publisher.publish(truth(True))
        peer.until(lambda: taker.has(2))
        assert taker.source.status()[0].lost is None
        peer.own.destroy_publisher(publishers[0])
        peer.until(lambda: peer.reaches(taker, LOCKED, publishers=1))
        peer.until(lambda: taker.source.status()[0].lost == 0)


@pytest.mark.slow
def test_nothing_is_lost_or_doubled_when_a_publisher_with_other_qos_joins(peer: Peer) -> None:
    first = peer.publisher(LOCKED, BOOL, KEPT)
    sent, enough = 0, threading.Event()

    def publish() -> None:
        nonlocal sent
        while not enough.wait(0.0005):
            first.publish(truth(True))
            sent += 1

    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        thread = threading.Thread(target=publish)
        thread.start()
        peer.until(lambda: taker.has(1))
        second = peer.publisher(LOCKED, BOOL, BEST_EFFORT)
        peer.until(
            lambda: taker.source.topics()[0].qos == BEST_EFFORT and peer.reaches(taker, LOCKED, 2)
        )
        second.publish(truth(False))
        time.sleep(1.0)  # until only the new subscription is left
        enough.set()
        thread.join()
        peer.until(lambda: taker.has(sent + 1))
        time.sleep(0.3)  # whatever comes twice comes now
        taker.has(0)
    assert [m.data for m in taker.taken].count(truth(True)) == sent
    assert [m.data for m in taker.taken].count(truth(False)) == 1


def test_a_restarted_publisher_is_no_loss(peer: Peer) -> None:
    with Taker(source(latch())) as taker:
        for count in (5, 10):
            publisher = peer.publisher(LOCKED, BOOL)
            peer.until(lambda: peer.reaches(taker, LOCKED))
            for _ in range(5):
                publisher.publish(truth(True))
            peer.until(lambda count=count: taker.has(count))  # type: ignore[misc]
            peer.own.destroy_publisher(publisher)
            peer.until(lambda: peer.reaches(taker, LOCKED, publishers=0))
        assert taker.source.status()[0].lost == 0


def test_a_type_that_is_not_installed_is_a_problem_of_its_topic_only(peer: Peer) -> None:
    handle = TopicMapping(Signal.HANDLE, "/madrob/handle", "madrob_msgs/msg/Handle", "force")
    publisher = peer.publisher(LOCKED, BOOL)
    with Taker(source(handle, latch())) as taker:
        assert taker.source.topics()[0].name == LOCKED
        assert taker.source.status()[0].problem == (
            "madrob_msgs/msg/Handle is not installed here: "
            "source the workspace that has madrob_msgs"
        )
        peer.until(lambda: peer.reaches(taker, LOCKED))
        publisher.publish(truth(True))
        peer.until(lambda: taker.has(1))


def test_another_version_of_a_type_is_named(
    peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "share/std_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "Bool.msg").write_text("bool data\n")
    (folder / "Bool.json").write_text(
        '{"type_hashes": [{"type_name": "std_msgs/msg/Bool", "hash_string": "RIHS01_00"}]}'
    )
    own = os.environ.get("AMENT_PREFIX_PATH", sys.prefix)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}{os.pathsep}{own}")
    peer.publisher(LOCKED, BOOL)
    with Taker(source(latch())) as taker:
        peer.until(lambda: taker.source.status()[0].problem)
        assert taker.source.status()[0].problem == (
            "its publisher has another version of std_msgs/msg/Bool: "
            "install the same version of the package on both machines"
        )


def test_before_and_after_the_connection_every_call_is_harmless(ros_domain: int) -> None:
    closed = source()
    assert (closed.kind, closed.label) == (SourceKind.ROS, f"LIVE ros domain {ros_domain}")
    assert [s.topic for s in closed.status()] == [m.topic for m in DEFAULT_MAPPINGS]
    assert closed.sides_problem == "ROS is not connected"
    closed.publish(said.event("{}"))
    closed.open()
    closed.close()
    closed.close()
    assert closed.take_messages(0) == []
    closed.publish(said.event("{}"))


def test_a_middleware_that_fails_is_shown_and_ends_nothing(peer: Peer) -> None:
    with Taker(source(latch())) as taker:
        assert taker.source._connection is not None
        taker.source._connection._context.shutdown()
        peer.until(lambda: taker.source.status()[0].problem)
        assert taker.source.status()[0].problem.startswith("ROS fails (")  # type: ignore[union-attr]
        assert taker.source.take_messages(0) == []


def test_a_want_of_memory_is_shown_and_what_comes_later_is_received(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> NoReturn:
        raise MemoryError

    publisher = peer.publisher(LOCKED, BOOL)

    def published() -> bool:
        publisher.publish(truth(True))
        return True

    with Taker(source()) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        with monkeypatch.context() as short:
            short.setattr(ros_source, "arrivals", fail)
            peer.until(lambda: published() and any(s.problem for s in taker.source.status()))
            problem = next(s.problem for s in taker.source.status() if s.problem)
            assert problem == "ROS fails (MemoryError): start the console again"
        peer.until(lambda: published() and taker.has(1))


def test_what_arrived_before_the_end_can_still_be_taken(peer: Peer) -> None:
    publisher = peer.publisher(LOCKED, BOOL)
    with Taker(source()) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        for _ in range(50):
            publisher.publish(truth(True))
        peer.until(lambda: len(taker.source._mailbox._messages) == 50)
    assert len(taker.source.take_messages(0)) == 50


@pytest.mark.parametrize("domain", ["-1", "233", "door"])
def test_a_domain_that_does_not_exist_is_refused(
    monkeypatch: pytest.MonkeyPatch, domain: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(MadrobError, match=r"use 0 to 232"):
        source()


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("ending", ["source.close()", "pass", "raise SystemExit(0)"])
def test_the_interpreter_ends_cleanly_closed_or_not(ending: str) -> None:
    program = f"""
        from tests.madrob_console.ros_peer import source as make
        source = make()
        source.open()
        source.take_messages(0.3)
        {ending}
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_without_ros_the_error_is_one_line_with_the_remedy() -> None:
    program = """
        import sys
        sys.modules["rclpy"] = None  # as if it were not installed
        from madrob_console.common.errors import MadrobError
        from tests.madrob_console.ros_peer import source
        try:
            source().open()
        except MadrobError as error:
            print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
    )
    assert done.stdout == (
        "ROS 2 is not here (rclpy is missing): install madrob-console[ros], or source "
        "/opt/ros/jazzy/setup.bash in an environment that sees the system's packages, or use "
        "--testbed simulated\n"
    )
    assert done.stderr == ""


@pytest.mark.slow
def test_history_that_comes_again_with_another_subscription_is_no_news(peer: Peer) -> None:
    kept = peer.publisher(LOCKED, BOOL, KEPT)
    other = peer.publisher(LOCKED, BOOL, BEST_EFFORT)
    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED, publishers=2))
        for value in (True, False, True):
            kept.publish(truth(value))
        peer.until(lambda: taker.has(3))
        peer.own.destroy_publisher(other)
        peer.until(lambda: taker.source.topics()[0].qos == KEPT and peer.reaches(taker, LOCKED))
        kept.publish(truth(False))
        peer.until(lambda: taker.has(4))
        time.sleep(1.0)  # whatever comes twice comes now
        taker.has(0)
        assert taker.source.status()[0].lost == 0
    assert [m.data for m in taker.taken] == [truth(v) for v in (True, False, True, False)]


def test_qualities_are_those_that_all_publishers_offer(peer: Peer) -> None:
    peer.publisher(LOCKED, BOOL, KEPT)
    peer.publisher(LOCKED, BOOL, RELIABLE)
    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED, publishers=2))
        assert taker.source.topics()[0].qos == Qos(Reliability.RELIABLE, Durability.VOLATILE)


MAPPINGS = tuple(m for m in DEFAULT_MAPPINGS if m.signal in (Signal.DOOR, Signal.HANDLE))
PATIENCE = 3.0
LONGEST_STEP = 0.5
"""s of real time, 0.02 s of waiting included, on a busy machine."""


class Talker:
    """A node's publishers of door angle and handle force at 50 Hz, one of them with a fault."""

    def __init__(self, peer: Peer) -> None:
        self._messages = {m.topic: _at_rest(m) for m in MAPPINGS}
        self._publishers = {m.topic: peer.publisher(m.topic, m.type) for m in MAPPINGS}
        self._spoils: dict[str, Spoil] = {}
        self._quiet = threading.Event()
        self._thread = threading.Thread(target=self._talk)

    def spoil(self, topic: str, fault: Fault) -> None:
        self._spoils[topic] = spoiler(topic, fault)

    def leave(self, peer: Peer, topic: str) -> None:
        """One publisher goes away."""
        peer.own.destroy_publisher(self._publishers.pop(topic))

    @contextmanager
    def talking(self) -> Iterator[None]:
        self._thread.start()
        try:
            yield
        finally:
            self._quiet.set()
            self._thread.join()

    def _talk(self) -> None:
        begin, count = time.monotonic(), 0
        while not self._quiet.wait(max(0.0, begin + count / 50 - time.monotonic())):
            count += 1
            for topic, publisher in tuple(self._publishers.items()):
                for message in self._next(topic):
                    publisher.publish(message.data)

    def _next(self, topic: str) -> list[RawMessage]:
        now = time.time_ns()

        def stamp(content: object) -> None:
            where = content.header.stamp  # type: ignore[attr-defined]
            where.sec, where.nanosec = divmod(now, NS)

        message = edited(self._messages[topic], stamp)
        return self._spoils[topic](message) if topic in self._spoils else [message]


def _at_rest(mapping: TopicMapping) -> RawMessage:
    content = TYPES.make(mapping.type)
    set_value(content, 0.0)
    return RawMessage(mapping.topic, mapping.type, TYPES.encode(mapping.type, content), 0, 0)


class Watched:
    """An engine on ROS; how long its steps take is measured."""

    def __init__(self, results: Path) -> None:
        types, clock = MessageTypes(), SystemClock()
        self.source = RosSource(MAPPINGS, types, clock)
        config = EngineConfig(results, MAPPINGS, disk_needed=0)
        self.engine = Engine(self.source, clock, config, types)
        self.longest_step = 0.0

    def step(self) -> None:
        begin = time.monotonic()
        self.engine.step(0.02)
        self.longest_step = max(self.longest_step, time.monotonic() - begin)

    def until(self, condition: Callable[[], object], patience: float = 15.0) -> float:
        """Go on until something holds; how long that took, s."""
        begin = time.monotonic()
        while not condition():
            assert time.monotonic() - begin < patience, self.faults()
            self.step()
        return time.monotonic() - begin

    def wait(self, duration: float) -> None:
        end = time.monotonic() + duration
        self.until(lambda: time.monotonic() >= end, duration + 5)

    def faults(self) -> str:
        return "\n".join(self.engine.snapshot().all_faults)

    def names(self, words: str) -> Callable[[], object]:
        return lambda: re.search(words, self.faults(), re.MULTILINE)


@pytest.fixture
def talker(peer: Peer) -> Iterator[Talker]:
    talker = Talker(peer)
    with talker.talking():
        yield talker


@pytest.fixture
def watched(talker: Talker, tmp_path: Path) -> Iterator[Watched]:
    """An engine to which the talker speaks, and all is well."""
    watched = Watched(tmp_path)
    watched.engine.open()
    try:
        watched.until(lambda: watched.faults() == "")
        assert all(view.publishers == 1 for view in watched.engine.snapshot().topics)
        yield watched
        assert watched.longest_step < LONGEST_STEP
    finally:
        watched.engine.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Fault.FLOODS, r"\d+ messages/s, far above 50"),
        (Fault.NAN, "no reading in .* force is NaN"),
        (Fault.STEPS_BACK_AGAIN, "the stamp repeats or goes back"),
        (Fault.BEHIND, r"stamps 5\.\d+ s late"),
        (Fault.TRUNCATED, "not a geometry_msgs/msg/WrenchStamped"),
    ],
)
def test_what_a_publisher_does_wrong_is_named(
    watched: Watched, talker: Talker, fault: Fault, words: str
) -> None:
    talker.spoil(HANDLE, fault)
    assert watched.until(watched.names(f"^handle force: .*{words}"), PATIENCE) < PATIENCE
    assert not watched.names(f"^door angle: .*{words}")()


@pytest.mark.slow
def test_a_publisher_that_goes_away_is_named(watched: Watched, talker: Talker, peer: Peer) -> None:
    talker.leave(peer, HANDLE)
    watched.until(watched.names("^handle force: silent for"), PATIENCE)
    watched.until(lambda: watched.source.status()[1].publishers == 0, PATIENCE)


@pytest.mark.slow
def test_a_second_publisher_is_named(watched: Watched, peer: Peer) -> None:
    peer.publisher(HANDLE, "geometry_msgs/msg/WrenchStamped")
    watched.until(watched.names("^handle force: 2 publishers: keep one"), PATIENCE)


@pytest.mark.slow
def test_a_publisher_that_comes_back_with_another_type_is_named(
    watched: Watched, talker: Talker, peer: Peer
) -> None:
    talker.leave(peer, HANDLE)
    peer.publisher(HANDLE, STRING)
    words = "^handle force: its type is std_msgs/msg/String, not geometry_msgs/msg/WrenchStamped"
    watched.until(watched.names(words), PATIENCE)


@pytest.mark.slow
def test_a_publisher_of_another_type_beside_the_right_one_is_named(
    watched: Watched, ros_domain: int
) -> None:
    words = "^handle force: another publisher sends std_msgs/msg/String: stop that one"
    with Peer(ros_domain) as stranger:
        stranger.publisher(HANDLE, STRING)
        watched.until(watched.names(words), PATIENCE)


@pytest.mark.slow
@pytest.mark.slow
def test_a_run_in_a_flood_is_recorded_whole_and_stopped_at_once(
    watched: Watched, talker: Talker
) -> None:
    engine = watched.engine
    assert engine.perform(SetUp(make_setup(countdown=1.0))) is None
    assert engine.perform(ConfirmPose()) is None
    talker.spoil(HANDLE, Fault.FLOODS)
    watched.until(watched.names("far above 50"), PATIENCE)
    for check in blocking(engine.snapshot().checks):
        assert engine.perform(Waive(check.name, "two topics, one of them a flood")) is None
    before = _received(engine)
    assert engine.perform(Start()) is None
    watched.wait(4.0)
    said = engine.now()
    assert engine.perform(Abort("enough")) is None
    during = watched.longest_step
    watched.until(lambda: engine.scored is not None, 10.0)
    watched.longest_step = during  # the first result of a process loads scipy
    assert engine.run.outcome is Outcome.ABORTED
    assert engine.run.stop == pytest.approx(said, abs=0.05)
    assert engine.folder is not None
    kept = [m for m in read_bag(engine.folder).messages() if m.topic == HANDLE]
    assert len(kept) == _received(engine) - before
    assert len(kept) > 4.0 * 1000
    assert [status.lost for status in watched.source.status()] == [0, 0]
    assert (engine.snapshot().recorder.dropped, engine.refused) == (0, "")


def _received(engine: Engine) -> int:
    return next(view.received for view in engine.snapshot().topics if view.topic == HANDLE)
