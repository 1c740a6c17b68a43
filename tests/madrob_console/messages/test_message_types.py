from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    Decoder,
    TopicMapping,
    decode_text,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.messages.message_types import (
    MessageError,
    MessageTypes,
    standard_types,
    types_of,
)
from madrob_console.messages.topic_mapping import LARGEST_READ
from recorder.bag import Durability, RawMessage, Topic
from scoring.protocol import Signal, StartPose, Strip
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

BOOL, STRING = "std_msgs/msg/Bool", "std_msgs/msg/String"
JOINTS, SCAN = "sensor_msgs/msg/JointState", "sensor_msgs/msg/LaserScan"
ANGLE = "door_msgs/msg/Angle"
HANDLE = "std_msgs/Header header\nfloat64 force\nfloat32[4] spare\nmadrob_msgs/Cell[] cells\n"
CELL = f"{'=' * 80}\nMSG: madrob_msgs/Cell\nint16 raw\n"
HEADER = (
    f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@pytest.fixture
def types() -> MessageTypes:
    return MessageTypes()


def test_every_standard_type_can_be_made_encoded_and_decoded(types: MessageTypes) -> None:
    for name in get_typestore(Stores.ROS2_JAZZY).fielddefs:
        data = types.encode(name, types.make(name))
        assert types.encode(name, types.decode(name, data)) == data


@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_a_registered_type_is_known_like_a_standard_one(types: MessageTypes, end: str) -> None:
    text = (HANDLE + CELL + HEADER).rstrip("\n").replace("\n", end or "\n") + end
    types.register("madrob_msgs/msg/Handle", text)
    assert types.knows("madrob_msgs/msg/Handle")
    message = types.make("madrob_msgs/msg/Handle", force=-2.5)
    message.cells = [types.make("madrob_msgs/msg/Cell", raw=7)]
    back = types.decode("madrob_msgs/msg/Handle", types.encode("madrob_msgs/msg/Handle", message))
    assert (back.force, back.cells[0].raw, back.spare.tolist()) == (-2.5, 7, [0.0] * 4)


def test_a_definition_is_kept_word_by_word_and_what_it_leaves_out_is_added(
    types: MessageTypes,
) -> None:
    text = "# gram-force\n" + HANDLE + CELL + HEADER
    name = "madrob_msgs/msg/Handle"
    types.register(name, text)
    assert types.definition(name) == text
    short, again = MessageTypes(), MessageTypes()
    short.register(name, HANDLE + CELL)
    definition = short.definition(name)
    for part in ("std_msgs/Header", "builtin_interfaces/Time", "madrob_msgs/Cell"):
        assert f"MSG: {part}" in definition
    again.register(name, definition)
    assert again.type_hash(name) == short.type_hash(name) == types.type_hash(name)


@pytest.mark.parametrize(
    ("name", "definition", "words"),
    [
        ("a_msgs/msg/T", "float64 x\nnonsense", "cannot be read"),
        ("a_msgs/msg/T", "Missing m\n", "definition of a_msgs/msg/Missing is missing"),
        ("a_msgs/msg/T", "T inner\n", "contains itself"),
        ("a_msgs/msg/T", f"U u\n{'=' * 80}\nMSG: a_msgs/U\nT t\n", "contains itself"),
        ("a_msgs/srv/T", "float64 x\n", "no type name"),
        ("sensor_msgs/msg/JointState", "float64 position\n", "known with other fields"),
    ],
)
def test_a_definition_of_no_use_is_refused_in_one_line(
    types: MessageTypes, name: str, definition: str, words: str
) -> None:
    with pytest.raises(MadrobError, match=words) as refused:
        types.register(name, definition)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


def test_hashes_are_those_of_ros_and_none_is_better_than_a_wrong_one(types: MessageTypes) -> None:
    assert types.type_hash(JOINTS) == (
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert types.type_hash("std_msgs/msg/Char") == ""
    assert types.type_hash("service_msgs/msg/ServiceEventInfo") == ""


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda types: types.definition("x_msgs/msg/Y"), "x_msgs/msg/Y is unknown"),
        (lambda types: types.type_hash("x_msgs/msg/Y"), "x_msgs/msg/Y is unknown"),
        (lambda types: types.make("x_msgs/msg/Y"), "x_msgs/msg/Y is unknown"),
        (lambda types: types.fields("x_msgs/msg/Y"), "x_msgs/msg/Y is unknown"),
        (lambda types: types.encode("x_msgs/msg/Y", object()), "x_msgs/msg/Y is unknown"),
        (lambda types: types.decode("x_msgs/msg/Y", b""), "x_msgs/msg/Y is unknown"),
        (lambda types: types.make(BOOL, angle=1.0), f"{BOOL} has no field angle"),
        (lambda types: _again(types, 5), f"{STRING}: cannot be encoded"),
        (lambda types: _again(types, "\ud800"), "cannot be encoded"),
    ],
)
def test_what_a_type_cannot_do_is_named(
    ask: Callable[[MessageTypes], object], words: str, types: MessageTypes
) -> None:
    with pytest.raises(MessageError, match=words):
        ask(types)


