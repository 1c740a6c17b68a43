from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.errors import MadrobError
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    Decoder,
    MessageError,
    MessageTypes,
    TopicMapping,
    decode_text,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from recorder.bag import Durability
from recorder.message import RawMessage
from scoring.protocol import Signal, StartPose, Strip
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

TYPES = MessageTypes()
TYPES.register(
    "madrob_msgs/msg/Cells",
    "std_msgs/Header header\nmadrob_msgs/Cell[] cells\n"
    f"{'=' * 80}\nMSG: madrob_msgs/Cell\nfloat32 force\nfloat32[3] ranges\nfloat64 class\n",
)
STAMP = {"sec": 1_700_000_000, "nanosec": 123_456_789}
STAMP_NS = 1_700_000_000_123_456_789
RECEIVE_NS = 1_700_000_000_200_000_001
TIMES = (STAMP_NS / 10**9, RECEIVE_NS / 10**9)


def message(topic: str, type_name: str, **fields: object) -> RawMessage:
    made = TYPES.make(type_name, **fields)
    if "header" in TYPES.fields(type_name):
        made.header.stamp = TYPES.make("builtin_interfaces/msg/Time", **STAMP)
    return RawMessage(topic, type_name, TYPES.encode(type_name, made), STAMP_NS, RECEIVE_NS)


def scan(topic: str = "/madrob/passage/cw_left", **fields: object) -> RawMessage:
    return message(topic, "sensor_msgs/msg/LaserScan", **fields)


def ranges(*values: float) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    return np.array(values, dtype=np.float32)


def decode(raw: RawMessage, *mappings: TopicMapping) -> Sample | None:
    return Decoder(mappings or DEFAULT_MAPPINGS, TYPES).decode(raw)


def test_the_topics_of_the_protocol_are_decoded_without_settings() -> None:
    door = message(
        "/madrob/door/angle", "sensor_msgs/msg/JointState", position=np.array([0.5, 9.0])
    )
    assert decode(door) == DoorSample(*TIMES, 0.5)
    wrench = TYPES.make("geometry_msgs/msg/WrenchStamped").wrench
    wrench.force.x = -7.25
    handle = message("/madrob/handle/force", "geometry_msgs/msg/WrenchStamped", wrench=wrench)
    assert decode(handle) == HandleSample(*TIMES, -7.25)
    for strip in Strip:
        raw = scan(f"/madrob/passage/{strip}", range_max=4.0, ranges=ranges(0.5, 1.0, 1.5, 2.0))
        expected = PassageSample(*TIMES, strip, (0.5, 1.0, 1.5, 2.0), 0.0, 4.0)
        assert decode(raw) == expected
    latch = message("/madrob/door/locked", "std_msgs/msg/Bool", data=True)
    assert decode(latch) == LatchSample(TIMES[1], TIMES[1], engaged=True)


def test_a_topic_that_no_mapping_names_gives_nothing() -> None:
    assert decode(message("/rosout", "std_msgs/msg/Bool")) is None


def test_another_unit_is_a_matter_of_settings() -> None:
    gram_force = TopicMapping(
        Signal.HANDLE, "/f", "std_msgs/msg/Float64", "data", scale=0.00980665, offset=-1.0
    )
    sample = decode(message("/f", "std_msgs/msg/Float64", data=200.0), gram_force)
    assert sample == HandleSample(TIMES[1], TIMES[1], 200.0 * 0.00980665 - 1.0)


def test_fields_are_found_through_arrays_of_messages() -> None:
    raw = message("/c", "madrob_msgs/msg/Cells", cells=[_cell(1.0), _cell(2.5)])
    force = TopicMapping(Signal.HANDLE, "/c", "madrob_msgs/msg/Cells", "cells[1].force")
    assert decode(raw, force) == HandleSample(*TIMES, 2.5)
    strip = TopicMapping(Signal.CCW_LEFT, "/c", "madrob_msgs/msg/Cells", "cells[0].ranges")
    assert decode(raw, strip) == PassageSample(
        *TIMES, Strip.CCW_LEFT, (1.0, 1.0, 1.0), 0.0, math.inf
    )
    keyword = TopicMapping(Signal.DOOR, "/c", "madrob_msgs/msg/Cells", "cells[0].class")
    assert decode(raw, keyword) == DoorSample(*TIMES, 3.0)


def _cell(force: float) -> object:
    cell = TYPES.make("madrob_msgs/msg/Cell", force=force, ranges=ranges(1.0, 1.0, 1.0))
    cell.class_ = 3.0
    return cell


