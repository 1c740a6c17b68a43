"""Cameras and other topics of a hall, as a program of their own over real DDS.

    python -m tests.madrob_console.camera_peer STREAM... [--seconds S] [--wait S]

A STREAM reads `kind=jpeg topic=/camera/c{}/image/compressed count=4 rate=30 size=200000`; what is
left out is as in `Stream`. All is encoded beforehand: only the stamp of a message is new. `--wait`
lets it begin when every topic has a subscription. At the end it prints what was sent, by topic, as
JSON; SIGTERM and SIGINT end it, too.
"""

from __future__ import annotations

import argparse
import heapq
import io
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
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from madrob_console.common.clock import NS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.ros.connection import RosObject, load_module
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Qos, Reliability
from tests.madrob_console.ros_peer import MATCHED, Peer

_ROOT = Path(__file__).parents[2]
_TYPES = MessageTypes()
_FRAMES = 12
"""Pictures of a stream that are made; then the pattern begins anew."""
_NEVER = 1e9  # s


class Kind(StrEnum):
    """What a stream carries."""

    JPEG = "jpeg"  # sensor_msgs/msg/CompressedImage
    RAW = "raw"  # sensor_msgs/msg/Image, rgb8
    POSE = "pose"  # geometry_msgs/msg/PoseStamped, about 100 bytes

    @property
    def type(self) -> str:
        """The ROS type."""
        return _TYPE[self]


_TYPE = {
    Kind.JPEG: "sensor_msgs/msg/CompressedImage",
    Kind.RAW: "sensor_msgs/msg/Image",
    Kind.POSE: "geometry_msgs/msg/PoseStamped",
}


class Misbehaviour(StrEnum):
    """What a stream does wrong from some second on."""

    NONE = "none"
    HUGE = "huge"  # messages of 50 MB
    OTHER_TYPE = "other_type"  # std_msgs/msg/Header under the same name
    FLOOD = "flood"  # 1 kHz
    VANISHES = "vanishes"  # its publishers are gone
    GARBAGE = "garbage"  # no picture, though the message says jpeg
    LIES = "lies"  # a picture that claims 65500 x 65500
    TRUNCATED = "truncated"  # the second half of the message is not there


_OTHER_TYPE = "std_msgs/msg/Header"
_HUGE_BYTES = 50_000_000
_FLOOD_RATE = 1000.0


@dataclass(frozen=True, slots=True)
class Stream:
    """Some topics alike.

    Attributes:
        kind: what they carry.
        topic: full name; `{}` is the number of the topic, from 0.
        count: number of topics.
        rate: messages/s of each.
        size: about the bytes of a picture.
        offset: seconds by which the clock of the stamps is fast.
        reliable: whether DDS sends again what was lost.
        misbehaviour: what it does wrong `after` seconds.
        after: see there.
    """

    kind: Kind = Kind.JPEG
    topic: str = "/camera/c{}/image/compressed"
    count: int = 1
    rate: float = 30.0
    size: int = 200_000
    offset: float = 0.0
    reliable: bool = False
    misbehaviour: Misbehaviour = Misbehaviour.NONE
    after: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Self:
        """The stream in words, as on the command line.

        Raises:
            ValueError: a word is none of `name=value`, or is not known.
        """
        kinds = get_type_hints(cls)
        given = dict(word.split("=", 1) for word in text.split())
        if unknown := given.keys() - kinds.keys():
            raise ValueError(f"no {min(unknown)}: use {', '.join(kinds)}")
        values: dict[str, Any] = {
            name: kinds[name](value == "True" if kinds[name] is bool else value)
            for name, value in given.items()
        }
        return cls(**values)

    def text(self) -> str:
        """What `parse` reads."""
        return " ".join(f"{f.name}={getattr(self, f.name)}" for f in fields(self))

    @property
    def topics(self) -> list[str]:
        """Their names."""
        return [self.topic.format(number) for number in range(self.count)]


