from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from madrob_console.common.clock import NS, TICK, RecordedClock, VirtualClock, nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS, Decoder, describe_topic, referee_topics
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds import recorded_bag
from madrob_console.testbeds.recorded_bag import RecordedBag
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import RawMessage, Topic
from recorder.writer import BagWriter
from scoring.protocol import Condition, StartPose
from tests.madrob_console import said

START_NS = 1_700_000_000_000_000_000
CONDITION = Condition.from_number(1)
RECORDS = {"madrob_run": {"run": "{}"}}


@pytest.fixture
def types() -> MessageTypes:
    return MessageTypes()


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
        messages += source.take_messages(0.05)
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
        assert all(writer.put_message(message) for message in messages)
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
        messages += source.take_messages(0.02)
    return messages


def of_the_testbed(messages: list[RawMessage]) -> list[RawMessage]:
    return [m for m in messages if not m.topic.startswith("/madrob/referee/")]


@pytest.mark.parametrize("speed", [0, 1, 0.3, 50])
def test_what_the_testbed_sent_comes_again_unchanged(
    bag: Path, recorded: list[RawMessage], speed: float
) -> None:
    source, messages = replay(bag, speed), []
    while not source.clock.ended:
        before = source.clock.now_ns()
        taken = source.take_messages(0.02)
        now = source.clock.now_ns()
        assert now - before <= nanoseconds(0.02)
        assert all(m.receive_ns <= now for m in taken)
        assert now == before == source.begin_ns or all(m.receive_ns > before for m in taken)
        messages += taken
    assert messages == of_the_testbed(recorded)
    assert source.take_messages(0.02) == []


def test_it_begins_anew_as_often_as_it_is_opened(bag: Path, recorded: list[RawMessage]) -> None:
    source = replay(bag)
    for _ in range(50):
        source.take_messages(0.02)
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


def test_a_topic_that_was_not_recorded_is_named(types: MessageTypes, tmp_path: Path) -> None:
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


def test_types_come_with_the_bag(types: MessageTypes, tmp_path: Path) -> None:
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


def test_a_type_that_is_another_here_is_a_problem_of_its_topic(
    types: MessageTypes, tmp_path: Path
) -> None:
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


def test_a_journal_line_that_cannot_be_read_is_set_aside(
    types: MessageTypes, tmp_path: Path
) -> None:
    line = RawMessage("/madrob/referee/event", "std_msgs/msg/String", b"\xff", START_NS, START_NS)
    source = RecordedBag(write(tmp_path / "bag", [line], [], types), types)
    assert source.journal_lines == []
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


def test_a_bag_whose_times_make_no_sense_is_refused(types: MessageTypes, tmp_path: Path) -> None:
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


BEGIN_NS = 1_700_000_000_000_000_000
STOPS = [BEGIN_NS - 5, BEGIN_NS + 7, BEGIN_NS + 7, BEGIN_NS + nanoseconds(0.31), BEGIN_NS + 9 * NS]


class Player:
    """A recording of two seconds, in real time that passes only where somebody waits."""

    def __init__(self, speed: float = 1.0) -> None:
        self.real = 50.0
        self.clock = RecordedClock(
            BEGIN_NS, BEGIN_NS + 2 * NS, speed, lambda: self.real, self._wait
        )
        self.clock.stop_at(STOPS)

    def _wait(self, duration: float) -> None:
        self.real += duration

    def until(self, done: Callable[[], bool]) -> list[int]:
        """The instants on the way, as ns from the beginning, each once."""
        instants: list[int] = []
        while not done():
            self.clock.sleep(TICK)
            instant = self.clock.now_ns() - BEGIN_NS
            if instants[-1:] != [instant]:
                instants.append(instant)
        return instants


EVERY = sorted({*(n * nanoseconds(TICK) for n in range(101)), 7, nanoseconds(0.31)})
"""The instants of the recording; what lies before or behind it is none."""


@pytest.mark.parametrize("speed", [0, 0.3, 1, 40, 1000])
def test_the_instants_are_the_same_at_any_speed(speed: float) -> None:
    player = Player(speed)
    assert player.until(lambda: player.clock.ended) == EVERY


def test_a_jump_passes_every_instant_and_waits_for_none() -> None:
    player = Player()
    player.clock.go_to(60)
    before = player.real
    passed = player.until(lambda: player.clock.target is None)
    assert passed == [instant for instant in EVERY if instant <= 60 * nanoseconds(TICK)]
    assert player.real == before


def test_what_was_not_done_at_a_high_speed_is_not_caught_up_with_at_another() -> None:
    player = Player(1000)
    for _ in range(5):
        player.clock.sleep(TICK)
    assert player.clock.set_speed(1) is None
    ticks, before = player.clock.ticks, player.real
    player.until(lambda: player.real - before > 0.5)
    assert player.clock.ticks - ticks == pytest.approx(25, abs=2)
