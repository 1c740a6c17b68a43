from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import (
    LARGEST_WORDS,
    ROBOT_FINISHED_TOPIC,
    decode_text,
    referee_topics,
)
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.announcement import INFO_TOPIC, INFO_TYPE, SILENT, info_text
from madrob_console.testbeds.ros.connection import RosObject, load_message_class, load_module
from madrob_console.testbeds.ros.door_parameters import door_parameters
from madrob_console.testbeds.ros.intake import LossCounter
from madrob_console.testbeds.ros.ros_source import Mailbox
from madrob_console.testbeds.ros.subscriptions import qos_profile
from madrob_console.testbeds.ros.types import describe_installed, find_definition, prefixes
from madrob_console.testbeds.ros.watches import console_name, second_referee
from recorder.bag import Durability, RawMessage
from scoring.protocol import BenchmarkType, Condition, Side, StartPose
from tests.madrob_console import said
from tests.madrob_console.ros_peer import (
    BOOL,
    KEPT,
    TYPES,
    Peer,
    Taker,
    source,
)
from tests.watching import PATIENCE, until

INSTALLED = Path(sys.prefix) / "share"


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


@pytest.mark.parametrize(
    ("seen", "lost"),
    [
        ([([1, 2], 1), ([], 0), ([70, 71, 73], 1)], 1),
        ([([1, 3], 1), ([4, 900, 5], 2)], None),
        ([([1, 3], 1), ([4, 900, 5], 2), ([901, 902], 1)], 1),
        ([([None], 1), ([], 1)], None),
    ],
    ids=["another publisher", "several", "one of them is left", "without sequence numbers"],
)
def test_another_publisher_is_no_gap_and_what_cannot_be_counted_is_unknown(
    seen: list[tuple[list[int | None], int]], lost: int | None
) -> None:
    counter = LossCounter()
    for numbers, publishers in seen:
        counter.see(numbers, publishers)
    assert counter.lost == lost


def message(topic: str = "/a", size: int = 10) -> RawMessage:
    return RawMessage(topic, "std_msgs/msg/Bool", bytes(size), 0, 0)


def test_a_full_mailbox_drops_and_counts_by_topic() -> None:
    mailbox = Mailbox(capacity=850)
    mailbox.put_messages([message("/b"), message("/b"), message("/b"), message("/a")])
    assert [m.topic for m in mailbox.take_messages(0)] == ["/b", "/b", "/a"]
    assert (mailbox.dropped("/a"), mailbox.dropped("/b")) == (0, 1)
    mailbox.put_messages([message("/b")])
    assert len(mailbox.take_messages(0)) == 1


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


def test_a_type_that_is_not_there_is_not_found_or_refused_with_the_remedy(workspace: Path) -> None:
    assert find_definition("madrob_msgs/msg/Door", [workspace]) is None
    assert find_definition("Door", [workspace]) is None
    with pytest.raises(MadrobError, match=r"Bool has no [.]msg file here: install its package"):
        describe_installed([workspace], "/hall/door", BOOL)


@pytest.mark.parametrize("text", ["", "{", '{"type_hashes": [{}]}', '{"type_hashes": 3}'])
def test_a_damaged_hash_file_leaves_the_hash_unknown(workspace: Path, text: str) -> None:
    (workspace / "share/madrob_msgs/msg/Handle.json").write_text(text)
    definition = find_definition("madrob_msgs/msg/Handle", [workspace])
    assert definition is not None
    assert definition.type_hash == ""


def test_packages_are_looked_for_where_ros_says_and_then_beside_python() -> None:
    beside = Path(sys.prefix)
    assert prefixes({"AMENT_PREFIX_PATH": "/a:/b"}) == (Path("/a"), Path("/b"), beside)
    assert prefixes({}) == (beside,)


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


STRING = "std_msgs/msg/String"
OWN = ("/madrob", console_name())
STATE = "/madrob/referee/state"
REMEDY = f"{STATE}: end it, or use another ROS domain"
MACHINE = console_name().rpartition("_")[2]
PARENT = f"console_here_{os.getppid()}_{MACHINE}"
NODE_NAME = attrgetter("node_name")
NO_PROCESS = 2**22 + 1
"""Above the largest that Linux gives."""


