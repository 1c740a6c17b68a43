from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import (
    Decoder,
    decode_text,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, LARGEST_READ, TopicMapping
from madrob_console.messages.types import MessageError, MessageTypes
from recorder.bag import Durability, RawMessage
from scoring.protocol import Signal, StartPose, Strip
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from tests.madrob_console.messages.made import (
    ARRAY,
    BOOL,
    CELLS,
    FLOAT,
    JOINTS,
    LOG_TIME,
    PASSAGE,
    RANGE,
    SCAN,
    SENT,
    STAMP,
    STRING,
    TYPES,
    cell,
    content,
    floats,
    joints,
    raw,
    wrench,
)

TIMES, NOW = (STAMP, LOG_TIME), (LOG_TIME, LOG_TIME)
"""Without a stamp a sample is as old as its reception."""

DOOR = DEFAULT_MAPPINGS[0]
NAMED = replace(DOOR, field="position[name=door]")
UNLOCKED = TopicMapping(Signal.LATCH, "/t", BOOL, "data", scale=-1.0, offset=1.0)
GRAMS = TopicMapping(Signal.HANDLE, "/t", FLOAT, "data", scale=0.00980665, offset=-1.0)
HEIGHTS = TopicMapping(Signal.CW_LEFT, "/t", SCAN, "ranges", scale=-0.001, offset=2.0)
MILLIMETRES = TopicMapping(Signal.CW_LEFT, "/t", PASSAGE, "ranges.range", scale=0.001)
FOUR = [TopicMapping(Signal.CW_LEFT, f"/r{n}", RANGE, "range", scale=0.001) for n in range(4)]


def strip(*ranges: float, low: float = 0.0, high: float = math.inf) -> PassageSample:
    return PassageSample(*TIMES, Strip.CW_LEFT, ranges, low, high)


def of_cells(signal: Signal, field: str) -> TopicMapping:
    return TopicMapping(signal, "/t", CELLS, field)


def silent(no_echo: str) -> TopicMapping:
    return TopicMapping(Signal.CW_LEFT, "/t", SCAN, "ranges", no_echo=no_echo)


def scan(*ranges: float, high: float = 4.0) -> RawMessage:
    return raw("/t", SCAN, range_max=high, ranges=floats(*ranges))


def decode(message: RawMessage, *mappings: TopicMapping) -> Sample | None:
    return Decoder(mappings or DEFAULT_MAPPINGS, TYPES).decode(message)


@pytest.mark.parametrize(
    ("message", "sample"),
    [
        (joints(DOOR.topic, [], 0.5, 9.0), DoorSample(*TIMES, 0.5)),
        (joints(DOOR.topic, []), DoorSample(*TIMES, math.nan)),
        (wrench("/madrob/handle/force", -7.25), HandleSample(*TIMES, -7.25)),
        (
            raw("/madrob/passage/ccw_right", SCAN, range_max=4.0, ranges=floats(0.5, 1, 1.5, 2, 9)),
            PassageSample(*TIMES, Strip.CCW_RIGHT, (0.5, 1.0, 1.5, 2.0), 0.0, 4.0),
        ),
        (raw("/madrob/door/locked", BOOL, data=True), LatchSample(*NOW, engaged=True)),
        (raw("/rosout", BOOL), None),
    ],
)
def test_message_is_decoded_as_the_protocol_says(
    message: RawMessage, sample: Sample | None
) -> None:
    assert repr(decode(message)) == repr(sample)  # NaN is itself there


TWO_CELLS = raw("/t", CELLS, cells=[cell(1.0), cell(2.5)])
ECHOES = [content(RANGE, range=mm, max_range=2500.0) for mm in (400, 1500, 2000, 2000)]


@pytest.mark.parametrize(
    ("message", "mapping", "sample"),
    [
        (raw("/t", BOOL, data=True), UNLOCKED, LatchSample(*NOW, engaged=False)),
        (raw("/t", FLOAT, data=200.0), GRAMS, HandleSample(*NOW, 200.0 * 0.00980665 - 1.0)),
        (TWO_CELLS, of_cells(Signal.HANDLE, "cells[1].force"), HandleSample(*TIMES, 2.5)),
        (TWO_CELLS, of_cells(Signal.DOOR, "cells[0].class"), DoorSample(*TIMES, 3.0)),
        (TWO_CELLS, of_cells(Signal.CW_LEFT, "cells[0].ranges"), strip(1.0, 1.0, 1.0)),
        (TWO_CELLS, of_cells(Signal.CW_LEFT, "cells[2].ranges"), strip()),
        (TWO_CELLS, of_cells(Signal.CW_LEFT, "cells.force"), strip(1.0, 2.5)),
        (raw("/t", PASSAGE, ranges=ECHOES), MILLIMETRES, strip(0.4, 1.5, 2.0, 2.0, high=2.5)),
        (raw("/t", PASSAGE), MILLIMETRES, strip()),
        (scan(0.5, 0.0), silent("0"), strip(0.5, math.inf, high=4.0)),
        (scan(0.5, math.nan), silent("nan"), strip(0.5, math.inf, high=4.0)),
        (scan(0.5, 65.535), silent("65.535"), strip(0.5, math.inf, high=4.0)),
        (scan(math.inf, -math.inf), silent("inf"), strip(math.inf, -math.inf, high=4.0)),
        (scan(500, 1500, high=2000.0), HEIGHTS, strip(1.5, 0.5, high=2.0)),
        (
            raw("/t", ARRAY, data=floats(1.0, 2.0, kind="f8")),
            TopicMapping(Signal.CW_LEFT, "/t", ARRAY, "data", scale=-1.0),
            PassageSample(*NOW, Strip.CW_LEFT, (-1.0, -2.0), 0.0, math.inf),
        ),
        (joints(DOOR.topic, ["lock", "door"], 9.0, 0.5), NAMED, DoorSample(*TIMES, 0.5)),
        (joints(DOOR.topic, ["door"]), NAMED, DoorSample(*TIMES, math.nan)),
    ],
)
def test_message_is_decoded_as_its_mapping_says(
    message: RawMessage, mapping: TopicMapping, sample: Sample
) -> None:
    assert repr(decode(message, mapping)) == repr(sample)


@pytest.mark.parametrize("names", [["lock", "gate"], []])
def test_message_without_the_named_joint_is_no_sample(names: list[str]) -> None:
    decoder = Decoder([NAMED], TYPES)

    assert decoder.decode(joints(DOOR.topic, names, 9.0, 0.5)) is None
    assert decoder.absent == "door"


def test_index_among_several_names_is_doubted_always_remarked_once() -> None:
    decoder = Decoder([DOOR], TYPES)
    words = f"{DOOR.topic}: position[0] is 'lock', one of 2 names: use position[name=...]"

    for remark in ((words, Signal.DOOR), None):
        assert decoder.decode(joints(DOOR.topic, ["lock", "door"], 0.5)) is not None
        assert (decoder.doubt, decoder.remark) == (words, remark)


def test_other_name_at_an_index_is_remarked() -> None:
    decoder = Decoder([DOOR], TYPES)
    decoder.decode(joints(DOOR.topic, ["door"], 0.5))
    assert decoder.remark is None

    decoder.decode(joints(DOOR.topic, ["lo\x1b[31mck"], 0.5))

    words = f"{DOOR.topic}: position[0] was 'door', then 'lock': use position[name=...]"
    assert decoder.remark == (words, Signal.DOOR)


def one_range(place: int, mm: float, later: float = 0.0, largest: float = 2500.0) -> RawMessage:
    """A message of one of the four topics, so long after the first ones, s."""
    return raw(f"/r{place}", RANGE, later, range=mm, max_range=largest)


@pytest.fixture
def joined() -> Decoder:
    """A decoder that knows the ranges of all four topics."""
    decoder = Decoder(FOUR, TYPES)
    for place, mm in ((2, 1500), (0, 500), (1, 1000), (3, 2000)):
        decoder.decode(one_range(place, mm))
    return decoder


def test_four_topics_are_a_strip_with_the_last() -> None:
    decoder = Decoder(FOUR, TYPES)

    earlier = [decoder.decode(one_range(place, 1000)) for place in (2, 0, 1)]

    assert earlier == [None, None, None]
    assert decoder.decode(one_range(3, 2000)) == strip(1.0, 1.0, 1.0, 2.0, high=2.5)


@pytest.mark.parametrize(
    ("message", "ranges", "problem"),
    [
        (one_range(1, math.inf, 0.4), (0.5, math.inf, 1.5, 2.0), None),
        (one_range(1, math.nan, 0.4), (0.5, math.nan, 1.5, 2.0), "range 1 is NaN"),
        (
            one_range(1, 700, 0.4, largest=0.0),
            (0.5, math.nan, 1.5, 2.0),
            "range 1: 0.70 m is outside of the message's limits 0..0",
        ),
        (one_range(1, 900, -0.2), (0.5, math.nan, 1.5, 2.0), "range 1 is older than 0.5 s"),
    ],
)
def test_range_outside_its_own_limits_is_none(
    joined: Decoder, message: RawMessage, ranges: Sequence[float], problem: str | None
) -> None:
    joined.decode(message)

    sample = joined.decode(one_range(3, 2000, 0.4))

    assert isinstance(sample, PassageSample)
    assert repr(sample.ranges) == repr(ranges)
    assert joined.doubt == problem


@pytest.mark.parametrize(
    ("mappings", "words"),
    [
        (FOUR[:3], "passage cw left is mapped twice: keep one topic"),
        ([*FOUR, replace(FOUR[0], topic="/r4")], "passage cw left is mapped twice"),
        ([DOOR, replace(DOOR, topic="/d")], "door angle is mapped twice: keep one topic"),
        ([DOOR, replace(DOOR, signal=Signal.HANDLE)], f"{DOOR.topic} is mapped twice: give each"),
    ],
)
def test_signal_and_topic_are_mapped_once(mappings: list[TopicMapping], words: str) -> None:
    with pytest.raises(MadrobError, match=words):
        Decoder(mappings, TYPES)


@pytest.mark.parametrize(
    ("signal", "type_name", "field", "words"),
    [
        (Signal.DOOR, FLOAT, "angle", "no field angle: std_msgs/msg/Float64 holds data"),
        (Signal.DOOR, FLOAT, "data[0]", "follows no array"),
        (Signal.DOOR, FLOAT, "data[name=door]", "follows no array"),
        (Signal.DOOR, FLOAT, "data.x", "nothing is inside"),
        (Signal.DOOR, STRING, "data", "holds no numbers"),
        (Signal.DOOR, JOINTS, "name[name=door]", "holds no numbers"),
        (Signal.DOOR, SCAN, "ranges", "is not one number"),
        (Signal.DOOR, SCAN, "ranges[name=door]", "name holds no names"),
        (Signal.DOOR, CELLS, "cells.force", "is not one number"),
        (Signal.CW_LEFT, CELLS, "cells.ranges", "holds no numbers"),
        (Signal.CW_LEFT, SCAN, "range_min", "is not an array"),
        (Signal.CW_LEFT, "door_msgs/msg/Cell", "ranges[3]", "its array ends at 2"),
        (Signal.DOOR, "n_msgs/msg/N", "x", f"it sends {FLOAT}, not n_msgs/msg/N"),
        (Signal.LATCH, JOINTS, "position[0]", "says nothing about the latch"),
    ],
)
def test_field_that_does_not_fit_is_explained(
    signal: Signal, type_name: str, field: str, words: str
) -> None:
    sent = type_name if TYPES.knows(type_name) else FLOAT
    with pytest.raises(MessageError, match=f"^/t: .*{words}.*$"):
        decode(raw("/t", sent), TopicMapping(signal, "/t", type_name, field))


def test_type_that_becomes_known_is_decoded() -> None:
    types = MessageTypes()
    decoder = Decoder([TopicMapping(Signal.DOOR, "/t", "n_msgs/msg/N", "x")], types)
    message = structs.replace(raw("/t", FLOAT, data=0.5), type="n_msgs/msg/N")
    with pytest.raises(MessageError, match="n_msgs/msg/N is unknown"):
        decoder.decode(message)

    types.register("n_msgs/msg/N", "float64 x\n")

    assert decoder.decode(message) == DoorSample(*NOW, 0.5)


def test_message_above_the_limit_is_not_read() -> None:
    largest = scan(*range(4096)).data + scan(*range(4096)).data[-4 * 4096 :]
    assert len(largest) <= LARGEST_READ  # with intensities
    heavy = RawMessage(DOOR.topic, JOINTS, bytes(LARGEST_READ + 1), SENT, SENT)

    with pytest.raises(MessageError, match=rf"^{DOOR.topic}: 65537 bytes, not read above 65536"):
        decode(heavy, DOOR.limited())
    assert replace(DOOR, largest=7).limited().largest == 7


VALID = [
    (DOOR, joints(DOOR.topic, ["lock", "door"], 0.5, 1.0).data),
    (NAMED, joints(NAMED.topic, ["lock", "door"], 0.5, 1.0).data),
    (of_cells(Signal.HANDLE, "cells[1].force"), TWO_CELLS.data),
    (MILLIMETRES, raw("/t", PASSAGE, ranges=ECHOES).data),
    (silent("inf"), scan(0.5, 1.0, 1.5, 2.0).data),
    (DEFAULT_MAPPINGS[1], wrench("/madrob/handle/force", 1.0).data),
]


@given(
    valid=st.sampled_from(VALID),
    place=st.floats(0, 1),
    byte=st.integers(0, 255),
    end=st.floats(0, 1),
)
def test_hostile_bytes_end_in_one_line(
    valid: tuple[TopicMapping, bytes], place: float, byte: int, end: float
) -> None:
    mapping, data = valid
    spoilt = bytearray(data)
    spoilt[round(place * (len(data) - 1))] = byte
    cut = bytes(spoilt[: round(end * len(data))])

    for each in (bytes(spoilt), cut):
        try:
            decode(RawMessage(mapping.topic, mapping.type, each, 1, 2), mapping)
        except MessageError as error:
            words = str(error)
        else:
            words = f"{mapping.topic}: not a refusal"
        assert words.startswith(f"{mapping.topic}: not a ")
        assert "\n" not in words


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_words_come_back_as_said(text: str) -> None:
    assert decode_text(TYPES, encode_text(TYPES, text)) == text


def test_start_pose_faces_where_its_yaw_says() -> None:
    data = encode_start_pose(TYPES, StartPose(1.5, -0.25, 90.0), SENT)

    pose = TYPES.decode("geometry_msgs/msg/PoseStamped", data)
    assert pose.header.frame_id == "madrob_door"
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec) == divmod(SENT, 10**9)
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == (1.5, -0.25, 0.0)
    turn = pose.pose.orientation
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert 2 * math.degrees(math.atan2(turn.z, turn.w)) == pytest.approx(90.0)


def test_last_word_of_the_referee_reaches_late_joiners() -> None:
    topics = {topic.name: topic for topic in referee_topics(TYPES)}

    assert [name.rpartition("/")[2] for name in topics] == [
        *("state", "event", "start_pose", "running", "elapsed", "level")
    ]
    assert {topic.qos.durability for topic in topics.values()} == {Durability.TRANSIENT_LOCAL}
    assert "MSG: geometry_msgs/Quaternion" in topics["/madrob/referee/start_pose"].definition
