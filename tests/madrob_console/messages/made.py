"""Messages as testbeds send them."""

from __future__ import annotations

import numpy as np

from madrob_console.messages.types import Message, MessageTypes
from recorder.bag import RawMessage

JOINTS, SCAN = "sensor_msgs/msg/JointState", "sensor_msgs/msg/LaserScan"
RANGE, WRENCH = "sensor_msgs/msg/Range", "geometry_msgs/msg/WrenchStamped"
BOOL, FLOAT, STRING = "std_msgs/msg/Bool", "std_msgs/msg/Float64", "std_msgs/msg/String"
ARRAY = "std_msgs/msg/Float64MultiArray"
CELLS, PASSAGE = "door_msgs/msg/Cells", "door_msgs/msg/Passage"

LINE = f"{'=' * 80}\nMSG: "
TYPES = MessageTypes()
TYPES.register(
    CELLS,
    "std_msgs/Header header\ndoor_msgs/Cell[] cells\n"
    f"{LINE}door_msgs/Cell\nfloat32 force\nfloat32[3] ranges\nfloat64 class\n",
)
TYPES.register(
    PASSAGE,
    "std_msgs/Header header\nsensor_msgs/Range[] ranges\nbool status_ok\n"
    f"{LINE}sensor_msgs/Range\n{TYPES.definition(RANGE)}",
)

SENT, RECEIVED = 1_700_000_000_123_456_789, 1_700_000_000_200_000_001
STAMP, LOG_TIME = SENT / 10**9, RECEIVED / 10**9


def floats(*values: float, kind: str = "f4") -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    return np.array(values, dtype=kind)


def content(type_name: str, **fields: object) -> Message:
    """A message that was sent at `SENT`, if it has a header."""
    made = TYPES.make(type_name, **fields)
    if "header" in TYPES.fields(type_name):
        made.header.stamp.sec, made.header.stamp.nanosec = divmod(SENT, 10**9)
    return made


def raw(topic: str, type_name: str, later: float = 0.0, **fields: object) -> RawMessage:
    """A message that was received `later` s after `RECEIVED`."""
    data = TYPES.encode(type_name, content(type_name, **fields))
    return RawMessage(topic, type_name, data, SENT, RECEIVED + round(later * 1e9))


def joints(topic: str, names: list[str], *positions: float) -> RawMessage:
    return raw(topic, JOINTS, name=names, position=floats(*positions, kind="f8"))


def wrench(topic: str, force: float) -> RawMessage:
    made = TYPES.make(WRENCH).wrench
    made.force.x = force
    return raw(topic, WRENCH, wrench=made)


def cell(force: float) -> Message:
    made = TYPES.make("door_msgs/msg/Cell", force=force, ranges=floats(1.0, 1.0, 1.0))
    made.class_ = 3.0
    return made