def test_only_others_are_second_referees() -> None:
    assert str(os.getpid()) in console_name().split("_")
    assert second_referee([OWN]) is None
    assert second_referee([]) is None
    assert second_referee([OWN, OWN]) is not None
    assert second_referee([OWN], own=0) is not None


@pytest.mark.parametrize(
    ("node", "words"),
    [
        (("/", "rosbag2_player"), f"/rosbag2_player publishes {REMEDY}"),
        (("/madrob", "console"), f"/madrob/console publishes {REMEDY}"),
        (
            ("", "_CREATED_BY_BARE_DDS_APP_"),
            f"a program that has not told its name publishes {REMEDY}",
        ),
        (
            ("/madrob", "console_hall_2_4711_0a1b2c"),
            f"/madrob/console_hall_2_4711_0a1b2c (pid 4711 on hall_2) publishes {REMEDY}",
        ),
        (
            ("/madrob", PARENT),
            f"/madrob/{PARENT} (pid {os.getppid()} on here) publishes {REMEDY}",
        ),
    ],
)
def test_another_one_is_named_unless_it_is_known_to_be_gone(
    node: tuple[str, str], words: str
) -> None:
    assert second_referee([OWN, node]) == words
    assert second_referee([OWN, node], {node[1]}) is None


@pytest.mark.parametrize("process", [NO_PROCESS, 10**30])
def test_who_has_the_name_of_a_dead_console_lives_when_it_sends(
    process: int, taker: Taker, peer: Peer
) -> None:
    name = f"console_here_{process}_{MACHINE}"
    ours = RawMessage(STATE, STRING, TYPES.encode(STRING, TYPES.make(STRING, data="ours")), 1, 1)
    publisher = peer.node(name).create_publisher(
        load_message_class(STRING), STATE, qos_profile(KEPT, 1)
    )
    peer.until(publisher.get_subscription_count)
    heard = peer.listen(STATE, STRING, KEPT)
    taker.source.publish(ours)
    peer.until(lambda: heard)
    peer.until(lambda: name in map(NODE_NAME, peer.own.get_publishers_info_by_topic(STATE)))
    assert taker.source.other_referee is None
    data = TYPES.encode(STRING, TYPES.make(STRING, data="{}"))
    peer.until(lambda: publisher.publish(data) or name in str(taker.source.other_referee))
    peer.own.destroy_publisher(publisher)


def test_several_are_named_together_and_nothing_reaches_a_terminal_raw() -> None:
    words = second_referee([("/b", "two"), OWN, ("/a", "one\x1b[2J")])
    assert words is not None
    assert words.startswith("/a/one")
    assert words.endswith(f"/b/two publish {REMEDY}")
    assert "\x1b" not in words


def test_a_publisher_of_the_state_is_found_and_found_gone(taker: Taker, peer: Peer) -> None:
    assert taker.source.other_referee is None
    publisher = peer.publisher(STATE, STRING, KEPT)
    # DDS tells of a publisher before it tells of its node
    peer.until(lambda: taker.source.other_referee == f"/madrob/peer publishes {REMEDY}")
    peer.own.destroy_publisher(publisher)
    peer.until(lambda: taker.source.other_referee is None)


def test_who_only_listens_is_no_second_referee(peer: Peer) -> None:
    with Taker(source()) as referee, Taker(source(speaks=False)) as listener:
        peer.until(lambda: console_name() in str(listener.source.other_referee))
        peer.until(lambda: peer.own.count_publishers(STATE) == 1)
        assert referee.source.other_referee is None