def _again(types: MessageTypes, data: object) -> bytes:
    return types.encode(STRING, types.make(STRING, data=data))


def test_bags_share_the_standard_types_and_may_define_one_type_differently() -> None:
    text = Topic("/text", STRING, "string data\n")
    other = Topic("/other", BOOL, "bool data\n")
    assert types_of([text]) is types_of([other, text]) is standard_types()
    first = types_of([Topic("/angle", ANGLE, "float64 angle\n")])
    second = types_of([Topic("/angle", ANGLE, "float32 angle\nbool ok\n")])
    assert [list(first.fields(ANGLE)), list(second.fields(ANGLE))] == [["angle"], ["angle", "ok"]]
    assert not standard_types().knows(ANGLE)
    with pytest.raises(MadrobError, match=f"{ANGLE}: the definition of door_msgs/msg/Part is miss"):
        types_of([Topic("/angle", ANGLE, "door_msgs/Part part\n")])


TYPES = MessageTypes()
DOOR = DEFAULT_MAPPINGS[0]


def joints(count: int, name: str = "") -> bytes:
    values = np.zeros(count)
    return TYPES.encode(JOINTS, TYPES.make(JOINTS, name=[name] * count, position=values))


def test_what_testbeds_send_is_read_and_what_holds_up_an_engine_is_not() -> None:
    many = np.zeros(4096, np.float32)
    assert len(TYPES.encode(SCAN, TYPES.make(SCAN, ranges=many, intensities=many))) <= LARGEST_READ
    assert len(joints(200, "a_joint_with_a_name_of_some_length")) <= LARGEST_READ
    decoder = Decoder([DOOR.limited()], TYPES)
    heavy = RawMessage(DOOR.topic, JOINTS, bytes(50 * LARGEST_READ), 0, 0)
    with pytest.raises(MessageError, match=rf"^{DOOR.topic}: {len(heavy.data)} bytes, not read"):
        decoder.decode(heavy)
    light = RawMessage(DOOR.topic, JOINTS, joints(2), 0, 0)
    assert decoder.decode(light) is not None
    assert Decoder([DOOR], TYPES).decode(raw(DOOR, joints(50_000))) is not None
    own = replace(DOOR, largest=7)
    assert own.limited() == own


