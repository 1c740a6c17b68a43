from __future__ import annotations

from collections.abc import Callable

import pytest
from rosbags.typesys import Stores, get_typestore

from madrob_console.common.errors import MadrobError
from madrob_console.messages.types import (
    Message,
    MessageError,
    MessageTypes,
    standard_types,
    types_of,
)
from recorder.bag import Topic
from tests.madrob_console.messages.made import BOOL, JOINTS, LINE, STRING

HANDLE, ANGLE = "door_msgs/msg/Handle", "door_msgs/msg/Angle"
FIELDS = "std_msgs/Header header\nfloat64 force\nfloat32[4] spare\ndoor_msgs/Cell[] cells\n"
CELL = f"{LINE}door_msgs/Cell\nint16 raw\n"
HEADER = (
    f"{LINE}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{LINE}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@pytest.fixture
def types() -> MessageTypes:
    return MessageTypes()


@pytest.mark.parametrize("name", get_typestore(Stores.ROS2_JAZZY).fielddefs)
def test_standard_type_is_made_encoded_and_decoded(name: str) -> None:
    types = standard_types()
    data = types.encode(name, types.make(name))
    assert types.encode(name, types.decode(name, data)) == data


@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_registered_type_is_known_like_a_standard_one(types: MessageTypes, end: str) -> None:
    text = (FIELDS + CELL + HEADER).rstrip("\n").replace("\n", end or "\n") + end
    types.register(HANDLE, text)
    message = types.make(HANDLE, force=-2.5, cells=[types.make("door_msgs/msg/Cell", raw=7)])

    back = types.decode(HANDLE, types.encode(HANDLE, message))

    assert types.knows(HANDLE)
    assert (back.force, back.cells[0].raw, back.spare.tolist()) == (-2.5, 7, [0.0] * 4)


def test_what_a_definition_leaves_out_is_added(types: MessageTypes) -> None:
    text = "# gram-force\n" + FIELDS + CELL + HEADER
    whole = MessageTypes()
    whole.register(HANDLE, text)
    types.register(HANDLE, FIELDS + CELL)

    assert whole.definition(HANDLE) == text
    assert "MSG: builtin_interfaces/Time" in types.definition(HANDLE)
    assert types.type_hash(HANDLE) == whole.type_hash(HANDLE)


@pytest.mark.parametrize(
    ("name", "definition", "words"),
    [
        ("a_msgs/msg/T", "float64 x\nnonsense", "cannot be read"),
        ("a_msgs/msg/T", "Missing m\n", "definition of a_msgs/msg/Missing is missing"),
        ("a_msgs/msg/T", "T inner\n", "contains itself"),
        ("a_msgs/msg/T", f"U u\n{LINE}a_msgs/U\nT t\n", "contains itself"),
        ("a_msgs/srv/T", "float64 x\n", "no type name"),
        (JOINTS, "float64 position\n", "known with other fields"),
    ],
)
def test_useless_definition_is_refused_in_one_line(
    types: MessageTypes, name: str, definition: str, words: str
) -> None:
    with pytest.raises(MadrobError, match=f"^{name}.*{words}.*$"):
        types.register(name, definition)


@pytest.mark.parametrize(
    ("name", "type_hash"),
    [
        (JOINTS, "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
        ("std_msgs/msg/Char", ""),
        ("service_msgs/msg/ServiceEventInfo", ""),
    ],
)
def test_hash_is_that_of_ros_or_none(types: MessageTypes, name: str, type_hash: str) -> None:
    assert types.type_hash(name) == type_hash


UNKNOWN = "x_msgs/msg/Y"


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda types: types.definition(UNKNOWN), "x_msgs/msg/Y is unknown: install its package"),
        (lambda types: types.type_hash(UNKNOWN), "x_msgs/msg/Y is unknown"),
        (lambda types: types.make(UNKNOWN), "x_msgs/msg/Y is unknown"),
        (lambda types: types.fields(UNKNOWN), "x_msgs/msg/Y is unknown"),
        (lambda types: types.encode(UNKNOWN, object()), "x_msgs/msg/Y is unknown"),
        (lambda types: types.decode(UNKNOWN, b""), "x_msgs/msg/Y is unknown"),
        (lambda types: types.make(BOOL, angle=1.0), f"{BOOL} has no field angle"),
        (lambda types: types.encode(STRING, types.make(STRING, data=5)), "cannot be encoded"),
        (lambda types: types.encode(STRING, types.make(STRING, data="\ud800")), "cannot be enc"),
    ],
)
def test_what_a_type_cannot_do_is_named(
    ask: Callable[[MessageTypes], Message], words: str, types: MessageTypes
) -> None:
    with pytest.raises(MessageError, match=words):
        ask(types)


def test_bags_may_define_one_type_differently() -> None:
    first = types_of([Topic("/angle", ANGLE, "float64 angle\n")])
    second = types_of([Topic("/angle", ANGLE, "float32 angle\nbool ok\n")])

    assert [list(first.fields(ANGLE)), list(second.fields(ANGLE))] == [["angle"], ["angle", "ok"]]
    assert types_of([Topic("/text", STRING, "string data\n")]) is standard_types()
    assert not standard_types().knows(ANGLE)
