from __future__ import annotations

import subprocess
import sys
import textwrap
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import NoReturn

import pytest

from madrob_console.common.names import SourceKind
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.testbeds.ros import ros_source
from recorder.bag import Durability, Qos, Reliability
from scoring.protocol import Signal
from tests.madrob_console import ros_peer, said
from tests.madrob_console.ros_peer import (
    BEST_EFFORT,
    BOOL,
    FLOOD,
    KEPT,
    LOCKED,
    RELIABLE,
    TYPES,
    Peer,
    Taker,
    latch,
    source,
    truth,
)
from tests.watching import PATIENCE, until

HEADER, STRING = "std_msgs/msg/Header", "std_msgs/msg/String"


@pytest.mark.parametrize("qos", [RELIABLE, BEST_EFFORT, KEPT])
def test_messages_arrive_byte_for_byte_with_their_times_and_quality(peer: Peer, qos: Qos) -> None:
    publisher = peer.publisher(LOCKED, BOOL, qos)
    with Taker(source(latch())) as taker:
        before = time.time_ns()
        peer.say(taker, publisher, True)
        assert taker.source.topics()[0].qos == qos  # for the bag
    (message,) = taker.taken
    assert (message.topic, message.type, message.data) == (LOCKED, BOOL, truth(True))
    assert before <= message.publish_ns <= message.receive_ns <= time.time_ns()


@pytest.mark.slow
@pytest.mark.usefixtures("ros_domain")
def test_nothing_is_lost_of_ten_topics_at_3000_messages_a_second() -> None:
    mappings = [TopicMapping(Signal.DOOR, f"{FLOOD}_{i}", HEADER, "stamp.sec") for i in range(10)]
    flood = [sys.executable, "-m", ros_peer.__name__, "10", "600", "300"]
    came: dict[str, list[str]] = defaultdict(list)
    with (
        Taker(source(*mappings)) as taker,
        subprocess.Popen(flood, cwd=Path(__file__).parents[4]) as process,
    ):
        until(lambda: taker.has(6000) and process.poll() is not None, 2 * PATIENCE)
        assert process.returncode == 0
        assert [s.problem for s in taker.source.status()] == [None] * 10
        assert [s.lost for s in taker.source.status()] == [0] * 10
    taker.has(0)
    for message in taker.taken:
        came[message.topic].append(TYPES.decode(message.type, message.data).frame_id)
    numbers = [str(number) for number in range(600)]
    assert [came[m.topic][-600:] for m in mappings] == [numbers] * 10
    times = [m.receive_ns for m in taker.taken]
    assert times == sorted(times)


def test_qualities_are_those_that_all_publishers_offer(peer: Peer) -> None:
    peer.publisher(LOCKED, BOOL, KEPT)
    peer.publisher(LOCKED, BOOL, RELIABLE)
    with Taker(source(latch())) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED, publishers=2))
        assert taker.source.topics()[0].qos == Qos(Reliability.RELIABLE, Durability.VOLATILE)


def test_the_last_value_of_a_transient_local_topic_is_received_late(peer: Peer) -> None:
    peer.publisher(LOCKED, BOOL, KEPT).publish(truth(True))
    with Taker(source()) as taker:
        peer.until(lambda: taker.has(1))
    assert taker.taken[0].data == truth(True)


def test_of_two_publishers_each_counts_once_it_sends_and_the_loss_is_unknown(peer: Peer) -> None:
    """One that was killed is there for 20 s more, for DDS."""
    first, second = (peer.publisher(LOCKED, BOOL) for _ in range(2))
    with Taker(source(latch())) as taker:
        peer.say(taker, first, *[True] * 150, publishers=2)
        peer.say(taker, second, True)
        peer.say(taker, first, True, publishers=2)
        assert taker.source.status()[0].lost is None
        peer.own.destroy_publisher(first)
        peer.until(lambda: taker.matched(LOCKED) and taker.source.status()[0].lost == 0)


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
        try:
            peer.until(lambda: taker.has(1))
            second = peer.publisher(LOCKED, BOOL, BEST_EFFORT)
            peer.until(lambda: taker.source.topics()[0].qos == BEST_EFFORT)
            peer.until(lambda: peer.reaches(taker, LOCKED))  # the second does not send yet
            peer.until(lambda: first.get_subscription_count() == 1)  # only the new one is left
        finally:
            enough.set()
            thread.join()
        peer.until(lambda: taker.has(sent))
        peer.say(taker, second, False)  # behind whatever comes twice
    assert [m.data for m in taker.taken].count(truth(True)) == sent
    assert [m.data for m in taker.taken].count(truth(False)) == 1