ONE_CELL = f"{'=' * 80}\nMSG: madrob_msgs/Cell\n"
CELLS_TYPE = "madrob_msgs/msg/Cells"
DEFINITION = (
    "std_msgs/Header header\nint8 count\nmadrob_msgs/Cell[] cells\nstring note\nuint16[3] rest\n"
    f"{ONE_CELL}string name\nbool on\nfloat32 force\nfloat32[] ranges\nint64 number\n"
)
TYPES.register(CELLS_TYPE, DEFINITION)
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(DEFINITION, CELLS_TYPE))
MAPPINGS = (
    *DEFAULT_MAPPINGS,
    TopicMapping(Signal.DOOR, "/j", "sensor_msgs/msg/JointState", "position[1]"),
    TopicMapping(Signal.CW_LEFT, "/l", "sensor_msgs/msg/LaserScan", "ranges"),
    TopicMapping(Signal.HANDLE, "/c", "madrob_msgs/msg/Cells", "cells[1].force", scale=2.0),
    TopicMapping(Signal.CCW_LEFT, "/r", "madrob_msgs/msg/Cells", "cells[0].ranges"),
    TopicMapping(Signal.LATCH, "/n", "madrob_msgs/msg/Cells", "rest[2]"),
    TopicMapping(Signal.CW_RIGHT, "/e", "madrob_msgs/msg/Cells", "cells.number"),
    TopicMapping(Signal.DOOR, "/k", "sensor_msgs/msg/JointState", "position[name=door]"),
)
TEXTS = st.text(max_size=5)
NUMBERS = st.lists(st.floats(width=32), max_size=6)


