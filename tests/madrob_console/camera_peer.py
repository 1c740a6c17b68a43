"""Cameras and other topics of a hall, as a program of their own over real DDS.

    python -m tests.madrob_console.camera_peer STREAMS

STREAMS is a JSON list of `Stream`: `[{"topic": "/camera/c{}", "count": 4, "rate": 30}]`. All is
made beforehand: only the stamp of a message is new. SIGTERM ends it.
"""

from __future__ import annotations

import heapq
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import msgspec
import numpy as np

from madrob_console.common.clock import NS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.ros.connection import RosObject
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Qos, Reliability
from tests.madrob_console.ros_peer import Peer

_ROOT = Path(__file__).parents[2]
_TYPES = MessageTypes()
_FRAMES = 12
"""Messages of a topic that are made; then they begin anew."""
_OTHER_TYPE = "std_msgs/msg/Header"
_FLOOD_RATE = 1000.0


class Kind(StrEnum):
    """What a stream carries: its ROS type."""

    JPEG = "sensor_msgs/msg/CompressedImage"
    RAW = "sensor_msgs/msg/Image"  # rgb8
    POSE = "geometry_msgs/msg/PoseStamped"  # about 100 bytes

    @property
    def type(self) -> str:
        """The ROS type."""
        return self.value


class Misbehaviour(StrEnum):
    """What a stream does wrong from some second on."""

    NONE = "none"
    OTHER_TYPE = "other_type"  # std_msgs/msg/Header under the same name
    FLOOD = "flood"  # 1 kHz
    VANISHES = "vanishes"  # its publishers are gone


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
        misbehaviour: what it does wrong `after` seconds.
        after: see there.
    """

    kind: Kind = Kind.JPEG
    topic: str = "/camera/c{}/image/compressed"
    count: int = 1
    rate: float = 30.0
    size: int = 200_000
    reliable: bool = False
    misbehaviour: Misbehaviour = Misbehaviour.NONE
    after: float = 0.0

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


def _encoded(type_name: str, **fields: object) -> bytes:
    header = _TYPES.make(_OTHER_TYPE, frame_id="camera")
    return _TYPES.encode(type_name, _TYPES.make(type_name, header=header, **fields))


class _Sender:
    """One topic."""

    def __init__(self, peer: Peer, stream: Stream, topic: str) -> None:
        self._peer = peer
        self._stream = stream
        self._topic = topic
        noise = np.random.default_rng(zlib.crc32(topic.encode()))
        self._messages = [_message(stream, noise) for _ in range(_FRAMES)]
        self._wrong = stream.misbehaviour is Misbehaviour.NONE
        self.rate = stream.rate
        self._sent = 0
        self.publisher: RosObject = self._publisher(stream.kind)

    def _publisher(self, type_name: str) -> RosObject:
        reliability = Reliability.RELIABLE if self._stream.reliable else Reliability.BEST_EFFORT
        return self._peer.publisher(self._topic, type_name, Qos(reliability))

    def send(self, elapsed: float) -> None:
        """Publish the next one."""
        if not self._wrong and elapsed >= self._stream.after:
            self._go_wrong(self._stream.misbehaviour)
        if self.publisher is not None:
            data = self._messages[self._sent % len(self._messages)]
            stamp = struct.pack("<iI", *divmod(time.time_ns(), NS))
            self.publisher.publish(data[:4] + stamp + data[12:])
            self._sent += 1

    def _go_wrong(self, misbehaviour: Misbehaviour) -> None:
        self._wrong = True
        if misbehaviour is Misbehaviour.FLOOD:
            self.rate = _FLOOD_RATE
            return
        self._peer.own.destroy_publisher(self.publisher)
        other = misbehaviour is Misbehaviour.OTHER_TYPE
        self.publisher = self._publisher(_OTHER_TYPE) if other else None
        header = _TYPES.make(_OTHER_TYPE, frame_id="camera")
        self._messages = [_TYPES.encode(_OTHER_TYPE, header)]


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
        senders[topic].send(at - begin)
        heapq.heapreplace(due, (at + 1 / senders[topic].rate, topic))


@contextmanager
def cameras(*streams: Stream) -> Iterator[subprocess.Popen[bytes]]:
    """The program, running."""
    argv = [sys.executable, "-m", __name__, msgspec.json.encode(streams).decode()]
    with subprocess.Popen(argv, cwd=_ROOT) as process:
        try:
            yield process
        finally:
            process.terminate()


def main() -> None:
    """Send until a signal comes."""
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    with Peer(domain_id(None, os.environ)) as peer:
        publish(peer, msgspec.json.decode(sys.argv[1], type=list[Stream]), stop)


if __name__ == "__main__":
    main()