def test_an_empty_array_is_no_reading() -> None:
    door = decode(message("/madrob/door/angle", "sensor_msgs/msg/JointState"))
    assert isinstance(door, DoorSample)
    assert math.isnan(door.angle)
    strip = TopicMapping(Signal.CW_LEFT, "/c", "madrob_msgs/msg/Cells", "cells[2].ranges")
    sample = decode(message("/c", "madrob_msgs/msg/Cells"), strip)
    assert isinstance(sample, PassageSample)
    assert sample.ranges == ()


def test_a_latch_that_says_nothing_is_an_error() -> None:
    latch = TopicMapping(Signal.LATCH, "/j", "sensor_msgs/msg/JointState", "position[0]")
    with pytest.raises(MessageError, match="says nothing about the latch"):
        decode(message("/j", "sensor_msgs/msg/JointState"), latch)


def test_a_latch_sensor_may_speak_the_other_way_round() -> None:
    unlocked = TopicMapping(Signal.LATCH, "/u", "std_msgs/msg/Bool", "data", scale=-1.0, offset=1.0)
    for data in (True, False):
        sample = decode(message("/u", "std_msgs/msg/Bool", data=data), unlocked)
        assert isinstance(sample, LatchSample)
        assert sample.engaged is not data


def test_ranges_without_a_reading_stay_as_they_are() -> None:
    sample = decode(scan(ranges=ranges(math.inf, -math.inf, math.nan), range_max=2.0))
    assert isinstance(sample, PassageSample)
    assert sample.ranges[:2] == (math.inf, -math.inf)
    assert math.isnan(sample.ranges[2])
    assert len(sample.ranges) == 3


def test_only_the_four_sensors_of_a_strip_count() -> None:
    sample = decode(scan(ranges=ranges(*range(1, 100))))
    assert isinstance(sample, PassageSample)
    assert sample.ranges == (1.0, 2.0, 3.0, 4.0)


def test_scale_and_offset_apply_to_the_limits_too() -> None:
    heights = TopicMapping(
        Signal.CW_LEFT, "/h", "sensor_msgs/msg/LaserScan", "ranges", scale=-0.001, offset=2.0
    )
    raw = scan("/h", ranges=ranges(500, 1500), range_min=0.0, range_max=2000.0)
    sample = decode(raw, heights)
    assert isinstance(sample, PassageSample)
    assert sample.ranges == (1.5, 0.5)
    assert (sample.range_min, sample.range_max) == (0.0, 2.0)


def test_a_plain_array_has_no_limits() -> None:
    array = TopicMapping(Signal.CW_LEFT, "/a", "std_msgs/msg/Float64MultiArray", "data")
    raw = message("/a", "std_msgs/msg/Float64MultiArray", data=np.array([1.0, 2.0]))
    sample = decode(raw, array)
    assert sample == PassageSample(TIMES[1], TIMES[1], Strip.CW_LEFT, (1.0, 2.0), 0.0, math.inf)


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (("std_msgs/msg/Float32", "data"), "it sends std_msgs/msg/Float64, not std_msgs/msg/Flo"),
        (("std_msgs/msg/Float64", "angle"), "no field angle: std_msgs/msg/Float64 holds data"),
        (("std_msgs/msg/Float64", "data[0]"), "follows no array"),
        (("std_msgs/msg/Float64", "data.x"), "nothing is inside"),
    ],
)
def test_a_wrong_mapping_is_explained_in_one_line(mapping: tuple[str, str], words: str) -> None:
    raw = message("/d", "std_msgs/msg/Float64", data=1.0)
    with pytest.raises(MessageError) as refused:
        decode(raw, TopicMapping(Signal.DOOR, "/d", *mapping))
    assert words in str(refused.value)
    assert str(refused.value).startswith("/d: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("signal", "type_name", "field", "words"),
    [
        (Signal.DOOR, "std_msgs/msg/String", "data", "holds no numbers"),
        (Signal.DOOR, "std_msgs/msg/Header", "stamp", "holds no numbers"),
        (Signal.DOOR, "sensor_msgs/msg/LaserScan", "ranges", "is not one number"),
        (Signal.CW_LEFT, "sensor_msgs/msg/LaserScan", "range_min", "is not an array"),
        (Signal.CW_LEFT, "madrob_msgs/msg/Cell", "ranges[3]", "its array ends at 2"),
        (Signal.DOOR, "x_msgs/msg/Y", "z", "x_msgs/msg/Y is unknown"),
    ],
)
def test_a_field_must_fit_its_signal(
    signal: Signal, type_name: str, field: str, words: str
) -> None:
    data = TYPES.encode(type_name, TYPES.make(type_name)) if TYPES.knows(type_name) else b""
    raw = RawMessage("/t", type_name, data, 0, 0)
    with pytest.raises(MessageError, match=words):
        decode(raw, TopicMapping(signal, "/t", type_name, field))