def filled(type_name: str, **fields: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    """Of a type with a header if it has a frame and nanoseconds."""

    def make(fields: dict[str, object]) -> object:
        made = TYPES.make(type_name, **{k: v for k, v in fields.items() if k not in STAMPED})
        if "frame" in fields:
            made.header.frame_id = fields["frame"]
            made.header.stamp.sec, made.header.stamp.nanosec = 5, fields["nanosec"]
        return made

    return st.fixed_dictionaries(fields).map(make)


def floats(kind: str = "f4") -> st.SearchStrategy[object]:
    return NUMBERS.map(lambda values: np.array(values, dtype=kind))


STAMPED = {"frame": TEXTS, "nanosec": st.integers(0, 10**9 - 1)}
CELLS = filled(
    "madrob_msgs/msg/Cell",
    name=TEXTS,
    on=st.booleans(),
    force=st.floats(width=32),
    ranges=floats(),
    number=st.integers(-(2**63), 2**63 - 1),
)
MESSAGES: dict[str, st.SearchStrategy[object]] = {
    "geometry_msgs/msg/WrenchStamped": filled("geometry_msgs/msg/WrenchStamped", **STAMPED),
    BOOL: filled(BOOL, data=st.booleans()),
    "sensor_msgs/msg/JointState": filled(
        "sensor_msgs/msg/JointState",
        **STAMPED,
        name=st.lists(TEXTS | st.just("door"), max_size=3),
        position=floats("f8"),
        velocity=floats("f8"),
    ),
    "sensor_msgs/msg/LaserScan": filled(
        "sensor_msgs/msg/LaserScan",
        **STAMPED,
        range_min=st.floats(width=32),
        range_max=st.floats(width=32),
        ranges=floats(),
        intensities=floats(),
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
    cut=st.floats(0, 1),
    noise=st.sampled_from([b"", b"\x00\x01\x00\x00"]) | st.binary(max_size=200),
)
def test_a_known_layout_changes_nothing_and_no_bytes_do_worse_than_an_error(
    mapping: TopicMapping,
    little: bool,
    data: st.DataObject,
    changes: list[tuple[float, int]],
    cut: float,
    noise: bytes,
) -> None:
    first, second = (
        bytes(STORE.serialize_cdr(message, mapping.type, little_endian=little))
        for message in (data.draw(MESSAGES[mapping.type]) for _ in range(2))
    )
    changed = bytearray(first)
    for where, byte in changes:
        changed[int(where * (len(changed) - 1))] = byte
    decoder = Decoder([mapping], TYPES)
    told(decoder, raw(mapping, first))
    for content in (first, second, bytes(changed), bytes(changed)[: int(cut * len(first))], noise):
        message = raw(mapping, content)
        words = told(decoder, message)
        assert words == told(Decoder([mapping], TYPES), message)
        assert words.startswith(f"{mapping.topic}: ") or "log_time=2e-09" in words
        assert "\n" not in words


OWN_TYPES = MessageTypes()
OWN_TYPES.register(
    "madrob_msgs/msg/Cells",
    "std_msgs/Header header\nmadrob_msgs/Cell[] cells\n"
    f"{'=' * 80}\nMSG: madrob_msgs/Cell\nfloat32 force\nfloat32[3] ranges\nfloat64 class\n",
)
STAMP = {"sec": 1_700_000_000, "nanosec": 123_456_789}
STAMP_NS = 1_700_000_000_123_456_789
RECEIVE_NS = 1_700_000_000_200_000_001
TIMES = (STAMP_NS / 10**9, RECEIVE_NS / 10**9)


def message(topic: str, type_name: str, **fields: object) -> RawMessage:
    made = OWN_TYPES.make(type_name, **fields)
    if "header" in OWN_TYPES.fields(type_name):
        made.header.stamp = OWN_TYPES.make("builtin_interfaces/msg/Time", **STAMP)
    return RawMessage(topic, type_name, OWN_TYPES.encode(type_name, made), STAMP_NS, RECEIVE_NS)


def scan(topic: str = "/madrob/passage/cw_left", **fields: object) -> RawMessage:
    return message(topic, "sensor_msgs/msg/LaserScan", **fields)


def ranges(*values: float) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    return np.array(values, dtype=np.float32)


def decode(raw: RawMessage, *mappings: TopicMapping) -> Sample | None:
    return Decoder(mappings or DEFAULT_MAPPINGS, OWN_TYPES).decode(raw)


ARRAY, FLOAT = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float64"
UNLOCKED = TopicMapping(Signal.LATCH, "/u", BOOL, "data", scale=-1.0, offset=1.0)
HEIGHTS = TopicMapping(Signal.CW_LEFT, "/h", SCAN, "ranges", scale=-0.001, offset=2.0)
GRAMS = TopicMapping(Signal.HANDLE, "/f", FLOAT, "data", scale=0.00980665, offset=-1.0)


def _cell(force: float) -> object:
    cell = OWN_TYPES.make("madrob_msgs/msg/Cell", force=force, ranges=ranges(1.0, 1.0, 1.0))
    cell.class_ = 3.0
    return cell


def cells(signal: Signal, field: str) -> TopicMapping:
    return TopicMapping(signal, "/c", CELLS_TYPE, field)


PASSAGE = "madrob_msgs/msg/Passage"
OWN_TYPES.register(
    PASSAGE,
    "std_msgs/Header header\nsensor_msgs/Range[] ranges\nbool status_ok\n"
    f"{'=' * 80}\nMSG: sensor_msgs/Range\n{OWN_TYPES.definition('sensor_msgs/msg/Range')}",
)


def _echo(mm: float) -> object:
    """A range as the original testbed sends it."""
    made = OWN_TYPES.make("sensor_msgs/msg/Range", range=mm, max_range=2500.0)
    made.header.stamp = OWN_TYPES.make("builtin_interfaces/msg/Time", sec=3)
    return made


def wrench(force: float) -> RawMessage:
    made = OWN_TYPES.make("geometry_msgs/msg/WrenchStamped").wrench
    made.force.x = force
    return message("/madrob/handle/force", "geometry_msgs/msg/WrenchStamped", wrench=made)


TWO_CELLS = message("/c", CELLS_TYPE, cells=[_cell(1.0), _cell(2.5)])
NOW = (TIMES[1], TIMES[1])
"""Without a stamp a sample is as old as its reception."""


@pytest.mark.parametrize(
    ("raw", "mapping", "sample"),
    [
        (message(DOOR.topic, JOINTS, position=np.array([0.5, 9.0])), None, DoorSample(*TIMES, 0.5)),
        (message(DOOR.topic, JOINTS), None, DoorSample(*TIMES, math.nan)),
        (wrench(-7.25), None, HandleSample(*TIMES, -7.25)),
        *(
            (
                scan(f"/madrob/passage/{strip}", range_max=4.0, ranges=ranges(0.5, 1.0, 1.5, 2.0)),
                None,
                PassageSample(*TIMES, strip, (0.5, 1.0, 1.5, 2.0), 0.0, 4.0),
            )
            for strip in Strip
        ),
        (message("/madrob/door/locked", BOOL, data=True), None, LatchSample(*NOW, engaged=True)),
        (message("/rosout", BOOL), None, None),
        (message("/u", BOOL, data=True), UNLOCKED, LatchSample(*NOW, engaged=False)),
        (message("/u", BOOL, data=False), UNLOCKED, LatchSample(*NOW, engaged=True)),
        (message("/f", FLOAT, data=200.0), GRAMS, HandleSample(*NOW, 200.0 * 0.00980665 - 1.0)),
        (TWO_CELLS, cells(Signal.HANDLE, "cells[1].force"), HandleSample(*TIMES, 2.5)),
        (
            TWO_CELLS,
            cells(Signal.CCW_LEFT, "cells[0].ranges"),
            PassageSample(*TIMES, Strip.CCW_LEFT, (1.0, 1.0, 1.0), 0.0, math.inf),
        ),
        (TWO_CELLS, cells(Signal.DOOR, "cells[0].class"), DoorSample(*TIMES, 3.0)),
        *(
            (
                scan("/p", range_max=4.0, ranges=ranges(0.5, silent, 1.5, silent)),
                TopicMapping(Signal.CW_LEFT, "/p", SCAN, "ranges", no_echo=says),
                PassageSample(*TIMES, Strip.CW_LEFT, (0.5, math.inf, 1.5, math.inf), 0.0, 4.0),
            )
            for says, silent in (("0", 0.0), ("nan", math.nan), ("65.535", 65.535))
        ),
        (
            TWO_CELLS,
            cells(Signal.CCW_LEFT, "cells.force"),
            PassageSample(*TIMES, Strip.CCW_LEFT, (1.0, 2.5), 0.0, math.inf),
        ),
        *(
            (
                message(
                    DOOR.topic, JOINTS, name=names, position=np.array([9.0, 0.5][: len(names)])
                ),
                replace(DOOR, field="position[name=door]"),
                DoorSample(*TIMES, angle),
            )
            for names, angle in (
                (["lock", "door"], 0.5),
                (["door"], 9.0),
                (["lock", "gate"], math.nan),
                ([], math.nan),
            )
        ),
        (
            message("/p", PASSAGE, ranges=[_echo(mm) for mm in (400, 1500, 2000, 2000)]),
            TopicMapping(Signal.CW_LEFT, "/p", PASSAGE, "ranges.range", scale=0.001),
            PassageSample(*TIMES, Strip.CW_LEFT, (0.4, 1.5, 2.0, 2.0), 0.0, 2.5),
        ),
        (
            message("/c", CELLS_TYPE),
            cells(Signal.CW_LEFT, "cells[2].ranges"),
            PassageSample(*TIMES, Strip.CW_LEFT, (), 0.0, math.inf),
        ),
        (
            scan(ranges=ranges(math.inf, -math.inf, math.nan), range_max=2.0),
            None,
            PassageSample(*TIMES, Strip.CW_LEFT, (math.inf, -math.inf, math.nan), 0.0, 2.0),
        ),
        (
            scan(ranges=ranges(*range(1, 100))),
            None,
            PassageSample(*TIMES, Strip.CW_LEFT, (1.0, 2.0, 3.0, 4.0), 0.0, 0.0),
        ),
        (
            scan("/h", ranges=ranges(500, 1500), range_min=0.0, range_max=2000.0),
            HEIGHTS,
            PassageSample(*TIMES, Strip.CW_LEFT, (1.5, 0.5), 0.0, 2.0),
        ),
        (
            message("/a", ARRAY, data=np.array([1.0, 2.0])),
            TopicMapping(Signal.CW_LEFT, "/a", ARRAY, "data"),
            PassageSample(*NOW, Strip.CW_LEFT, (1.0, 2.0), 0.0, math.inf),
        ),
    ],
)
def test_a_message_is_decoded_as_the_protocol_or_the_settings_say(
    raw: RawMessage, mapping: TopicMapping | None, sample: Sample | None
) -> None:
    mappings = DEFAULT_MAPPINGS if mapping is None else (mapping,)
    assert repr(decode(raw, *mappings)) == repr(sample)  # NaN is itself there


RANGE = "sensor_msgs/msg/Range"
FOUR = [TopicMapping(Signal.CW_LEFT, f"/r{n}", RANGE, "range", scale=0.001) for n in range(4)]


def heard_range(place: int, mm: float, later: float = 0.0, largest: float = 2500.0) -> RawMessage:
    """A message of one of the four topics, so long after the first ones, s."""
    raw = message(f"/r{place}", RANGE, range=mm, max_range=largest)
    return structs.replace(raw, receive_ns=RECEIVE_NS + round(later * 1e9))


def test_four_topics_of_one_range_are_a_strip_when_the_last_ones_message_comes() -> None:
    decoder = Decoder(FOUR, OWN_TYPES)
    for place, mm in ((2, 1500), (0, 500), (1, 1000)):
        assert decoder.decode(heard_range(place, mm)) is None
    whole = PassageSample(*TIMES, Strip.CW_LEFT, (0.5, 1.0, 1.5, 2.0), 0.0, 2.5)
    assert decoder.decode(heard_range(3, 2000)) == whole
    decoder.decode(heard_range(0, 1800, later=0.4, largest=1700.0))  # outside its own limits
    decoder.decode(heard_range(1, math.inf, later=0.4))
    for later, third in ((0.4, 1.5), (0.6, math.nan)):  # it is silent
        sample = decoder.decode(heard_range(3, 2000, later))
        assert isinstance(sample, PassageSample)
        assert repr(sample.ranges) == repr((math.nan, math.inf, third, 2.0))
        assert sample.log_time == pytest.approx(TIMES[1] + later)


@pytest.mark.parametrize(
    "mappings",
    [FOUR[:3], [*FOUR, replace(FOUR[0], topic="/r4")], [DOOR, replace(DOOR, topic="/d")]],
)
def test_a_signal_has_one_topic_or_a_strip_four(mappings: list[TopicMapping]) -> None:
    with pytest.raises(MadrobError, match="is mapped twice: keep one topic"):
        Decoder(mappings, OWN_TYPES)


@pytest.mark.parametrize(
    ("signal", "type_name", "field", "words"),
    [
        (Signal.DOOR, "std_msgs/msg/Float32", "data", "it sends std_msgs/msg/Float64, not std_m"),
        (Signal.DOOR, FLOAT, "angle", "no field angle: std_msgs/msg/Float64 holds data"),
        (Signal.DOOR, FLOAT, "data[0]", "follows no array"),
        (Signal.DOOR, FLOAT, "data.x", "nothing is inside"),
        (Signal.DOOR, STRING, "data", "holds no numbers"),
        (Signal.DOOR, "std_msgs/msg/Header", "stamp", "holds no numbers"),
        (Signal.DOOR, SCAN, "ranges", "is not one number"),
        (Signal.DOOR, SCAN, "ranges[name=door]", "name holds no names"),
        (Signal.DOOR, JOINTS, "name[name=door]", "holds no numbers"),
        (Signal.DOOR, FLOAT, "data[name=door]", "follows no array"),
        (Signal.CW_LEFT, CELLS_TYPE, "cells.ranges", "holds no numbers"),
        (Signal.DOOR, CELLS_TYPE, "cells.force", "is not one number"),
        (Signal.CW_LEFT, SCAN, "range_min", "is not an array"),
        (Signal.CW_LEFT, "madrob_msgs/msg/Cell", "ranges[3]", "its array ends at 2"),
        (Signal.LATCH, JOINTS, "position[0]", "says nothing about the latch"),
        (Signal.DOOR, "x_msgs/msg/Y", "z", "x_msgs/msg/Y is unknown"),
    ],
)
def test_a_field_that_does_not_fit_is_explained_in_one_line(
    signal: Signal, type_name: str, field: str, words: str
) -> None:
    sent = FLOAT if type_name == "std_msgs/msg/Float32" else type_name
    data = OWN_TYPES.encode(sent, OWN_TYPES.make(sent)) if OWN_TYPES.knows(sent) else b""
    with pytest.raises(MessageError, match=words) as refused:
        decode(RawMessage("/t", sent, data, 0, 0), TopicMapping(signal, "/t", type_name, field))
    assert str(refused.value).startswith("/t: ")
    assert "\n" not in str(refused.value)


def test_a_type_that_becomes_known_later_is_decoded_from_then_on() -> None:
    types = MessageTypes()
    decoder = Decoder([TopicMapping(Signal.DOOR, "/n", "n_msgs/msg/N", "x")], types)
    raw = RawMessage("/n", "n_msgs/msg/N", b"\0\1\0\0" + np.float64(0.5).tobytes(), 1, 2)
    with pytest.raises(MessageError, match="n_msgs/msg/N is unknown"):
        decoder.decode(raw)
    types.register("n_msgs/msg/N", "float64 x\n")
    assert decoder.decode(raw) == DoorSample(2e-9, 2e-9, 0.5)


@pytest.mark.parametrize(
    "path", ["", ".", "a.", ".a", "a[", "a[-1]", "a[x]", "a b", "0", "a..b", "a[=x]", "a[n=]"]
)
def test_a_malformed_field_is_refused_with_an_example(path: str) -> None:
    with pytest.raises(MadrobError, match=r"position\[0\]"):
        TopicMapping(Signal.DOOR, "/d", "std_msgs/msg/Float64", path)


@pytest.mark.parametrize(("scale", "offset"), [(0.0, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_a_scale_that_loses_the_signal_is_refused(scale: float, offset: float) -> None:
    with pytest.raises(MadrobError, match="/d: "):
        TopicMapping(Signal.DOOR, "/d", "std_msgs/msg/Float64", "data", scale, offset)


def test_each_signal_has_one_topic_and_each_topic_one_signal() -> None:
    again, other = replace(DOOR, topic="/other"), replace(DOOR, signal=Signal.HANDLE)
    for mapping, words in ((again, "door angle"), (other, "/madrob/door/angle")):
        with pytest.raises(MadrobError, match=f"{words} is mapped twice"):
            Decoder([DOOR, mapping], OWN_TYPES)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_words_come_back_as_they_were_said(text: str) -> None:
    assert decode_text(OWN_TYPES, encode_text(OWN_TYPES, text)) == text


def test_words_that_are_none_are_an_error() -> None:
    with pytest.raises(MessageError, match="not a std_msgs/msg/String"):
        decode_text(OWN_TYPES, b"\x00\x01\x00\x00\xff\xff\xff\xff")


def test_the_start_pose_faces_where_its_yaw_says() -> None:
    pose = encode_start_pose(OWN_TYPES, StartPose(1.5, -0.25, 90.0), STAMP_NS)
    back = OWN_TYPES.decode("geometry_msgs/msg/PoseStamped", pose)
    assert back.header.frame_id == "madrob_door"
    assert (back.header.stamp.sec, back.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    assert (back.pose.position.x, back.pose.position.y, back.pose.position.z) == (1.5, -0.25, 0.0)
    turn = back.pose.orientation
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert 2 * math.degrees(math.atan2(turn.z, turn.w)) == pytest.approx(90.0)


def test_the_last_word_of_the_referee_reaches_late_joiners() -> None:
    topics = {topic.name: topic for topic in referee_topics(OWN_TYPES)}
    assert list(topics) == [
        "/madrob/referee/state",
        "/madrob/referee/event",
        "/madrob/referee/start_pose",
        "/madrob/referee/running",
        "/madrob/referee/elapsed",
        "/madrob/referee/level",
    ]
    assert all(t.qos.durability is Durability.TRANSIENT_LOCAL for t in topics.values())
    assert "MSG: geometry_msgs/Quaternion" in topics["/madrob/referee/start_pose"].definition
