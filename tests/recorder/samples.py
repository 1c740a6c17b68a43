"""Topics and messages of a testbed, serialised by rosbags."""

from __future__ import annotations

import os
import resource
import threading
import tracemalloc
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import SeekingReader
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC, Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from recorder.bag import (
    EVIDENCE,
    Batch,
    Durability,
    Qos,
    RawMessage,
    Reliability,
    Topic,
    qos_text,
)
from recorder.writer import BagFile, BagWriter

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg

START_NS = 1_700_000_000_000_000_000
STEP_NS = 20_000_000

BEST_EFFORT = Qos(Reliability.BEST_EFFORT)
LATCHED = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL)


@cache
def typestore() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def topic(name: str, type_name: str, qos: Qos = Qos()) -> Topic:
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return Topic(name, type_name, text, typestore().hash_rihs01(type_name), qos)


@cache
def door_topics() -> tuple[Topic, ...]:
    return (
        topic("/madrob/door/angle", "sensor_msgs/msg/JointState", BEST_EFFORT),
        topic("/madrob/handle/force", "geometry_msgs/msg/WrenchStamped", BEST_EFFORT),
        topic("/madrob/passage/cw_left", "sensor_msgs/msg/LaserScan", BEST_EFFORT),
        topic("/madrob/door/locked", "std_msgs/msg/Bool"),
        topic("/madrob/referee/event", "std_msgs/msg/String"),
        topic("/madrob/referee/start_pose", "geometry_msgs/msg/PoseStamped", LATCHED),
    )


def door_messages(rounds: int) -> list[RawMessage]:
    """One message per topic and round; receive times a little out of order, as reality has it."""
    messages = []
    for number in range(rounds):
        for place, known in enumerate(door_topics()):
            time_ns = START_NS + number * STEP_NS + place * 1000
            data = encode(known.type, time_ns, number)
            received = time_ns + (50_000 if place % 2 else 70_000) - place * 3000
            messages.append(RawMessage(known.name, known.type, data, time_ns, received))
    return messages


def encode(type_name: str, time_ns: int, number: int) -> bytes:
    return _serialized(type_name, _BUILD[type_name](type_name, time_ns, number))


def _serialized(type_name: str, message: Msg) -> bytes:
    return bytes(typestore().serialize_cdr(message, type_name))


def strings(texts: list[str], name: str = "/talk") -> list[RawMessage]:
    """`std_msgs/msg/String` messages, a millisecond apart."""
    kind = talk().type
    times = (START_NS + number * 1_000_000 for number in range(len(texts)))
    return [
        RawMessage(name, kind, _serialized(kind, _made(kind, data=text)), at, at + 35_000)
        for text, at in zip(texts, times, strict=True)
    ]


def talk() -> Topic:
    return topic("/talk", "std_msgs/msg/String")


