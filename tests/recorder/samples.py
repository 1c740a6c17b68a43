"""Topics and messages of a testbed, serialised by rosbags."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Schema
from mcap.writer import MCAP0_MAGIC, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from recorder.bag import (
    Durability,
    Qos,
    RawMessage,
    Reliability,
    Topic,
    evidence_file_name,
    qos_text,
)
from recorder.writer import BagWriter

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg

START_NS = 1_700_000_000_000_000_000
STEP_NS = 20_000_000

BEST_EFFORT = Qos(Reliability.BEST_EFFORT)
LATCHED = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL)


@cache
def typestore() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def topic(name: str, type_name: str, qos: Qos | None = None) -> Topic:
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return Topic(name, type_name, text, typestore().hash_rihs01(type_name), qos or Qos())


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
    return bytes(typestore().serialize_cdr(_BUILD[type_name](time_ns, number), type_name))


def strings(texts: list[str], name: str = "/talk") -> list[RawMessage]:
    """`std_msgs/msg/String` messages, a millisecond apart."""
    kind = "std_msgs/msg/String"
    string = typestore().types[kind]
    return [
        RawMessage(
            name,
            kind,
            bytes(typestore().serialize_cdr(string(data=text), kind)),
            START_NS + number * 1_000_000,
            START_NS + number * 1_000_000 + 35_000,
        )
        for number, text in enumerate(texts)
    ]


def talk() -> Topic:
    return topic("/talk", "std_msgs/msg/String")


def by_library(
    messages: Sequence[RawMessage],
    topics: Sequence[Topic] | None = None,
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
    writer.add_metadata("madrob_run", {"setup": "{}"})
    for one in messages:
        times = one.receive_ns, one.data, one.publish_ns
        writer.add_message(channels[one.topic], *times, one.sequence)
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


def mixed(messages: list[RawMessage]) -> bytes:
    """A file whose first half lies in a chunk and the rest behind it, without a summary."""
    kind = talk()
    records = [
        Message(1, one.receive_ns, one.data, one.publish_ns, number)
        for number, one in enumerate(messages)
    ]
    half = len(records) // 2
    content = encoded(*records[:half])
    return b"".join(
        (
            MCAP0_MAGIC,
            encoded(
                Header("ros2", "another tool"),
                Schema(1, kind.definition.encode(), "ros2msg", kind.type),
                Channel(1, kind.name, "cdr", {}, 1),
                Chunk("", content, zlib.crc32(content), 0, 0, len(content)),
                *records[half:],
                DataEnd(0),
                Footer(0, 0, 0),
            ),
            MCAP0_MAGIC,
        )
    )


def all_within(folder: Path, names: str = "*") -> dict[Path, bytes | bool]:
    """Every path below a folder, with the bytes of what is a file."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob(names)}


def add_evidence(folder: Path, messages: Sequence[RawMessage], number: int = 0) -> Path:
    """Put a file of evidence into a bag folder, as the recorder names it; types as ROS has them."""
    types = {message.topic: message.type for message in messages}
    with TemporaryDirectory(dir=folder.parent) as aside:
        bag = Path(aside) / "bag"
        with BagWriter(bag, [topic(*named) for named in types.items()], {}) as writer:
            for message in messages:
                writer.put_message(message)
        (recording,) = bag.glob("*.mcap")
        return recording.rename(folder / evidence_file_name(folder.name, number))


def _header(time_ns: int) -> Msg:
    types = typestore().types
    seconds, rest = divmod(time_ns, 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="madrob_door")


def _joint_state(time_ns: int, number: int) -> Msg:
    return typestore().types["sensor_msgs/msg/JointState"](
        header=_header(time_ns),
        name=["door"],
        position=np.array([number / 100]),
        velocity=np.array([]),
        effort=np.array([]),
    )


def _wrench(time_ns: int, number: int) -> Msg:
    types = typestore().types
    vector = types["geometry_msgs/msg/Vector3"]
    return types["geometry_msgs/msg/WrenchStamped"](
        header=_header(time_ns),
        wrench=types["geometry_msgs/msg/Wrench"](
            force=vector(x=float(number), y=0.0, z=0.0), torque=vector(x=0.0, y=0.0, z=0.0)
        ),
    )


def _scan(time_ns: int, number: int) -> Msg:
    return typestore().types["sensor_msgs/msg/LaserScan"](
        header=_header(time_ns),
        angle_min=0.0,
        angle_max=0.0,
        angle_increment=0.0,
        time_increment=0.0,
        scan_time=0.02,
        range_min=0.25,
        range_max=2.0,
        ranges=np.array([1.0, 2.0, np.inf, number / 100], dtype=np.float32),
        intensities=np.array([], dtype=np.float32),
    )


def _pose(time_ns: int, number: int) -> Msg:
    types = typestore().types
    return types["geometry_msgs/msg/PoseStamped"](
        header=_header(time_ns),
        pose=types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=-1.5, y=float(number), z=0.0),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )


_BUILD: dict[str, Callable[[int, int], Msg]] = {
    "sensor_msgs/msg/JointState": _joint_state,
    "geometry_msgs/msg/WrenchStamped": _wrench,
    "sensor_msgs/msg/LaserScan": _scan,
    "geometry_msgs/msg/PoseStamped": _pose,
    "std_msgs/msg/Bool": lambda _, number: typestore().types["std_msgs/msg/Bool"](
        data=number % 2 == 0
    ),
    "std_msgs/msg/String": lambda _, number: typestore().types["std_msgs/msg/String"](
        data=f"event {number}"
    ),
}
