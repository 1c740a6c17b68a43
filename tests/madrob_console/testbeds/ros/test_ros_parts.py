from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.messages.codec import MessageTypes
from madrob_console.testbeds.ros.definitions import find_definition, prefixes
from madrob_console.testbeds.ros.losses import LossCounter
from madrob_console.testbeds.ros.mailbox import Mailbox
from recorder.message import RawMessage

INSTALLED = prefixes({"AMENT_PREFIX_PATH": ""})[0] / "share"


@given(st.lists(st.booleans(), min_size=1), st.integers(1, 1000), st.data())
def test_losses_are_the_gaps_between_received_messages(
    arrived: list[bool], first: int, data: st.DataObject
) -> None:
    numbers = [first + i for i, a in enumerate(arrived) if a]
    counter = LossCounter()
    while numbers:
        size = data.draw(st.integers(1, len(numbers)))
        counter.see(numbers[:size], publishers=1)
        numbers = numbers[size:]
    heard = [i for i, a in enumerate(arrived) if a]
    assert counter.lost == (arrived[heard[0] : heard[-1]].count(False) if heard else 0)


def test_another_publisher_is_no_gap() -> None:
    counter = LossCounter()
    counter.see([1, 2], publishers=1)
    counter.see([], publishers=0)
    counter.see([70, 71, 73], publishers=1)
    assert counter.lost == 1


def test_losses_among_several_publishers_are_unknown_until_one_is_left() -> None:
    counter = LossCounter()
    counter.see([1, 3], publishers=1)
    counter.see([4, 900, 5], publishers=2)
    assert counter.lost is None
    counter.see([901, 902], publishers=1)
    assert counter.lost == 1


def test_a_middleware_without_sequence_numbers_leaves_the_loss_unknown() -> None:
    counter = LossCounter()
    counter.see([None], publishers=1)
    counter.see([], publishers=1)
    assert counter.lost is None


def message(topic: str = "/a", size: int = 10) -> RawMessage:
    return RawMessage(topic, "std_msgs/msg/Bool", bytes(size), 0, 0)


def test_the_mailbox_hands_over_at_once_and_waits_no_longer_than_told() -> None:
    mailbox = Mailbox()
    before = time.monotonic()
    assert mailbox.take(0.05) == []
    assert 0.04 < time.monotonic() - before < 1.0
    sender = threading.Timer(0.02, mailbox.put, [[message()]])
    sender.start()
    assert mailbox.take(10.0) == [message()]
    assert mailbox.take(0) == []
    sender.join()


def test_a_full_mailbox_drops_and_counts_by_topic() -> None:
    mailbox = Mailbox(capacity=850)
    mailbox.put([message("/b"), message("/b"), message("/b"), message("/a")])
    assert [m.topic for m in mailbox.take(0)] == ["/b", "/b", "/a"]
    assert (mailbox.dropped("/a"), mailbox.dropped("/b")) == (0, 1)
    mailbox.put([message("/b")])
    assert len(mailbox.take(0)) == 1


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace with packages that only the running system knows."""
    folder = tmp_path / "share/madrob_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "Handle.msg").write_text(
        "# the handle\nstd_msgs/Header header\nfloat64 force\nPart[2] parts\n"
    )
    (folder / "Part.msg").write_text("string name\nother_msgs/Deep[] deep\n")
    (folder / "Handle.json").write_text(
        '{"type_hashes": [{"type_name": "madrob_msgs/msg/Handle", "hash_string": "RIHS01_ab"}]}'
    )
    other = tmp_path / "share/other_msgs/msg"
    other.mkdir(parents=True)
    (other / "Deep.msg").write_text("int32 value\nPair pair")
    (other / "Pair.msg").write_text("float32 a\nfloat32 b\n")
    return tmp_path


def test_a_type_of_the_running_system_is_known_with_all_nested_types(workspace: Path) -> None:
    definition = find_definition("madrob_msgs/msg/Handle", [workspace])
    assert definition is not None
    assert definition.type_hash == "RIHS01_ab"
    types = MessageTypes()
    types.register("madrob_msgs/msg/Handle", definition.text)
    pair = types.make("other_msgs/msg/Pair", a=0.5)
    deep = types.make("other_msgs/msg/Deep", value=7, pair=pair)
    part = types.make("madrob_msgs/msg/Part", name="knob", deep=[deep])
    handle = types.make("madrob_msgs/msg/Handle", force=2.5, parts=[part, part])
    data = types.encode("madrob_msgs/msg/Handle", handle)
    assert types.decode("madrob_msgs/msg/Handle", data).parts[1].deep[0].pair.a == 0.5


def test_the_first_workspace_wins(workspace: Path, tmp_path: Path) -> None:
    overlay = tmp_path / "overlay"
    folder = overlay / "share/other_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "Pair.msg").write_text("float64 a\n")
    definition = find_definition("other_msgs/msg/Pair", [overlay, workspace])
    assert definition is not None
    assert definition.text == "float64 a\n"


def test_a_type_that_no_workspace_has_is_not_found(workspace: Path) -> None:
    assert find_definition("madrob_msgs/msg/Door", [workspace]) is None
    assert find_definition("Door", [workspace]) is None


@pytest.mark.parametrize("text", ["", "{", '{"type_hashes": [{}]}', '{"type_hashes": 3}'])
def test_a_damaged_hash_file_leaves_the_hash_unknown(workspace: Path, text: str) -> None:
    (workspace / "share/madrob_msgs/msg/Handle.json").write_text(text)
    definition = find_definition("madrob_msgs/msg/Handle", [workspace])
    assert definition is not None
    assert definition.type_hash == ""


def test_packages_are_looked_for_where_ros_says_or_beside_python() -> None:
    assert prefixes({"AMENT_PREFIX_PATH": "/a:/b"}) == (Path("/a"), Path("/b"))
    assert prefixes({}) == (Path(sys.prefix),)


def test_every_installed_definition_is_understood_and_hashed_alike() -> None:
    files = sorted(INSTALLED.glob("*_msgs/msg/*.msg"))
    if not files:
        pytest.skip("no message packages are installed beside Python")
    for file in files:
        name = f"{file.parts[-3]}/msg/{file.stem}"
        definition = find_definition(name, [INSTALLED.parent])
        assert definition is not None
        types = MessageTypes()
        types.register(name, definition.text)
        assert types.definition(name) == definition.text
        assert types.type_hash(name) in {definition.type_hash, ""}
