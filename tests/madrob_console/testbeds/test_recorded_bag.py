from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.clock import VirtualClock, nanoseconds, seconds
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    Decoder,
    MessageTypes,
    describe_topic,
    referee_topics,
)
from madrob_console.testbeds import recorded_bag
from madrob_console.testbeds.recorded_bag import RecordedBag
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import Topic
from recorder.message import RawMessage
from recorder.writer import BagWriter
from scoring.protocol import Condition, StartPose
from tests.madrob_console import said

START_NS = 1_700_000_000_000_000_000
CONDITION = Condition.from_number(1)
RECORDS = {"madrob_run": {"run": "{}"}}


@pytest.fixture(scope="module")
def recorded() -> list[RawMessage]:
    clock = VirtualClock(START_NS)
    source = SimulatedSource(SimulatedTestbed(Scenario.NOMINAL), clock, MessageTypes())
    source.open()
    start = seconds(START_NS) + 1.0
    messages = [
        said.start_pose(StartPose(1.5, 0.0, 180.0), START_NS),
        said.state("countdown", start, CONDITION, START_NS),
    ]
    for message in messages:
        source.publish(message)
    for number in range(100):
        messages += source.take(0.05)
        if number % 25 == 0:
            messages.append(said.event(json.dumps({"line": number}), clock.now_ns()))
    return messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, recorded: list[RawMessage]) -> Path:
    types = MessageTypes()
    topics = [describe_topic(types, m.topic, m.type) for m in DEFAULT_MAPPINGS]
    return write(tmp_path_factory.mktemp("bags") / "run", recorded, topics, types)


def write(
    folder: Path, messages: list[RawMessage], topics: list[Topic], types: MessageTypes
) -> Path:
    with BagWriter(folder, [*topics, *referee_topics(types)], RECORDS) as writer:
        assert all(writer.put(message) for message in messages)
    return folder


def replay(path: Path, speed: float = 0) -> RecordedBag:
    now = 0.0

    def monotonic() -> float:
        return now

    def wait(duration: float) -> None:
        nonlocal now
        now += duration

    source = RecordedBag(path, MessageTypes(), speed, monotonic, wait)
    source.open()
    return source


def all_of(source: RecordedBag) -> list[RawMessage]:
    messages = []
    while not source.clock.ended:
        messages += source.take(0.02)
    return messages


def of_the_testbed(messages: list[RawMessage]) -> list[RawMessage]:
    return [m for m in messages if not m.topic.startswith("/madrob/referee/")]


def test_it_says_that_it_is_a_replay(bag: Path) -> None:
    source = replay(bag)
    assert source.kind is SourceKind.REPLAY
    assert source.label == "REPLAY run"


@pytest.mark.parametrize("speed", [0, 1, 0.3, 50])
def test_what_the_testbed_sent_comes_again_unchanged(
    bag: Path, recorded: list[RawMessage], speed: float
) -> None:
    source, messages = replay(bag, speed), []
    while not source.clock.ended:
        before = source.clock.now_ns()
        taken = source.take(0.02)
        now = source.clock.now_ns()
        assert now - before <= nanoseconds(0.02)
        assert all(m.receive_ns <= now for m in taken)
        assert now == before == source.begin_ns or all(m.receive_ns > before for m in taken)
        messages += taken
    assert messages == of_the_testbed(recorded)
    assert source.take(0.02) == []


def test_it_begins_anew_as_often_as_it_is_opened(bag: Path, recorded: list[RawMessage]) -> None:
    source = replay(bag)
    for _ in range(50):
        source.take(0.02)
    source.clock.go_to(0)
    source.open()
    assert all_of(source) == of_the_testbed(recorded)


def test_a_bag_too_long_for_the_memory_is_read_again(
    bag: Path, recorded: list[RawMessage], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded_bag, "MOST_KEPT", 10)
    source = replay(bag)
    for _ in range(2):
        assert all_of(source) == of_the_testbed(recorded)
        source.clock.go_to(0)
        source.open()


def test_it_knows_when_the_recording_begins_and_ends(bag: Path, recorded: list[RawMessage]) -> None:
    source = replay(bag)
    times = [message.receive_ns for message in recorded]
    assert (source.begin_ns, source.end_ns) == (min(times), max(times))


def test_what_the_console_said_is_kept_aside(bag: Path, recorded: list[RawMessage]) -> None:
    source = replay(bag)
    said = [m for m in recorded if m.topic == "/madrob/referee/event"]
    assert len(source.journal_lines) == len(said)
    assert [json.loads(line)["line"] for line in source.journal_lines] == [0, 25, 50, 75]
    assert source.records["madrob_run"] == RECORDS["madrob_run"]
    assert source.problems == ()