def test_a_publisher_that_comes_late_or_again_is_heard_and_no_loss(
    taker: Taker, peer: Peer
) -> None:
    for _ in range(2):
        assert not taker.matched(LOCKED)
        publisher = peer.publisher(LOCKED, BOOL)
        peer.say(taker, publisher, *[True] * 5)
        peer.own.destroy_publisher(publisher)
        peer.until(lambda: taker.matched(LOCKED, publishers=0))
    assert [s.lost for s in taker.source.status() if s.topic == LOCKED] == [0]


def test_another_type_is_named_alone_beside_the_right_one_and_in_its_place(
    taker: Taker, peer: Peer, ros_domain: int
) -> None:
    right = peer.publisher(LOCKED, BOOL)
    with Peer(ros_domain) as stranger:
        stranger.publisher(LOCKED, STRING)
        peer.until(lambda: taker.problem() == f"another publisher sends {STRING}: stop that one")
        peer.own.destroy_publisher(right)
        alone = f"its type is {STRING}, not {BOOL}: correct the settings"
        peer.until(lambda: taker.problem() == alone)
        assert next(s.type for s in taker.source.status() if s.topic == LOCKED) == STRING
    peer.publisher(LOCKED, BOOL)
    peer.until(lambda: taker.matched(LOCKED) and not taker.problem())


def test_a_type_that_is_not_installed_is_a_problem_of_its_topic_only(peer: Peer) -> None:
    handle = TopicMapping(Signal.HANDLE, "/madrob/handle", "madrob_msgs/msg/Handle", "force")
    publisher = peer.publisher(LOCKED, BOOL)
    with Taker(source(handle, latch())) as taker:
        assert taker.source.topics()[0].name == LOCKED
        assert taker.problem(handle.topic) == (
            "madrob_msgs/msg/Handle is not installed here: "
            "source the workspace that has madrob_msgs"
        )
        peer.say(taker, publisher, True)


def test_another_version_of_a_type_is_named(
    peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros_peer.install_first(tmp_path, BOOL, "bool data\n", monkeypatch)
    peer.publisher(LOCKED, BOOL)
    with Taker(source(latch())) as taker:
        peer.until(taker.problem)
        assert taker.problem() == (
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
        peer.until(lambda: taker.problem().startswith("ROS fails ("))
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
            peer.until(lambda: published() and taker.problem())
            assert taker.problem() == "ROS fails (MemoryError): start the console again"
        peer.until(lambda: published() and taker.has(1))


def test_what_arrived_before_the_end_can_still_be_taken(peer: Peer) -> None:
    publisher = peer.publisher(LOCKED, BOOL)
    with Taker(source()) as taker:
        peer.until(lambda: peer.reaches(taker, LOCKED))
        for _ in range(50):
            publisher.publish(truth(True))
        peer.until(lambda: len(taker.source._mailbox._messages) == 50)
    assert len(taker.source.take_messages(0)) == 50


def run_program(program: str) -> tuple[int, str, str]:
    """What a program of a few lines, with `make` for a source, ends with and says."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


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
    assert run_program(program) == (0, "", "")


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
    said = (
        "ROS 2 is not here (rclpy is missing): install madrob-console[ros], or source "
        "/opt/ros/jazzy/setup.bash in an environment that sees the system's packages, or use "
        "--testbed simulated\n"
    )
    assert run_program(program) == (0, said, "")


@pytest.mark.slow
def test_history_that_comes_again_with_another_subscription_is_no_news(peer: Peer) -> None:
    kept = peer.publisher(LOCKED, BOOL, KEPT)
    other = peer.publisher(LOCKED, BOOL, BEST_EFFORT)
    with Taker(source(latch())) as taker:
        peer.say(taker, kept, True, False, True, publishers=2)
        peer.own.destroy_publisher(other)
        peer.until(lambda: taker.source.topics()[0].qos == KEPT)
        peer.say(taker, kept, False)
        peer.say(taker, kept, True)  # behind whatever comes twice
        assert taker.source.status()[0].lost == 0
    assert [m.data for m in taker.taken] == [truth(v) for v in (True, False, True, False, True)]
