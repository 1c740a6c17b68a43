"""Cameras and other topics of a hall, as a program of their own over real DDS.

    python -m tests.madrob_console.camera_peer STREAMS [--seconds S] [--wait S]

STREAMS is a JSON list of `Stream`: `[{"topic": "/camera/c{}", "count": 4, "rate": 30}]`. All is
made beforehand: only the stamp of a message is new. `--wait` lets it begin when every topic has a
subscription. At the end it prints what was sent, by topic, as JSON; SIGTERM and SIGINT end it, too.
"""

from __future__ import annotations

import argparse
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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import msgspec
import numpy as np

from madrob_console.common.clock import NS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.ros.connection import RosObject, load_module
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Qos, Reliability
from tests.madrob_console.ros_peer import MATCHED, Peer

_ROOT = Path(__file__).parents[2]
_TYPES = MessageTypes()
_FRAMES = 12
"""Messages of a topic that are made; then they begin anew."""
_NEVER = 1e9  # s
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


def messages(stream: Stream, topic: str) -> list[bytes]:
    """The CDR bytes of a topic that behaves: a stamp, and it can be sent."""
    noise = np.random.default_rng(zlib.crc32(topic.encode()))
    return [_message(stream, noise) for _ in range(_FRAMES)]


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
        self._messages = messages(stream, topic)
        self._wrong = stream.misbehaviour is Misbehaviour.NONE
        self.rate = stream.rate
        self.sent = 0
        self.publisher: RosObject = self._publisher(stream.kind)

    def _publisher(self, type_name: str) -> RosObject:
        reliability = Reliability.RELIABLE if self._stream.reliable else Reliability.BEST_EFFORT
        return self._peer.publisher(self._topic, type_name, Qos(reliability))

    def send(self, elapsed: float) -> None:
        """Publish the next one."""
        if not self._wrong and elapsed >= self._stream.after:
            self._go_wrong(self._stream.misbehaviour)
        if self.publisher is not None:
            data = self._messages[self.sent % len(self._messages)]
            stamp = struct.pack("<iI", *divmod(time.time_ns(), NS))
            self.publisher.publish(data[:4] + stamp + data[12:])
            self.sent += 1

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


def publish(
    peer: Peer, streams: Sequence[Stream], seconds: float, wait: float, stop: threading.Event
) -> Mapping[str, int]:
    """Send streams until their time is over or `stop` is set; the messages sent by topic."""
    senders = {topic: _Sender(peer, one, topic) for one in streams for topic in one.topics}
    ends = time.monotonic() + wait
    while time.monotonic() < ends and not all(
        s.publisher.get_subscription_count() for s in senders.values()
    ):
        stop.wait(0.05)
    stop.wait(MATCHED if wait else 0.0)
    begin = time.monotonic()
    # topics alike do not send all at once
    due = [(begin + n / len(senders) / s.rate, t) for n, (t, s) in enumerate(senders.items())]
    heapq.heapify(due)
    while due[0][0] < begin + seconds and not stop.is_set():
        at, topic = due[0]
        if (left := at - time.monotonic()) > 0:
            time.sleep(left)
        senders[topic].send(at - begin)
        heapq.heapreplace(due, (at + 1 / senders[topic].rate, topic))
    patience = load_module("rclpy.duration").Duration(seconds=5)
    for sender in senders.values():  # what is reliable and under way
        if sender.publisher is not None:
            sender.publisher.wait_for_all_acked(patience)
    return {topic: sender.sent for topic, sender in senders.items()}


@contextmanager
def cameras(
    *streams: Stream,
    seconds: float = _NEVER,
    wait: float = 0.0,
    env: Mapping[str, str] | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """The program, running; `communicate` waits for its end and has what was sent."""
    words = [msgspec.json.encode(streams).decode(), f"--seconds={seconds}", f"--wait={wait}"]
    argv = [sys.executable, "-m", __name__, *words]
    with subprocess.Popen(
        argv, cwd=_ROOT, env=os.environ | (env or {}), stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.terminate()
            if process.stdout is not None and not process.stdout.closed:
                process.communicate()  # it still says what was sent


def main() -> None:
    """Send, and print what was sent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("streams")
    parser.add_argument("--seconds", type=float, default=_NEVER)
    parser.add_argument("--wait", type=float, default=0.0)
    arguments = parser.parse_args()
    streams = msgspec.json.decode(arguments.streams, type=list[Stream])
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with Peer(domain_id(None, os.environ)) as peer:
        sent = publish(peer, streams, arguments.seconds, arguments.wait, stop)
    print(json.dumps({"sent": sent, "cpu_s": time.process_time()}))


if __name__ == "__main__":
    main()