def test_a_type_that_becomes_known_later_is_decoded_from_then_on() -> None:
    types = MessageTypes()
    decoder = Decoder([TopicMapping(Signal.DOOR, "/n", "n_msgs/msg/N", "x")], types)
    raw = RawMessage("/n", "n_msgs/msg/N", b"\0\1\0\0" + np.float64(0.5).tobytes(), 1, 2)
    with pytest.raises(MessageError, match="n_msgs/msg/N is unknown"):
        decoder.decode(raw)
    types.register("n_msgs/msg/N", "float64 x\n")
    assert decoder.decode(raw) == DoorSample(2e-9, 2e-9, 0.5)


@pytest.mark.parametrize("path", ["", ".", "a.", ".a", "a[", "a[-1]", "a[x]", "a b", "0", "a..b"])
def test_a_malformed_field_is_refused_with_an_example(path: str) -> None:
    with pytest.raises(MadrobError, match=r"position\[0\]"):
        TopicMapping(Signal.DOOR, "/d", "std_msgs/msg/Float64", path)


@pytest.mark.parametrize(("scale", "offset"), [(0.0, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_a_scale_that_loses_the_signal_is_refused(scale: float, offset: float) -> None:
    with pytest.raises(MadrobError, match="/d: "):
        TopicMapping(Signal.DOOR, "/d", "std_msgs/msg/Float64", "data", scale, offset)


def test_each_signal_has_one_topic_and_each_topic_one_signal() -> None:
    door = DEFAULT_MAPPINGS[0]
    again = TopicMapping(Signal.DOOR, "/other", door.type, door.field)
    with pytest.raises(MadrobError, match="door angle is mapped twice"):
        Decoder([door, again], TYPES)
    other = TopicMapping(Signal.HANDLE, door.topic, door.type, door.field)
    with pytest.raises(MadrobError, match="/madrob/door/angle is mapped twice"):
        Decoder([door, other], TYPES)


VALID = (
    scan(ranges=ranges(1, 2, 3, 4), intensities=ranges(5)),
    message("/madrob/door/angle", "sensor_msgs/msg/JointState", name=["a", "b"]),
    message("/madrob/handle/force", "geometry_msgs/msg/WrenchStamped"),
    message("/madrob/door/locked", "std_msgs/msg/Bool", data=True),
)


@given(st.sampled_from(VALID), st.binary(max_size=200))
@example(VALID[0], b"")
@example(VALID[0], b"\x00\x01\x00\x00")
def test_no_bytes_do_worse_than_a_message_error(valid: RawMessage, data: bytes) -> None:
    _decode_or_message_error(RawMessage(valid.topic, valid.type, data, 0, RECEIVE_NS))


@given(st.sampled_from(VALID), st.data())
def test_no_damage_to_a_message_does_worse_than_a_message_error(
    valid: RawMessage, data: st.DataObject
) -> None:
    damaged = bytearray(valid.data)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    _decode_or_message_error(
        RawMessage(valid.topic, valid.type, bytes(damaged[:cut]), 0, RECEIVE_NS)
    )


def _decode_or_message_error(raw: RawMessage) -> None:
    said = ""
    try:
        sample = decode(raw)
    except MessageError as error:
        said = str(error)
    else:
        assert sample is not None
        assert sample.log_time == TIMES[1]
    assert not said or said.startswith(f"{raw.topic}: ")
    assert "\n" not in said


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_words_come_back_as_they_were_said(text: str) -> None:
    assert decode_text(TYPES, encode_text(TYPES, text)) == text


def test_words_that_are_none_are_an_error() -> None:
    with pytest.raises(MessageError, match="not a std_msgs/msg/String"):
        decode_text(TYPES, b"\x00\x01\x00\x00\xff\xff\xff\xff")


def test_the_start_pose_faces_where_its_yaw_says() -> None:
    pose = encode_start_pose(TYPES, StartPose(1.5, -0.25, 90.0), STAMP_NS)
    back = TYPES.decode("geometry_msgs/msg/PoseStamped", pose)
    assert back.header.frame_id == "madrob_door"
    assert (back.header.stamp.sec, back.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    assert (back.pose.position.x, back.pose.position.y, back.pose.position.z) == (1.5, -0.25, 0.0)
    turn = back.pose.orientation
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert 2 * math.degrees(math.atan2(turn.z, turn.w)) == pytest.approx(90.0)


def test_the_last_word_of_the_referee_reaches_late_joiners() -> None:
    topics = {topic.name: topic for topic in referee_topics(TYPES)}
    assert list(topics) == [
        "/madrob/referee/state",
        "/madrob/referee/event",
        "/madrob/referee/start_pose",
    ]
    assert all(t.qos.durability is Durability.TRANSIENT_LOCAL for t in topics.values())
    assert "MSG: geometry_msgs/Quaternion" in topics["/madrob/referee/start_pose"].definition
