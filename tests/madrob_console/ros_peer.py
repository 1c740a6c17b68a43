"""Another participant of a ROS domain, for tests: as a fixture, or as a process that floods.

python -m tests.madrob_console.ros_peer <topics> <messages a topic> <messages/s a topic>
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from madrob_console.common.clock import SystemClock
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import (
    Connection,
    RosObject,
    load_message_class,
    load_module,
)
from madrob_console.testbeds.ros.intake import qos_profile
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Durability, Qos, RawMessage, Reliability
from scoring.protocol import Signal
from tests.watching import PATIENCE

if TYPE_CHECKING:
    import pytest

RELIABLE = Qos()
BEST_EFFORT = Qos(Reliability.BEST_EFFORT)
KEPT = Qos(durability=Durability.TRANSIENT_LOCAL)
FLOOD = "/madrob/flood"
BOOL = "std_msgs/msg/Bool"
LOCKED = "/madrob/door/locked"
TYPES = MessageTypes()


class Peer(Connection):
    """A node `/madrob/peer` and others, spun only while a test waits."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self.own = self.node("peer")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def end_node(self, node: RosObject) -> None:
        """Take a node out of the domain."""
        self._executor.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()

    def publisher(self, topic: str, type_name: str, qos: Qos = RELIABLE) -> RosObject:
        return self.own.create_publisher(
            load_message_class(type_name), topic, qos_profile(qos, 1000)
        )

    def listen(self, topic: str, type_name: str, qos: Qos = RELIABLE) -> list[RosObject]:
        """A list that fills with the topic's messages while the test waits."""
        heard: list[RosObject] = []
        self.own.create_subscription(
            load_message_class(type_name), topic, heard.append, qos_profile(qos, 1000)
        )
        return heard

    def listen_raw(self, topic: str, type_name: str, qos: Qos = RELIABLE) -> list[bytes]:
        """As `listen`, with the bytes as they came."""
        heard: list[bytes] = []
        self.own.create_subscription(
            load_message_class(type_name), topic, heard.append, qos_profile(qos, 1000), raw=True
        )
        return heard

    def reaches(self, taker: Taker, topic: str, publishers: int = 1) -> bool:
        """Both have found each other: what is published before that may be lost."""
        return taker.matched(topic, publishers) and all(
            publisher.get_subscription_count()
            for publisher in self.own.publishers
            if publisher.topic_name != "/parameter_events"
        )

    def say(
        self,
        taker: Taker,
        publisher: RosObject,
        *values: bool,
        topic: str = LOCKED,
        publishers: int = 1,
    ) -> None:
        """Publish values once both have found each other, and wait until they have come."""
        self.until(lambda: self.reaches(taker, topic, publishers))
        wanted = len(taker.taken) + len(values)
        for value in values:
            publisher.publish(truth(value))
        self.until(lambda: taker.has(wanted))

    def until(self, condition: Callable[[], object], seconds: float = PATIENCE) -> None:
        """Spin until something holds; fails when it never does."""
        ends = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < ends, "it never happened"
            self.spin(0.01)


class Taker:
    """An open source, and all that was taken from it."""

    def __init__(self, source: RosSource) -> None:
        self.source = source
        self.taken: list[RawMessage] = []

    def __enter__(self) -> Self:
        self.source.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.source.close()

    def matched(self, topic: str, publishers: int = 1) -> bool:
        return any(s.topic == topic and s.publishers == publishers for s in self.source.status())

    def problem(self, topic: str = LOCKED) -> str:
        """What is wrong with a topic, in words; empty = nothing."""
        return next(s.problem or "" for s in self.source.status() if s.topic == topic)

    def has(self, count: int) -> bool:
        self.taken += self.source.take_messages(0.01)
        return len(self.taken) >= count


def source(*mappings: TopicMapping, speaks: bool = True) -> RosSource:
    return RosSource(mappings or DEFAULT_MAPPINGS, MessageTypes(), SystemClock(), speaks=speaks)


def latch(topic: str = LOCKED, type_name: str = BOOL) -> TopicMapping:
    return TopicMapping(Signal.LATCH, topic, type_name, "data")


def truth(value: bool) -> bytes:
    return TYPES.encode(BOOL, TYPES.make(BOOL, data=value))


def install_first(
    folder: Path, type_name: str, definition: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A workspace before all others, in which a type has this definition and another hash."""
    package, _, name = type_name.split("/")
    place = folder / "share" / package / "msg"
    place.mkdir(parents=True)
    (place / f"{name}.msg").write_text(definition)
    hashes = [{"type_name": type_name, "hash_string": "RIHS01_00"}]
    (place / f"{name}.json").write_text(json.dumps({"type_hashes": hashes}))
    own = os.environ.get("AMENT_PREFIX_PATH", sys.prefix)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{folder}{os.pathsep}{own}")


def flood(topics: int, messages: int, rate: float) -> None:
    """Publish one message without a number and then numbered ones on many topics that are heard."""
    header = "std_msgs/msg/Header"
    with Peer(domain_id(None, os.environ)) as peer:
        publishers = [peer.publisher(f"{FLOOD}_{i}", header) for i in range(topics)]
        peer.until(lambda: all(p.get_subscription_count() for p in publishers), 30)
        # DDS may take its heartbeat of 3 s to send again what was lost under way
        patience = load_module("rclpy.duration").Duration(seconds=20)
        for publisher in publishers:
            publisher.publish(TYPES.encode(header, TYPES.make(header)))
        # who has acknowledged it has found this side, too
        assert all(publisher.wait_for_all_acked(patience) for publisher in publishers)
        begin = time.monotonic()
        for number in range(messages):
            message = TYPES.make(header, frame_id=str(number))
            data = TYPES.encode(header, message)
            for publisher in publishers:
                publisher.publish(data)
            time.sleep(max(0.0, begin + (number + 1) / rate - time.monotonic()))
        assert all(publisher.wait_for_all_acked(patience) for publisher in publishers)


def main(arguments: Sequence[str]) -> None:
    topics, messages, rate = arguments
    flood(int(topics), int(messages), float(rate))


if __name__ == "__main__":
    main(sys.argv[1:])
