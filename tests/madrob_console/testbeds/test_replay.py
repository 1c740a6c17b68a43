from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.clock import NS, VirtualClock, nanoseconds, seconds
from madrob_console.errors import MadrobError
from madrob_console.testbeds.messages import (
    DEFAULT_MAPPINGS,
    Decoder,
    MessageTypes,
    decode_text,
    describe_topic,
    referee_topics,
)
from madrob_console.testbeds.replay import ReplayClock, ReplaySource
from madrob_console.testbeds.simulated import SimulatedSource
from madrob_console.testbeds.simulation import Scenario, SimulatedTestbed
from madrob_console.testbeds.source import RefereeState, Source, SourceKind
from recorder.bag import Topic
from recorder.message import RawMessage
from recorder.writer import BagWriter
from scoring.protocol import Condition, StartPose

START_NS = 1_700_000_000_000_000_000
CONDITION = Condition.from_number(1)
RECORDS = {"madrob_run": {"run": "{}"}}


@pytest.fixture(scope="module")
def recorded() -> list[RawMessage]:
    clock = VirtualClock(START_NS)
    source = SimulatedSource(SimulatedTestbed(Scenario.NOMINAL), clock, MessageTypes())
    source.open()
    start = seconds(START_NS) + 1.0
    messages = source.announce_start_pose(StartPose(1.5, 0.0, 180.0))
    messages += source.announce_state(RefereeState("countdown", CONDITION, start, "{}"))
    for number in range(100):
        messages += source.take(0.05)
        if number % 25 == 0:
            messages += source.announce_event(json.dumps({"line": number}))
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


def replay(path: Path, speed: float = 0.0) -> ReplaySource:
    source = ReplaySource(path, MessageTypes(), speed)
    source.open()
    return source


def of_the_testbed(messages: list[RawMessage]) -> list[RawMessage]:
    return [m for m in messages if not m.topic.startswith("/madrob/referee/")]


def test_it_says_that_it_is_a_replay(bag: Path) -> None:
    source: Source = replay(bag)
    assert source.kind is SourceKind.REPLAY
    assert source.label == "REPLAY run"
    assert source.sides_problem is None
    source.configure(CONDITION)
    assert source.sides_problem is None


@pytest.mark.parametrize("period", [0.05, 0.013, 100.0])
def test_what_the_testbed_sent_comes_again_unchanged(
    bag: Path, recorded: list[RawMessage], period: float
) -> None:
    source, messages = replay(bag), []
    while not source.ended:
        before = source.clock.now_ns()
        taken = source.take(period)
        assert source.clock.now_ns() == before + nanoseconds(period)
        assert all(m.receive_ns <= source.clock.now_ns() for m in taken)
        messages += taken
    assert messages == of_the_testbed(recorded)
    assert source.take(1.0) == []


def test_time_begins_with_the_recording(bag: Path, recorded: list[RawMessage]) -> None:
    assert replay(bag).clock.now_ns() == min(message.receive_ns for message in recorded)


def test_what_the_console_said_is_kept_aside(bag: Path, recorded: list[RawMessage]) -> None:
    source = replay(bag)
    said = [m for m in recorded if m.topic == "/madrob/referee/event"]
    assert [line.time_ns for line in source.journal_lines] == [m.receive_ns for m in said]
    assert [json.loads(line.text)["line"] for line in source.journal_lines] == [0, 25, 50, 75]
    assert source.records["madrob_run"] == RECORDS["madrob_run"]
    assert source.problems == ()


def test_what_is_said_during_a_replay_can_be_recorded(bag: Path) -> None:
    source = replay(bag)
    (said,) = source.announce_event("again")
    assert decode_text(MessageTypes(), said.data) == "again"
    assert said.receive_ns == source.clock.now_ns()
    (state,) = source.announce_state(RefereeState("ready", CONDITION, None, "{}"))
    (pose,) = source.announce_start_pose(StartPose(1.0, 0.0, 0.0))
    known = {topic.name: topic.type for topic in source.topics()}
    assert all(known[m.topic] == m.type for m in (said, state, pose))


def test_status_tells_what_the_recording_holds(bag: Path) -> None:
    source = ReplaySource(bag, MessageTypes(), 0.0, DEFAULT_MAPPINGS)
    source.open()
    source.open()
    by_topic = {status.topic: status for status in source.status()}
    assert list(by_topic) == [mapping.topic for mapping in DEFAULT_MAPPINGS]
    assert all(status.publishers == 1 for status in by_topic.values())
    assert all(status.problem is None for status in by_topic.values())
    assert not source.ended
    source.close()
    source.close()
    assert source.ended
    assert all(status.publishers == 0 for status in source.status())
    assert source.take(10.0) == []