def test_status_tells_what_the_recording_holds(bag: Path) -> None:
    source = replay(bag)
    source.expect(DEFAULT_MAPPINGS)
    by_topic = {status.topic: status for status in source.status()}
    assert set(by_topic) == {mapping.topic for mapping in DEFAULT_MAPPINGS}
    assert all(status.publishers == 1 for status in by_topic.values())
    assert all(status.problem is None for status in by_topic.values())
    source.close()
    source.close()
    assert all_of(source) == []


def test_a_topic_that_was_not_recorded_is_named(tmp_path: Path) -> None:
    types = MessageTypes()
    door = describe_topic(types, DEFAULT_MAPPINGS[0].topic, DEFAULT_MAPPINGS[0].type)
    data = types.encode(door.type, types.make(door.type))
    message = RawMessage(door.name, door.type, data, START_NS, START_NS)
    path = write(tmp_path / "door", [message], [door], types)
    source = replay(path)
    source.expect(DEFAULT_MAPPINGS)
    problems = {s.topic: s.problem for s in source.status()}
    assert problems["/madrob/door/angle"] is None
    assert problems["/madrob/handle/force"] == "not in the recording"
    assert problems["/madrob/door/locked"] is None  # not every testbed has a latch sensor


def test_types_come_with_the_bag(tmp_path: Path) -> None:
    types = MessageTypes()
    types.register("own_msgs/msg/Angle", "float64 angle\n")
    topic = describe_topic(types, "/own", "own_msgs/msg/Angle")
    data = types.encode(topic.type, types.make(topic.type, angle=0.5))
    path = write(
        tmp_path / "own", [RawMessage("/own", topic.type, data, START_NS, START_NS)], [topic], types
    )
    others = MessageTypes()
    source = RecordedBag(path, others)
    source.open()
    (message,) = all_of(source)
    assert others.decode(message.type, message.data).angle == 0.5


def test_a_type_that_is_another_here_is_a_problem_of_its_topic(tmp_path: Path) -> None:
    types = MessageTypes()
    types.register("own_msgs/msg/Angle", "float64 angle\n")
    topic = describe_topic(types, "/own", "own_msgs/msg/Angle")
    path = write(
        tmp_path / "own",
        [RawMessage("/own", topic.type, bytes(12), START_NS, START_NS)],
        [topic],
        types,
    )
    others = MessageTypes()
    others.register("own_msgs/msg/Angle", "float32 angle\n")
    (status,) = RecordedBag(path, others).status()
    assert "known with other fields" in (status.problem or "")


def test_a_torn_bag_is_played_as_far_as_it_goes(
    bag: Path, recorded: list[RawMessage], tmp_path: Path
) -> None:
    whole = (bag / "run_0.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: len(whole) * 3 // 4])
    source = replay(torn)
    assert source.problems
    messages = all_of(source)
    assert messages == of_the_testbed(recorded)[: len(messages)]


def test_a_journal_line_that_cannot_be_read_is_set_aside(tmp_path: Path) -> None:
    types = MessageTypes()
    line = RawMessage("/madrob/referee/event", "std_msgs/msg/String", b"\xff", START_NS, START_NS)
    source = RecordedBag(write(tmp_path / "bag", [line], [], types), types)
    assert source.journal_lines == ()
    assert any("/madrob/referee/event" in problem for problem in source.problems)


def test_what_is_no_bag_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("no bag")
    for path in (tmp_path / "notes.mcap", tmp_path / "missing"):
        with pytest.raises(MadrobError) as refused:
            RecordedBag(path, MessageTypes())
        assert "\n" not in str(refused.value)
        assert path.name in str(refused.value)


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "empty", [], [], MessageTypes())
    with pytest.raises(MadrobError, match="holds no messages"):
        RecordedBag(path, MessageTypes())


def test_a_bag_whose_times_make_no_sense_is_refused(tmp_path: Path) -> None:
    types = MessageTypes()
    door = describe_topic(types, DEFAULT_MAPPINGS[0].topic, DEFAULT_MAPPINGS[0].type)
    data = types.encode(door.type, types.make(door.type))
    messages = [RawMessage(door.name, door.type, data, at, at) for at in (0, START_NS)]
    with pytest.raises(MadrobError, match="19676 days apart"):
        RecordedBag(write(tmp_path / "odd", messages, [door], types), MessageTypes())


def test_a_replayed_bag_decodes_to_the_same_samples(bag: Path, recorded: list[RawMessage]) -> None:
    live = Decoder(DEFAULT_MAPPINGS, MessageTypes())
    types = MessageTypes()
    source = RecordedBag(bag, types)
    source.open()
    again = Decoder(DEFAULT_MAPPINGS, types)
    samples = [live.decode(message) for message in of_the_testbed(recorded)]
    assert [again.decode(message) for message in all_of(source)] == samples
