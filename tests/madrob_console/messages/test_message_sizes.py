from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from madrob_console.messages.codec import DEFAULT_MAPPINGS, Decoder, MessageError, TopicMapping
from madrob_console.messages.message_sizes import (
    LONGEST_TEXT,
    MOST_NUMBERS,
    MOST_PARTS,
    UNKNOWN_SIZE,
    usual_size,
)
from madrob_console.messages.message_types import MessageTypes
from recorder.message import RawMessage
from scoring.protocol import Signal

TYPES = MessageTypes()
JOINTS = "sensor_msgs/msg/JointState"
SCAN = "sensor_msgs/msg/LaserScan"
DOOR = next(m for m in DEFAULT_MAPPINGS if m.signal is Signal.DOOR)


def joints(count: int, name: str = "") -> bytes:
    values = np.zeros(count)
    return TYPES.encode(JOINTS, TYPES.make(JOINTS, name=[name] * count, position=values))


def test_whatever_a_type_bounds_itself_is_never_too_large() -> None:
    for name in get_typestore(Stores.ROS2_JAZZY).fielddefs:
        assert len(TYPES.encode(name, TYPES.make(name))) <= usual_size(TYPES, name)


def test_what_testbeds_send_is_read_and_what_holds_up_an_engine_is_not() -> None:
    usual = usual_size(TYPES, JOINTS)
    assert len(joints(MOST_PARTS, "j" * (LONGEST_TEXT - 1))) <= usual
    assert len(joints(500_000)) > 30 * usual
    scan = TYPES.make(SCAN, ranges=np.zeros(MOST_NUMBERS, np.float32))
    assert len(TYPES.encode(SCAN, scan)) <= usual_size(TYPES, SCAN)
    assert usual_size(TYPES, "std_msgs/msg/Bool") < 20


def test_bounds_that_a_type_names_are_kept() -> None:
    types = MessageTypes()
    text = "float32[<=3] few\nstring<=10 short\nfloat64[2] two\n"
    types.register("door_msgs/msg/Bounded", text)
    largest = types.make(
        "door_msgs/msg/Bounded",
        few=np.zeros(3, np.float32),
        short="x" * 10,
        two=np.zeros(2),
    )
    encoded = len(types.encode("door_msgs/msg/Bounded", largest))
    assert encoded <= usual_size(types, "door_msgs/msg/Bounded") < encoded + 40
    assert usual_size(types, "door_msgs/msg/Unheard") == UNKNOWN_SIZE


def test_a_message_above_the_limit_of_its_topic_is_refused_with_its_size() -> None:
    mapping = DOOR.limited(TYPES)
    decoder = Decoder([mapping], TYPES)
    heavy = RawMessage(DOOR.topic, JOINTS, joints(500_000), 0, 0)
    with pytest.raises(MessageError, match=rf"^{DOOR.topic}: {len(heavy.data)} bytes, not read"):
        decoder.decode(heavy)
    assert decoder.decode(RawMessage(DOOR.topic, JOINTS, joints(2), 0, 0)) is not None
    assert Decoder([DOOR], TYPES).decode(heavy) is not None  # an old recording has no limit


def test_a_limit_that_is_set_is_kept() -> None:
    mapping = TopicMapping(Signal.DOOR, "/a", "std_msgs/msg/Float64", "data", largest=7)
    assert mapping.limited(TYPES) == mapping