def test_a_late_joiner_hears_the_last_state_the_pose_and_the_events_byte_for_byte(
    taker: Taker, peer: Peer
) -> None:
    states = [said.state(phase) for phase in ("idle", "countdown", "running")]
    events = [said.event(words) for words in ("door_opens", "door_closes")]
    pose = said.start_pose(StartPose(1.5, -0.25, 180.0))
    for message in (*states, *events, pose):
        taker.source.publish(message)
    expected = {
        topic.name: [m.data for m in (states[-1], *events, pose) if m.topic == topic.name]
        for topic in referee_topics(TYPES)
    }
    heard = {t.name: peer.listen_raw(t.name, t.type, KEPT) for t in referee_topics(TYPES)}
    peer.until(lambda: all(len(heard[name]) >= len(expected[name]) for name in expected))
    assert heard == expected
    assert set(referee_topics(TYPES)) <= set(taker.source.topics())
    assert {t.qos.durability for t in referee_topics(TYPES)} == {Durability.TRANSIENT_LOCAL}


LIVE = "LIVE ros domain"
SIMULATED = "SIMULATED over ROS domain"
BEFORE = 1_000_000
"""Long before this program was written, s since the epoch."""


def announce(peer: Peer, text: str) -> RosObject:
    """Say something, once for all; returns the publisher."""
    publisher = peer.publisher(INFO_TOPIC, INFO_TYPE, KEPT)
    say(publisher, text)
    return publisher


def say(publisher: RosObject, text: str) -> None:
    """Announce, and wait until all who listen have it."""
    publisher.publish(load_message_class(INFO_TYPE)(data=text))
    assert publisher.wait_for_all_acked(load_module("rclpy.duration").Duration(seconds=PATIENCE))


def test_what_a_robot_says_is_taken_but_no_large_message(taker: Taker, peer: Peer) -> None:
    robot = peer.publisher(ROBOT_FINISHED_TOPIC, INFO_TYPE)
    peer.until(robot.get_subscription_count)
    for text in ("x" * LARGEST_WORDS, "gave up"):
        say(robot, text)
    peer.until(lambda: taker.has(1))
    assert [decode_text(TYPES, message.data) for message in taker.taken] == ["gave up"]


def test_what_was_announced_before_is_heard_and_goes_with_who_said_it(peer: Peer) -> None:
    publisher = announce(peer, info_text("slam"))
    with Taker(source()) as taker:
        peer.until(lambda: taker.source.announcement.simulated == "slam")
        assert taker.source.label.startswith(SIMULATED)
        (message,) = taker.source.announcement.messages
        assert info_text("slam").encode() in message.data
        assert INFO_TOPIC in {topic.name for topic in taker.source.topics()}
        peer.own.destroy_publisher(publisher)
        peer.until(lambda: taker.source.announcement == SILENT)
        assert taker.source.label.startswith(LIVE)
        assert INFO_TOPIC not in {topic.name for topic in taker.source.topics()}


def test_what_is_announced_late_is_heard_too_and_one_of_two_testbeds_is_enough(
    taker: Taker, peer: Peer
) -> None:
    real = announce(peer, '{"kind": "real"}')
    peer.until(lambda: taker.source.announcement.messages)
    assert taker.source.announcement.simulated is None
    simulated = announce(peer, info_text("slow"))
    peer.until(lambda: taker.source.announcement.simulated == "slow")
    say(real, '{"kind": "real"}')
    second = peer.publisher(STATE, STRING, KEPT)
    peer.until(lambda: taker.source.other_referee)  # it has looked round since
    peer.own.destroy_publisher(second)
    peer.until(lambda: taker.source.other_referee is None)
    assert taker.source.announcement.simulated == "slow"
    peer.own.destroy_publisher(simulated)

    def real_alone() -> bool:
        say(real, '{"kind": "real"}')
        return taker.source.announcement.simulated is None

    peer.until(real_alone)


def test_garbage_and_megabytes_make_no_run_practice_and_are_named(taker: Taker, peer: Peer) -> None:
    publisher = announce(peer, "MADROB \x1b[2J rev 3")
    peer.until(lambda: taker.source.announcement.problem)
    told = str(taker.source.announcement.problem)
    assert told.startswith("not understood: 'MADROB")
    assert told.isprintable()
    assert taker.source.announcement.simulated is None
    say(publisher, info_text("x" * 3_000_000))
    peer.until(lambda: "bytes are no announcement" in str(taker.source.announcement.problem))
    assert not taker.source.announcement.messages  # nor is it recorded
    assert taker.source.announcement.simulated is None
    assert taker.source.label.startswith(LIVE)


