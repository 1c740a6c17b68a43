"""Faults of the testbed over real ROS: named within 3 s, and no step of the engine takes long."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.clock import NS, SystemClock
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes, TopicMapping
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive
from madrob_console.referee.preflight import blocking
from madrob_console.testbeds.ros import RosSource
from recorder.message import RawMessage
from recorder.reader import read_bag
from scoring.protocol import Outcome, Signal
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.spoilt import (
    DOOR,
    HANDLE,
    STRING,
    TYPES,
    Fault,
    Spoil,
    edited,
    set_value,
    spoiler,
)
from tests.madrob_console.ros_peer import Peer

pytestmark = pytest.mark.slow

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
        return "\n".join(self.engine.snapshot().faults)

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


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Fault.FLOODS, r"\d+ Hz, far above 50 Hz"),
        (Fault.NAN, "no reading in .* force is NaN"),
        (Fault.STEPS_BACK_AGAIN, "the stamp repeats or goes back"),
        (Fault.BEHIND, r"stamps 5\.\d+ s behind their reception"),
        (Fault.TRUNCATED, "not a geometry_msgs/msg/WrenchStamped"),
    ],
)
def test_what_a_publisher_does_wrong_is_named(
    watched: Watched, talker: Talker, fault: Fault, words: str
) -> None:
    talker.spoil(HANDLE, fault)
    assert watched.until(watched.names(f"^{HANDLE}: .*{words}"), PATIENCE) < PATIENCE
    assert not watched.names(f"^{DOOR}: .*{words}")()


def test_a_publisher_that_goes_away_is_named(watched: Watched, talker: Talker, peer: Peer) -> None:
    talker.leave(peer, HANDLE)
    watched.until(watched.names(f"^{HANDLE}: stale, silent for"), PATIENCE)
    watched.until(lambda: watched.source.status()[1].publishers == 0, PATIENCE)


def test_a_second_publisher_is_named(watched: Watched, peer: Peer) -> None:
    peer.publisher(HANDLE, "geometry_msgs/msg/WrenchStamped")
    watched.until(watched.names(f"^{HANDLE}: 2 publishers: keep one"), PATIENCE)


def test_a_publisher_that_comes_back_with_another_type_is_named(
    watched: Watched, talker: Talker, peer: Peer
) -> None:
    talker.leave(peer, HANDLE)
    peer.publisher(HANDLE, STRING)
    words = f"^{HANDLE}: its type is std_msgs/msg/String, not geometry_msgs/msg/WrenchStamped"
    watched.until(watched.names(words), PATIENCE)


def test_a_publisher_of_another_type_beside_the_right_one_is_named(
    watched: Watched, ros_domain: int
) -> None:
    words = f"^{HANDLE}: another publisher sends std_msgs/msg/String: stop that one"
    with Peer(ros_domain) as stranger:
        stranger.publisher(HANDLE, STRING)
        watched.until(watched.names(words), PATIENCE)


@pytest.mark.slow
def test_a_run_in_a_flood_is_recorded_whole_and_stopped_at_once(
    watched: Watched, talker: Talker
) -> None:
    engine = watched.engine
    assert engine.perform(SetUp(make_setup(countdown=1.0))) is None
    assert engine.perform(ConfirmPose()) is None
    talker.spoil(HANDLE, Fault.FLOODS)
    watched.until(watched.names("far above 50 Hz"), PATIENCE)
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
    assert (engine.snapshot().recorder.dropped, engine.result_problem) == (0, None)


def _received(engine: Engine) -> int:
    return next(view.received for view in engine.snapshot().topics if view.topic == HANDLE)
