from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from madrob_console.errors import MadrobError
from madrob_console.messages.message_types import (
    MessageError,
    MessageTypes,
    standard_types,
    types_of,
)
from recorder.bag import Topic

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


def test_what_is_made_holds_the_given_fields(types: MessageTypes) -> None:
    made = types.make("sensor_msgs/msg/JointState", name=["door"], position=np.array([0.25]))
    back = types.decode("sensor_msgs/msg/JointState", types.encode(made.__msgtype__, made))
    assert back.name == ["door"]
    assert back.position.tolist() == [0.25]
    assert back.effort.tolist() == []
    assert back.header.frame_id == ""


def test_a_field_that_the_type_does_not_have_is_named(types: MessageTypes) -> None:
    with pytest.raises(MessageError, match="std_msgs/msg/Bool has no field angle"):
        types.make("std_msgs/msg/Bool", angle=1.0)


@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_a_registered_type_is_known_like_a_standard_one(types: MessageTypes, end: str) -> None:
    text = (HANDLE + CELL + HEADER).rstrip("\n").replace("\n", end or "\n") + end
    types.register("madrob_msgs/msg/Handle", text)
    assert types.knows("madrob_msgs/msg/Handle")
    message = types.make("madrob_msgs/msg/Handle", force=-2.5)
    message.cells = [types.make("madrob_msgs/msg/Cell", raw=7)]
    back = types.decode("madrob_msgs/msg/Handle", types.encode("madrob_msgs/msg/Handle", message))
    assert (back.force, back.cells[0].raw, back.spare.tolist()) == (-2.5, 7, [0.0] * 4)


def test_a_complete_definition_is_kept_word_by_word(types: MessageTypes) -> None:
    text = "# gram-force\n" + HANDLE + CELL + HEADER
    types.register("madrob_msgs/msg/Handle", text)
    assert types.definition("madrob_msgs/msg/Handle") == text


def test_what_a_definition_leaves_out_is_added_where_it_is_known(types: MessageTypes) -> None:
    types.register("madrob_msgs/msg/Handle", HANDLE + CELL)
    definition = types.definition("madrob_msgs/msg/Handle")
    assert "MSG: std_msgs/Header" in definition
    assert "MSG: builtin_interfaces/Time" in definition
    assert "MSG: madrob_msgs/Cell" in definition
    other = MessageTypes()
    other.register("madrob_msgs/msg/Handle", definition)
    assert other.type_hash("madrob_msgs/msg/Handle") == types.type_hash("madrob_msgs/msg/Handle")


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


def test_hashes_are_those_of_ros(types: MessageTypes) -> None:
    assert types.type_hash("sensor_msgs/msg/JointState") == (
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )


def test_no_hash_is_better_than_a_wrong_one(types: MessageTypes) -> None:
    assert types.type_hash("std_msgs/msg/Char") == ""
    assert types.type_hash("service_msgs/msg/ServiceEventInfo") == ""


def test_an_unknown_type_is_named_whatever_is_asked(types: MessageTypes) -> None:
    assert not types.knows("x_msgs/msg/Y")
    for ask in (types.definition, types.type_hash, types.make, types.fields):
        with pytest.raises(MessageError, match="x_msgs/msg/Y is unknown"):
            ask("x_msgs/msg/Y")
    with pytest.raises(MessageError, match="x_msgs/msg/Y is unknown"):
        types.encode("x_msgs/msg/Y", object())
    with pytest.raises(MessageError, match="x_msgs/msg/Y is unknown"):
        types.decode("x_msgs/msg/Y", b"")


def test_a_message_that_does_not_fit_its_type_is_refused(types: MessageTypes) -> None:
    wrong = types.make("std_msgs/msg/String", data=5)
    with pytest.raises(MessageError, match="std_msgs/msg/String: cannot be encoded"):
        types.encode("std_msgs/msg/String", wrong)
    with pytest.raises(MessageError, match="cannot be encoded"):
        types.encode("std_msgs/msg/String", types.make("std_msgs/msg/String", data="\ud800"))


def test_bags_of_standard_types_share_their_readers() -> None:
    text = Topic("/text", "std_msgs/msg/String", "string data\n")
    other = Topic("/other", "std_msgs/msg/Bool", "bool data\n")
    assert types_of([text]) is types_of([other, text]) is standard_types()


def test_two_bags_may_define_one_type_differently() -> None:
    first = types_of([Topic("/angle", ANGLE, "float64 angle\n")])
    second = types_of([Topic("/angle", ANGLE, "float32 angle\nbool ok\n")])
    assert list(first.fields(ANGLE)) == ["angle"]
    assert list(second.fields(ANGLE)) == ["angle", "ok"]
    assert not standard_types().knows(ANGLE)


def test_a_definition_that_lacks_a_part_is_named() -> None:
    topic = Topic("/angle", ANGLE, "door_msgs/Part part\n")
    with pytest.raises(MadrobError, match=f"{ANGLE}: the definition of door_msgs/msg/Part is miss"):
        types_of([topic])
