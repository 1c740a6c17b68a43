"""What cameras send: frames of a moving pattern."""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from madrob_console.messages.types import standard_types
from recorder.bag import RawMessage
from recorder.reader import Bag
from tests.recorder.samples import add_evidence

COMPRESSED, RAW = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
NS = 1_000_000_000
FRONT, SIDE_CAMERA = "/camera/front/image/compressed", "/camera/side"


@cache
def pattern(number: int, size: tuple[int, int] = (160, 120)) -> Image.Image:
    """A frame whose bright bar moves with its number."""
    picture = Image.new("RGB", size, (40, 90, 140))
    draw = ImageDraw.Draw(picture)
    left = number * 4 % size[0]
    draw.rectangle((left, 0, left + size[0] // 10, size[1]), fill=(250, 220, 60))
    draw.text((4, 4), f"frame {number}", fill=(255, 255, 255))
    return picture


def packed(picture: Image.Image, kind: str = "JPEG") -> bytes:
    file = io.BytesIO()
    picture.save(file, kind)
    return file.getvalue()


def image(kind: str, topic: str, stamp: float, log: float, **fields: object) -> RawMessage:
    """A message of a camera by its own clock, received at another time; s since the epoch."""
    types = standard_types()
    sec, nanosec = divmod(round(stamp * NS), NS)
    time = types.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    header = types.make("std_msgs/msg/Header", stamp=time, frame_id="camera")
    message = types.encode(kind, types.make(kind, header=header, **fields))
    return RawMessage(topic, kind, message, round(log * NS), round(log * NS))


def compressed(topic: str, data: bytes, stamp: float, log: float, told: str = "jpeg") -> RawMessage:
    content = np.frombuffer(data, dtype=np.uint8)
    return image(COMPRESSED, topic, stamp, log, format=told, data=content)


def raw(
    data: bytes,
    encoding: str,
    width: int,
    height: int,
    step: int,
    *,
    topic: str = "/camera/raw",
    stamp: float = 1.0,
    log: float = 1.0,
    big: bool = False,
) -> RawMessage:
    size = {"height": height, "width": width, "step": step, "is_bigendian": int(big)}
    content = np.frombuffer(data, dtype=np.uint8)
    return image(RAW, topic, stamp, log, encoding=encoding, data=content, **size)


def span(folder: Path) -> tuple[float, float]:
    """The first and the last log time of a recording, s since the epoch."""
    times = [message.receive_ns for message in Bag(folder).messages()]
    return min(times) / NS, max(times) / NS


def stream(
    topic: str,
    begin: float,
    end: float,
) -> list[RawMessage]:
    """The frames of a camera of 15 Hz, received a little late."""
    messages = []
    for number in range(int((end - begin) * 15.0)):
        taken = begin + number / 15.0
        data = packed(pattern(number % 40))
        messages.append(compressed(topic, data, taken, taken + 0.005))
    return messages


def film(folder: Path, *topics: str) -> Path:
    """Give a recorded run the evidence of cameras."""
    begin, end = span(folder)
    messages = [one for topic in topics for one in stream(topic, begin, end)]
    messages.sort(key=lambda message: message.receive_ns)
    return add_evidence(folder, messages)
