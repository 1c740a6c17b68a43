"""The message types of bags: what one bag defines is known to no other."""

from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.errors import MadrobError
from madrob_console.messages.bag_types import standard_types, types_of
from recorder.bag import Topic
from recorder.reader import Bag, read_bag
from recorder.writer import BagWriter

ANGLE = "door_msgs/msg/Angle"


def bag(folder: Path, *topics: Topic) -> Bag:
    with BagWriter(folder, topics, {}):
        pass
    return read_bag(folder)


def test_bags_of_standard_types_share_their_readers(tmp_path: Path) -> None:
    text = Topic("/text", "std_msgs/msg/String", "string data\n")
    assert types_of(bag(tmp_path / "one", text)) is types_of(bag(tmp_path / "two", text))


def test_two_bags_may_define_one_type_differently(tmp_path: Path) -> None:
    first = types_of(bag(tmp_path / "one", Topic("/angle", ANGLE, "float64 angle\n")))
    second = types_of(bag(tmp_path / "two", Topic("/angle", ANGLE, "float32 angle\nbool ok\n")))
    assert list(first.fields(ANGLE)) == ["angle"]
    assert list(second.fields(ANGLE)) == ["angle", "ok"]
    assert not standard_types().knows(ANGLE)


def test_a_definition_that_lacks_a_part_is_named(tmp_path: Path) -> None:
    topic = Topic("/angle", ANGLE, "door_msgs/Part part\n")
    with pytest.raises(MadrobError, match=f"{ANGLE}: the definition of door_msgs/msg/Part is miss"):
        types_of(bag(tmp_path / "one", topic))
