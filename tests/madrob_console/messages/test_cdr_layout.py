"""A decoder that knows a message's layout gives what one gives that reads everything anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from madrob_console.messages.cdr_layout import Layout, Wanted
from madrob_console.messages.codec import Decoder, MessageError, MessageTypes, TopicMapping
from recorder.message import RawMessage
from scoring.protocol import Signal

TYPES = MessageTypes()
CELL = f"{'=' * 80}\nMSG: madrob_msgs/Cell\n"
CELLS_TYPE = "madrob_msgs/msg/Cells"
DEFINITION = (
    "std_msgs/Header header\nint8 count\nmadrob_msgs/Cell[] cells\nstring note\nuint16[3] rest\n"
    f"{CELL}string name\nbool on\nfloat32 force\nfloat32[] ranges\nint64 number\n"
)
TYPES.register(CELLS_TYPE, DEFINITION)
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(DEFINITION, CELLS_TYPE))
MAPPINGS = (
    TopicMapping(Signal.DOOR, "/j", "sensor_msgs/msg/JointState", "position[1]"),
    TopicMapping(Signal.CW_LEFT, "/l", "sensor_msgs/msg/LaserScan", "ranges"),
    TopicMapping(Signal.HANDLE, "/c", "madrob_msgs/msg/Cells", "cells[1].force", scale=2.0),
    TopicMapping(Signal.CCW_LEFT, "/r", "madrob_msgs/msg/Cells", "cells[0].ranges"),
    TopicMapping(Signal.LATCH, "/n", "madrob_msgs/msg/Cells", "rest[2]"),
)
TEXTS = st.text(max_size=5)
NUMBERS = st.lists(st.floats(width=32), max_size=6)


def floats(kind: type[np.floating]) -> st.SearchStrategy[object]:
    return NUMBERS.map(lambda values: np.array(values, dtype=kind))


def filled(type_name: str, **fields: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    def make(fields: dict[str, object]) -> object:
        if "header" in TYPES.fields(type_name):
            header = TYPES.make("std_msgs/msg/Header", frame_id=fields.pop("frame"))
            header.stamp.sec, header.stamp.nanosec = 5, fields.pop("nanosec")
            fields["header"] = header
        return TYPES.make(type_name, **fields)

    return st.fixed_dictionaries(fields).map(make)


STAMPED = {"frame": TEXTS, "nanosec": st.integers(0, 10**9 - 1)}
CELLS = filled(
    "madrob_msgs/msg/Cell",
    name=TEXTS,
    on=st.booleans(),
    force=st.floats(width=32),
    ranges=floats(np.float32),
    number=st.integers(-(2**63), 2**63 - 1),
)
MESSAGES: dict[str, st.SearchStrategy[object]] = {
    "sensor_msgs/msg/JointState": filled(
        "sensor_msgs/msg/JointState",
        **STAMPED,
        name=st.lists(TEXTS, max_size=3),
        position=floats(np.float64),
        velocity=floats(np.float64),
    ),
    "sensor_msgs/msg/LaserScan": filled(
        "sensor_msgs/msg/LaserScan",
        **STAMPED,
        range_min=st.floats(width=32),
        range_max=st.floats(width=32),
        ranges=floats(np.float32),
        intensities=floats(np.float32),
    ),
    "madrob_msgs/msg/Cells": filled(
        "madrob_msgs/msg/Cells",
        **STAMPED,
        count=st.integers(-128, 127),
        cells=st.lists(CELLS, max_size=3),
        note=TEXTS,
        rest=st.lists(st.integers(0, 65535), min_size=3, max_size=3).map(
            lambda values: np.array(values, dtype=np.uint16)
        ),
    ),
}


def told(decoder: Decoder, message: RawMessage) -> str:
    try:
        return repr(decoder.decode(message))
    except MessageError as error:
        return f"{error}"


def raw(mapping: TopicMapping, data: bytes) -> RawMessage:
    return RawMessage(mapping.topic, mapping.type, data, 1, 2)


@given(
    mapping=st.sampled_from(MAPPINGS),
    little=st.booleans(),
    data=st.data(),
    changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=3),
    cut=st.integers(0, 3),
)
def test_a_known_layout_changes_nothing(
    mapping: TopicMapping,
    little: bool,
    data: st.DataObject,
    changes: list[tuple[float, int]],
    cut: int,
) -> None:
    first, second = (data.draw(MESSAGES[mapping.type]) for _ in range(2))

    def encode(message: object) -> bytes:
        return bytes(STORE.serialize_cdr(message, mapping.type, little_endian=little))

    changed = bytearray(encode(first))
    for where, byte in changes:
        changed[int(where * (len(changed) - 1))] = byte
    decoder = Decoder(MAPPINGS, TYPES)
    told(decoder, raw(mapping, encode(first)))
    for content in (encode(first), encode(second), bytes(changed)[: len(changed) - cut]):
        message = raw(mapping, content)
        assert told(decoder, message) == told(Decoder(MAPPINGS, TYPES), message)


def test_numbers_are_read_without_the_rest_and_only_from_the_same_layout() -> None:
    name = "sensor_msgs/msg/JointState"
    message = TYPES.make(name, name=["door"], position=np.array([0.5, 0.25]))
    wanted = (Wanted(("position", 1)), Wanted(("position", 2)), Wanted(("velocity",), 3))
    layout = Layout(TYPES, name, TYPES.encode(name, message), wanted)
    message.position[1] = -1.5
    assert layout.read(TYPES.encode(name, message)) == ((-1.5,), (), ())
    message.name = ["lock"]
    assert layout.read(TYPES.encode(name, message)) is None
    message.name, message.position = ["door"], np.array([0.5])
    assert layout.read(TYPES.encode(name, message)) is None


def test_what_has_very_many_parts_is_left_to_the_library() -> None:
    cells = [TYPES.make("madrob_msgs/msg/Cell") for _ in range(200)]
    name = "madrob_msgs/msg/Cells"
    data = TYPES.encode(name, TYPES.make(name, cells=cells))
    with pytest.raises(ValueError, match="many parts"):
        Layout(TYPES, name, data, [Wanted(("cells", 1, "force"))])