def by_library(
    messages: Iterable[RawMessage],
    topics: Sequence[Topic] | None = None,
    records: Mapping[str, Mapping[str, str]] | None = None,
    **options: Any,  # noqa: ANN401
) -> bytes:
    """A recording as other programs write it, by the options of the mcap library."""
    file, channels = BytesIO(), {}
    writer = Writer(file, **options)
    writer.start(profile="ros2")
    for known in [talk()] if topics is None else topics:
        schema = writer.register_schema(known.type, "ros2msg", known.definition.encode())
        told = {"offered_qos_profiles": qos_text(known.qos), "topic_type_hash": known.type_hash}
        channels[known.name] = writer.register_channel(known.name, "cdr", schema, told)
    for one in messages:
        times = one.receive_ns, one.data, one.publish_ns
        writer.add_message(channels[one.topic], *times, one.sequence)
    for name, record in (records or {}).items():
        writer.add_metadata(name, dict(record))
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def encoded(*records: McapRecord) -> bytes:
    """Records of an MCAP file, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content


def record_starts(content: bytes) -> list[int]:
    starts = []
    place = len(MCAP0_MAGIC)
    while place + 9 < len(content):
        starts.append(place)
        place += 9 + int.from_bytes(content[place + 1 : place + 9], "little")
    return starts


def all_within(folder: Path, names: str = "*") -> dict[Path, bytes | bool]:
    """Every path below a folder, with the bytes of what is a file."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob(names)}


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file, with the node it lies in."""
    return {path.name: (path.stat().st_ino, path.read_bytes()) for path in folder.iterdir()}


def by_mcap(file: BinaryIO) -> tuple[Summary, list[tuple[Schema | None, Channel, Message]]]:
    """Summary and messages of a recording, by the seeking reader of the mcap library."""
    reader = SeekingReader(file, validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    return summary, list(reader.iter_messages(log_time_order=False))


def raw_by_mcap(recording: Path) -> list[RawMessage]:
    with recording.open("rb") as file:
        return [
            RawMessage(c.topic, s.name if s else "", m.data, m.publish_time, m.log_time)
            for s, c, m in by_mcap(file)[1]
        ]


def by_rosbags(folder: Path) -> list[tuple[int, str, bytes]]:
    """Log time, topic and bytes by the reader that tells most about what is wrong, sorted."""
    with Reader(folder) as reader:
        assert reader.message_count == sum(c.msgcount for c in reader.connections)
        return sorted((time, c.topic, bytes(data)) for c, time, data in reader.messages())


def in_order(*messages: Sequence[RawMessage]) -> list[tuple[int, str, bytes]]:
    """As rosbags reads them."""
    return sorted((m.receive_ns, m.topic, m.data) for part in messages for m in part)


class Killed(BaseException):
    """The process ends here."""


@contextmanager
def killed_after(steps: int, how: BaseException | None = None) -> Iterator[None]:
    """Let a number of calls that change the disk happen, and none after them.

    Args:
        steps: so many.
        how: what is raised in place of the next; None = the process ends.

    Only those of this thread count: the writer that a test before gave up on may still be at work.
    """
    left, here = count(steps, -1), threading.get_ident()

    def guarded(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - it stands for any call
            if threading.get_ident() == here and next(left) <= 0:
                raise how or Killed
            return real(*arguments, **named)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in ("open", "write", "pwrite", "fsync", "fdatasync", "link", "rename", "unlink"):
            patch.setattr(os, name, guarded(getattr(os, name)))
        yield


@contextmanager
def limited(what: int, most: int) -> Iterator[None]:
    """Of a resource of this process there is no more; of RLIMIT_FSIZE: a disk that is full."""
    soft, hard = resource.getrlimit(what)
    resource.setrlimit(what, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(what, (soft, hard))


@contextmanager
def little_memory(most: int = 10_000_000) -> Iterator[None]:
    tracemalloc.start()
    yield
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < most


def add_evidence(folder: Path, messages: Sequence[RawMessage], number: int = 1) -> Path:
    """Put a bag of evidence into a run's folder, as the recorder names it; returns its file."""
    bag = folder / f"{folder.name}{EVIDENCE}{'' if number == 1 else f'_{number}'}"
    types = {m.topic: m.type for m in messages}
    with BagWriter(bag, [topic(*named) for named in types.items()], {}) as writer:
        writer.put_all(messages)
    return bag / f"{bag.name}_0.mcap"


def written(path: Path, batches: Sequence[Batch]) -> None:
    """Write a recording of a chunk a batch, as the recorder does."""
    file = BagFile(path, Batch())
    for batch in batches:
        file.add(batch)
        file.end_chunk()
    file.finish()
    file.close()


def _made(kind: str, **fields: Any) -> Msg:  # noqa: ANN401 - whatever a type holds
    return typestore().types[kind](**fields)


def _header(time_ns: int) -> Msg:
    seconds, rest = divmod(time_ns, 1_000_000_000)
    stamp = _made("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return _made("std_msgs/msg/Header", stamp=stamp, frame_id="madrob_door")


def _three(kind: str, x: float, y: float = 0.0) -> Msg:
    return _made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=0.0)


_NONE = np.array([])
_BUILD: dict[str, Callable[[str, int, int], Msg]] = {
    "sensor_msgs/msg/JointState": lambda kind, time_ns, number: _made(
        kind,
        header=_header(time_ns),
        name=["door"],
        position=np.array([number / 100]),
        velocity=_NONE,
        effort=_NONE,
    ),
    "geometry_msgs/msg/WrenchStamped": lambda kind, time_ns, number: _made(
        kind,
        header=_header(time_ns),
        wrench=_made(
            "geometry_msgs/msg/Wrench",
            force=_three("Vector3", float(number)),
            torque=_three("Vector3", 0.0),
        ),
    ),
    "sensor_msgs/msg/LaserScan": lambda kind, time_ns, number: _made(
        kind,
        header=_header(time_ns),
        **dict.fromkeys(("angle_min", "angle_max", "angle_increment", "time_increment"), 0.0),
        scan_time=0.02,
        range_min=0.25,
        range_max=2.0,
        ranges=np.array([1.0, 2.0, np.inf, number / 100], dtype=np.float32),
        intensities=_NONE.astype(np.float32),
    ),
    "geometry_msgs/msg/PoseStamped": lambda kind, time_ns, number: _made(
        kind,
        header=_header(time_ns),
        pose=_made(
            "geometry_msgs/msg/Pose",
            position=_three("Point", -1.5, float(number)),
            orientation=_made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    ),
    "std_msgs/msg/Bool": lambda kind, _, number: _made(kind, data=number % 2 == 0),
    "std_msgs/msg/String": lambda kind, _, number: _made(kind, data=f"event {number}"),
}