def test_a_topic_that_was_not_recorded_is_named(tmp_path: Path) -> None:
    types = MessageTypes()
    door = describe_topic(types, DEFAULT_MAPPINGS[0].topic, DEFAULT_MAPPINGS[0].type)
    data = types.encode(door.type, types.make(door.type))
    message = RawMessage(door.name, door.type, data, START_NS, START_NS)
    path = write(tmp_path / "door", [message], [door], types)
    problems = {
        s.topic: s.problem
        for s in ReplaySource(path, MessageTypes(), 0.0, DEFAULT_MAPPINGS).status()
    }
    assert problems["/madrob/door/angle"] is None
    assert problems["/madrob/handle/force"] == "not in the recording"


def test_types_come_with_the_bag(tmp_path: Path) -> None:
    types = MessageTypes()
    types.register("own_msgs/msg/Angle", "float64 angle\n")
    topic = describe_topic(types, "/own", "own_msgs/msg/Angle")
    data = types.encode(topic.type, types.make(topic.type, angle=0.5))
    path = write(
        tmp_path / "own", [RawMessage("/own", topic.type, data, START_NS, START_NS)], [topic], types
    )
    others = MessageTypes()
    source = ReplaySource(path, others, 0.0)
    source.open()
    (message,) = source.take(0.0)
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
    (status,) = ReplaySource(path, others, 0.0).status()
    assert "known with other fields" in (status.problem or "")


def test_a_torn_bag_is_played_as_far_as_it_goes(
    bag: Path, recorded: list[RawMessage], tmp_path: Path
) -> None:
    whole = (bag / "run_0.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: len(whole) * 3 // 4])
    source = replay(torn)
    assert source.problems
    messages = source.take(1000.0)
    assert messages == of_the_testbed(recorded)[: len(messages)]
    assert source.ended


def test_a_journal_line_that_cannot_be_read_is_set_aside(tmp_path: Path) -> None:
    types = MessageTypes()
    line = RawMessage("/madrob/referee/event", "std_msgs/msg/String", b"\xff", START_NS, START_NS)
    source = ReplaySource(write(tmp_path / "bag", [line], [], types), types, 0.0)
    assert source.journal_lines == ()
    assert any("/madrob/referee/event" in problem for problem in source.problems)


def test_what_is_no_bag_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("no bag")
    for path in (tmp_path / "notes.mcap", tmp_path / "missing"):
        with pytest.raises(MadrobError) as refused:
            ReplaySource(path, MessageTypes())
        assert "\n" not in str(refused.value)
        assert path.name in str(refused.value)


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "empty", [], [], MessageTypes())
    with pytest.raises(MadrobError, match="holds no messages"):
        ReplaySource(path, MessageTypes())


@pytest.mark.parametrize("speed", [-1.0, float("nan"), float("inf")])
def test_time_does_not_run_backwards(bag: Path, speed: float) -> None:
    with pytest.raises(MadrobError, match="use 0 or more"):
        ReplaySource(bag, MessageTypes(), speed)


class RealTime:
    """Real time for a test: it passes only where somebody waits or works."""

    def __init__(self) -> None:
        self.now = 50.0

    def monotonic(self) -> float:
        return self.now

    def wait(self, duration: float) -> None:
        self.now += duration


@pytest.mark.parametrize(("speed", "real"), [(1.0, 10.0), (4.0, 2.5), (0.0, 0.0)])
def test_a_replay_takes_its_share_of_real_time(speed: float, real: float) -> None:
    world = RealTime()
    clock = ReplayClock(START_NS, speed, world.monotonic, world.wait)
    for _ in range(200):
        clock.sleep(0.05)
    assert clock.now_ns() == START_NS + 10 * NS
    assert world.now - 50.0 == pytest.approx(real)


def test_a_replay_that_fell_behind_catches_up() -> None:
    world = RealTime()
    clock = ReplayClock(START_NS, 1.0, world.monotonic, world.wait)
    clock.sleep(1.0)
    world.now += 3.0  # the machine was busy
    clock.sleep(2.0)
    clock.sleep(2.0)
    assert world.now - 50.0 == pytest.approx(5.0)


def test_a_replayed_bag_decodes_to_the_same_samples(bag: Path, recorded: list[RawMessage]) -> None:
    live = Decoder(DEFAULT_MAPPINGS, MessageTypes())
    types = MessageTypes()
    source = ReplaySource(bag, types, 0.0)
    source.open()
    again = Decoder(DEFAULT_MAPPINGS, types)
    samples = [live.decode(message) for message in of_the_testbed(recorded)]
    assert [again.decode(message) for message in source.take(1000.0)] == samples
