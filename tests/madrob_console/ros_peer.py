"""Another participant of a ROS domain, for tests: as a fixture, or as a process that publishes.

    python -m tests.madrob_console.ros_peer TOPICS MESSAGES RATE

floods so many topics with so many messages each, at so many a second.

    python -m tests.madrob_console.ros_peer STREAMS

is the cameras and other topics of a hall: a JSON list of `Stream`, such as
`[{"topic": "/camera/c{}", "count": 4, "rate": 30}]`, until SIGTERM. All is made beforehand: only
the stamp of a message is new.
"""

from __future__ import annotations

import heapq
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Self

import msgspec
import numpy as np

from madrob_console.common.clock import NS, SystemClock
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import (
    Connection,
    RosObject,
    load_message_class,
    load_module,
)
from madrob_console.testbeds.ros.subscriptions import qos_profile
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Durability, Qos, RawMessage, Reliability
from scoring.protocol import Signal
from tests.watching import PATIENCE, Closing

if TYPE_CHECKING:
    import pytest

RELIABLE = Qos()
BEST_EFFORT = Qos(Reliability.BEST_EFFORT)
KEPT = Qos(durability=Durability.TRANSIENT_LOCAL)
FLOOD = "/madrob/flood"
BOOL = "std_msgs/msg/Bool"
LOCKED = "/madrob/door/locked"
TYPES = MessageTypes()


class Peer(Connection, Closing):
    """A node `/madrob/peer` and others, spun only while a test waits."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self.own = self.node("peer")

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


class Taker(Closing):
    """An open source, and all that was taken from it."""

    def __init__(self, source: RosSource) -> None:
        self.source = source
        self.taken: list[RawMessage] = []

    def __enter__(self) -> Self:
        self.source.open()
        return self

    def close(self) -> None:
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


_FRAMES = 12
"""Messages of a topic that are made; then they begin anew."""
_OTHER_TYPE = "std_msgs/msg/Header"


class Kind(StrEnum):
    """What a stream carries: its ROS type."""

    JPEG = "sensor_msgs/msg/CompressedImage"
    RAW = "sensor_msgs/msg/Image"  # rgb8
    POSE = "geometry_msgs/msg/PoseStamped"  # about 100 bytes

    @property
    def type(self) -> str:
        """The ROS type."""
        return self.value


@dataclass(frozen=True, slots=True)
class Stream:
    """Some topics alike.

    Attributes:
        kind: what they carry.
        topic: full name; `{}` is the number of the topic, from 0.
        count: number of topics.
        rate: messages/s of each.
        size: about the bytes of a picture.
        reliable: whether DDS sends again what was lost.
    """

    kind: Kind = Kind.JPEG
    topic: str = "/camera/c{}/image/compressed"
    count: int = 1
    rate: float = 30.0
    size: int = 200_000
    reliable: bool = False

    @property
    def topics(self) -> list[str]:
        """Their names."""
        return [self.topic.format(number) for number in range(self.count)]


def _message(stream: Stream, noise: np.random.Generator) -> bytes:
    """A picture is as hard to compress as one of a camera."""
    match stream.kind:
        case Kind.JPEG:
            data = np.frombuffer(b"\xff\xd8\xff" + noise.bytes(stream.size), np.uint8)
            return _encoded(stream.kind, format="jpeg", data=data)
        case Kind.RAW:
            height = max(1, int((stream.size / 5) ** 0.5))
            width = max(1, stream.size // 3 // height)
            data = noise.integers(0, 21, 3 * width * height, np.uint8)
            size = {"height": height, "width": width, "step": 3 * width}
            return _encoded(stream.kind, encoding="rgb8", data=data, **size)
        case Kind.POSE:
            return _encoded(stream.kind)


_HEADER = TYPES.make(_OTHER_TYPE, frame_id="camera")


def _encoded(type_name: str, **fields: object) -> bytes:
    return TYPES.encode(type_name, TYPES.make(type_name, header=_HEADER, **fields))


class _Sender:
    """One topic."""

    def __init__(self, peer: Peer, stream: Stream, topic: str) -> None:
        self._peer = peer
        self._stream = stream
        self._topic = topic
        noise = np.random.default_rng(zlib.crc32(topic.encode()))
        self._messages = [_message(stream, noise) for _ in range(_FRAMES)]
        self.rate = stream.rate
        self._sent = 0
        self.publisher: RosObject = self._publisher(stream.kind)

    def _publisher(self, type_name: str) -> RosObject:
        reliability = Reliability.RELIABLE if self._stream.reliable else Reliability.BEST_EFFORT
        return self._peer.publisher(self._topic, type_name, Qos(reliability))

    def send(self) -> None:
        """Publish the next one."""
        data = self._messages[self._sent % len(self._messages)]
        stamp = struct.pack("<iI", *divmod(time.time_ns(), NS))
        self.publisher.publish(data[:4] + stamp + data[12:])
        self._sent += 1


def publish(peer: Peer, streams: Sequence[Stream], stop: threading.Event) -> None:
    """Send streams until `stop` is set."""
    senders = {topic: _Sender(peer, one, topic) for one in streams for topic in one.topics}
    begin = time.monotonic()
    # topics alike do not send all at once
    due = [(begin + n / len(senders) / s.rate, t) for n, (t, s) in enumerate(senders.items())]
    heapq.heapify(due)
    while not stop.is_set():
        at, topic = due[0]
        if (left := at - time.monotonic()) > 0:
            time.sleep(left)
        senders[topic].send()
        heapq.heapreplace(due, (at + 1 / senders[topic].rate, topic))


@contextmanager
def cameras(*streams: Stream) -> Iterator[subprocess.Popen[bytes]]:
    """They publish while inside."""
    argv = [sys.executable, "-m", __name__, msgspec.json.encode(streams).decode()]
    with subprocess.Popen(argv, cwd=Path(__file__).parents[2]) as process:
        try:
            yield process
        finally:
            process.terminate()


def main(first: str, *more: str) -> None:
    if more:
        messages, rate = more
        flood(int(first), int(messages), float(rate))
        return
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    with Peer(domain_id(None, os.environ)) as peer:
        publish(peer, msgspec.json.decode(first, type=list[Stream]), stop)


if __name__ == "__main__":
    main(*sys.argv[1:])