def pattern(width: int, height: int, frame: int, camera: str = "") -> NDArray[np.uint8]:
    """A test picture (height, width, 3): colours, a camera's own noise, and a bar that moves."""
    x, y = np.meshgrid(np.linspace(0, 200, width), np.linspace(0, 200, height))
    picture = np.stack([x, y, 200 - x], axis=2)
    left = frame * width // _FRAMES
    picture[:, left : left + width // _FRAMES] = (250, 250, 40)
    noise = np.random.default_rng(zlib.crc32(f"{camera} {frame}".encode()))
    picture += noise.integers(0, 21, picture.shape, np.uint8)
    return np.clip(picture, 0, 255).astype(np.uint8)


def jpeg(size: int, frame: int, camera: str = "") -> bytes:
    """A picture of about `size` bytes as JPEG, with camera and frame written in it."""
    width = max(64, int((size * 6) ** 0.5) // 16 * 16)
    image = Image.fromarray(pattern(width, width * 9 // 16, frame, camera))
    ImageDraw.Draw(image).text((8, 8), f"{camera} {frame}", fill="white")
    return _jpeg(image, _quality(size, width))


@cache
def _quality(size: int, width: int) -> int:
    """The JPEG quality with which a picture as wide as this is nearest to a size."""
    image = Image.fromarray(pattern(width, width * 9 // 16, 0))
    return min(range(40, 98, 3), key=lambda quality: abs(len(_jpeg(image, quality)) - size))


def _jpeg(image: Image.Image, quality: int) -> bytes:
    file = io.BytesIO()
    image.save(file, "JPEG", quality=quality)
    return file.getvalue()


def lying(picture: bytes) -> bytes:
    """A JPEG that claims 65500 x 65500 pixels."""
    found = picture.index(b"\xff\xc0")  # the frame's header: length, bits, height, width
    return picture[: found + 5] + struct.pack(">HH", 65500, 65500) + picture[found + 9 :]


def compressed_image(data: bytes, stamp_ns: int = 0) -> bytes:
    """A picture's file as the CDR bytes of a `CompressedImage`."""
    fields = {"format": "jpeg", "data": np.frombuffer(data, np.uint8)}
    return stamped(_encoded(Kind.JPEG.type, **fields), stamp_ns)


def raw_image(pixels: NDArray[np.uint8], stamp_ns: int = 0) -> bytes:
    """Pixels (height, width, 3) as the CDR bytes of an `Image`."""
    height, width, colours = pixels.shape
    encoded = _encoded(
        Kind.RAW.type,
        height=height,
        width=width,
        encoding="rgb8",
        step=width * colours,
        data=pixels.reshape(-1),
    )
    return stamped(encoded, stamp_ns)


def _encoded(type_name: str, **fields: object) -> bytes:
    header = _TYPES.make("std_msgs/msg/Header", frame_id="camera")
    return _TYPES.encode(type_name, _TYPES.make(type_name, header=header, **fields))


def stamped(data: bytes, stamp_ns: int) -> bytes:
    """A message that begins with a header, with another stamp in it."""
    seconds, nanoseconds = divmod(stamp_ns, NS)
    return data[:4] + struct.pack("<iI", seconds, nanoseconds) + data[12:]


def messages(stream: Stream, topic: str) -> list[bytes]:
    """The CDR bytes of a topic that behaves: a stamp, and it can be sent."""
    match stream.kind:
        case Kind.JPEG:
            return [compressed_image(jpeg(stream.size, n, topic)) for n in range(_FRAMES)]
        case Kind.RAW:
            width = max(16, int((stream.size * 16 / 27) ** 0.5))
            height = max(1, round(stream.size / 3 / width))
            return [raw_image(pattern(width, height, n, topic)) for n in range(_FRAMES)]
        case Kind.POSE:
            return [_encoded(stream.kind.type)]


def misbehaving(stream: Stream, good: Sequence[bytes]) -> list[bytes]:
    """What a topic sends when it misbehaves."""
    match stream.misbehaviour:
        case Misbehaviour.HUGE:
            if stream.kind is Kind.RAW:
                return [raw_image(np.zeros((5000, _HUGE_BYTES // 15000, 3), np.uint8))]
            return [compressed_image(bytes(_HUGE_BYTES))]
        case Misbehaviour.OTHER_TYPE:
            return [_TYPES.encode(_OTHER_TYPE, _TYPES.make(_OTHER_TYPE, frame_id="camera"))]
        case Misbehaviour.GARBAGE:
            return [compressed_image(np.random.default_rng(0).bytes(stream.size))]
        case Misbehaviour.LIES:
            return [compressed_image(lying(jpeg(stream.size, 0)))]
        case Misbehaviour.TRUNCATED:
            return [data[: len(data) // 2] for data in good]
        case _:
            return list(good)


class _Sender:
    """One topic."""

    def __init__(self, peer: Peer, stream: Stream, topic: str, good: list[bytes]) -> None:
        self._peer = peer
        self._stream = stream
        self._topic = topic
        self._messages = good
        self._bad = misbehaving(stream, good)
        self._faulty = stream.misbehaviour is Misbehaviour.NONE
        self.rate = stream.rate
        self.sent = 0
        self.publisher: RosObject = self._publisher(stream.kind.type)

    def _publisher(self, type_name: str) -> RosObject:
        reliability = Reliability.RELIABLE if self._stream.reliable else Reliability.BEST_EFFORT
        return self._peer.publisher(self._topic, type_name, Qos(reliability))

    def send(self, elapsed: float) -> None:
        """Publish the next one."""
        if not self._faulty and elapsed >= self._stream.after:
            self._go_wrong()
        if self.publisher is None:
            return
        data = self._messages[self.sent % len(self._messages)]
        self.publisher.publish(stamped(data, time.time_ns() + round(self._stream.offset * NS)))
        self.sent += 1

    def _go_wrong(self) -> None:
        self._faulty, self._messages = True, self._bad
        match self._stream.misbehaviour:
            case Misbehaviour.FLOOD:
                self.rate = _FLOOD_RATE
            case Misbehaviour.VANISHES | Misbehaviour.OTHER_TYPE as misbehaviour:
                self._peer.own.destroy_publisher(self.publisher)
                other = misbehaviour is Misbehaviour.OTHER_TYPE
                self.publisher = self._publisher(_OTHER_TYPE) if other else None


def publish(
    peer: Peer, streams: Sequence[Stream], seconds: float, wait: float, stop: threading.Event
) -> Mapping[str, int]:
    """Send streams until their time is over or `stop` is set; the messages sent by topic."""
    senders: dict[str, _Sender] = {}
    for stream in streams:
        good: list[bytes] = []
        for topic in stream.topics:
            if stream.kind is not Kind.POSE or not good:
                good = messages(stream, topic)
            senders[topic] = _Sender(peer, stream, topic, good)
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
    while due and due[0][0] < begin + seconds and not stop.is_set():
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
    words = [s.text() for s in streams]
    argv = [sys.executable, "-m", __name__, *words, f"--seconds={seconds}", f"--wait={wait}"]
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
    parser.add_argument("streams", nargs="+", type=Stream.parse)
    parser.add_argument("--seconds", type=float, default=_NEVER)
    parser.add_argument("--wait", type=float, default=0.0)
    arguments = parser.parse_args()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with Peer(domain_id(None, os.environ)) as peer:
        sent = publish(peer, arguments.streams, arguments.seconds, arguments.wait, stop)
    print(json.dumps({"sent": sent, "cpu_s": time.process_time()}))


if __name__ == "__main__":
    main()