SUDDEN_CW = Condition(BenchmarkType.SUDDEN_FORCE, opening_side=Side.CW, starting_side=Side.CCW)
NO_FORCE_CCW = Condition(BenchmarkType.NO_FORCE, opening_side=Side.CCW, starting_side=Side.CCW)


def door_node(
    peer: Peer, *, without: str = "", read_only: str = "", spun: bool = True
) -> RosObject:
    """A node `/madrob/door` as a testbed has it."""
    descriptor = load_module("rcl_interfaces.msg").ParameterDescriptor
    node = peer.node("door", spun=spun, parameter_services=True)
    for name, value in door_parameters(NO_FORCE_CCW).items():
        if name != without:
            node.declare_parameter(name, value, descriptor(read_only=name == read_only))
    return node


def test_the_parameters_are_those_of_the_protocol() -> None:
    parameters = door_parameters(SUDDEN_CW)
    assert parameters["opening_side"] == "CW"
    assert parameters["benchmark_type"] == "Sudden Force"
    assert parameters["brake_enabled"] is True
    cw, ccw = parameters["brake_lut_cw"], parameters["brake_lut_ccw"]
    assert isinstance(cw, list)
    assert cw == [0] * 112 + [4000] * 69
    assert ccw == cw[::-1]
    assert door_parameters(NO_FORCE_CCW)["brake_enabled"] is False


def test_the_parameters_reach_the_testbed_and_are_confirmed(taker: Taker, peer: Peer) -> None:
    door = door_node(peer)  # it answers while the peer waits
    assert taker.source.sides_problem == "the testbed's sides are not set yet: set up a run"
    taker.source.configure(SUDDEN_CW)
    unconfirmed = "node /madrob/door has not confirmed the sides yet"
    until(lambda: taker.source.sides_problem == unconfirmed)
    peer.until(lambda: taker.source.sides_problem is None)
    wanted = door_parameters(SUDDEN_CW)
    assert {name: _plain(door.get_parameter(name).value) for name in wanted} == wanted


def _plain(value: object) -> object:
    return value if isinstance(value, str | bool) else list(value)  # type: ignore[call-overload]


def test_a_node_that_is_not_there_is_named_and_one_that_comes_again_is_set_again(
    taker: Taker, peer: Peer
) -> None:
    absent = "node /madrob/door is not there: set the opening side by hand"
    taker.source.configure(SUDDEN_CW)
    for _ in range(2):
        peer.until(lambda: taker.source.sides_problem == absent)
        door = door_node(peer)
        peer.until(lambda: taker.source.sides_problem is None)
        assert door.get_parameter("opening_side").value == "CW"
        peer.end_node(door)


def no_results(peer: Peer) -> None:
    """A node that answers with nothing."""
    service = load_module("rcl_interfaces.srv").SetParameters
    peer.node("door").create_service(
        service, "/madrob/door/set_parameters", lambda _, response: response
    )


@pytest.mark.parametrize(
    ("door", "words"),
    [
        (lambda peer: door_node(peer, read_only="opening_side"), r"opening_side \(.*\)"),
        (lambda peer: door_node(peer, without="brake_enabled"), r"brake_enabled \(.*\)"),
        (no_results, "the parameters"),
    ],
    ids=["read only", "unknown", "no results"],
)
def test_what_a_node_refuses_is_named(
    door: Callable[[Peer], object], words: str, taker: Taker, peer: Peer
) -> None:
    door(peer)
    taker.source.configure(SUDDEN_CW)
    pattern = f"node /madrob/door refused {words}.*: set the opening side by hand"
    peer.until(lambda: re.fullmatch(pattern, taker.source.sides_problem or ""))


@pytest.mark.slow
def test_a_node_that_hangs_is_named_and_asked_again(taker: Taker, peer: Peer) -> None:
    deaf = door_node(peer, spun=False)
    taker.source.configure(SUDDEN_CW)
    peer.until(lambda: "does not answer" in (taker.source.sides_problem or ""))
    peer.end_node(deaf)
    door_node(peer)
    peer.until(lambda: taker.source.sides_problem is None)


HEADER = "std_msgs/msg/Header"
