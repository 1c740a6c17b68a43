from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from madrob_console.common.clock import NS, VirtualClock, nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.recorded_clock import TICK, RecordedClock
from madrob_console.messages.codec import describe_topic, referee_topics
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
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
TYPES = MessageTypes()
DOOR = DEFAULT_MAPPINGS[0]
OWN = "own_msgs/msg/Angle"


@pytest.fixture(scope="module")
def recorded() -> list[RawMessage]:
    """Two seconds of a run, with what its referee says."""
    clock = VirtualClock(START_NS)
    source = SimulatedSource(SimulatedTestbed(Scenario.NOMINAL), clock, TYPES)
    source.open()
    messages = [
        said.start_pose(StartPose(1.5, 0.0, 180.0), START_NS),
        said.state("countdown", seconds(START_NS) + 1.0, CONDITION, START_NS),
    ]
    for message in messages:
        source.publish(message)
    for number in range(40):
        messages += source.take_messages(0.05)
        if number % 10 == 0:
            messages.append(said.event(json.dumps({"line": number}), clock.now_ns()))
    return messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, recorded: list[RawMessage]) -> Path:
    topics = [describe_topic(TYPES, m.topic, m.type) for m in DEFAULT_MAPPINGS]
    return write(tmp_path_factory.mktemp("bags") / "run", recorded, topics)


def write(folder: Path, messages: list[RawMessage], topics: Sequence[Topic] = ()) -> Path:
    with BagWriter(folder, [*topics, *referee_topics(TYPES)], RECORDS) as writer:
        assert all(writer.put_message(message) for message in messages)
    return folder


def doors(folder: Path, *instants: int) -> Path:
    """A bag of nothing but door angles."""
    data = TYPES.encode(DOOR.type, TYPES.make(DOOR.type))
    messages = [RawMessage(DOOR.topic, DOOR.type, data, at, at) for at in instants]
    return write(folder, messages, [describe_topic(TYPES, DOOR.topic, DOOR.type)])


def replay(path: Path, speed: float = 0, types: MessageTypes | None = None) -> RecordedBag:
    now = 0.0

    def monotonic() -> float:
        return now

    def wait(duration: float) -> None:
        nonlocal now
        now += duration

    source = RecordedBag(path, types or MessageTypes(), speed, monotonic, wait)
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


@pytest.mark.parametrize("kept", [recorded_bag.MOST_KEPT, 10])
def test_it_begins_anew_as_often_as_it_is_opened_however_long_it_is(
    bag: Path, recorded: list[RawMessage], kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded_bag, "MOST_KEPT", kept)
    source = replay(bag)
    for _ in range(20):
        source.take_messages(0.02)
    for _ in range(2):
        source.clock.go_to(0)
        source.open()
        assert all_of(source) == of_the_testbed(recorded)


def test_what_the_console_said_is_kept_aside(bag: Path) -> None:
    source = replay(bag)
    assert [json.loads(line)["line"] for line in source.journal_lines] == [0, 10, 20, 30]
    assert source.problems == ()


def test_status_tells_what_the_recording_holds_and_what_it_lacks(bag: Path, tmp_path: Path) -> None:
    whole, door = replay(bag), replay(doors(tmp_path / "door", START_NS))
    for source, publishers in ((whole, 7), (door, 1)):
        source.expect(DEFAULT_MAPPINGS)
        assert {s.topic for s in source.status()} == {m.topic for m in DEFAULT_MAPPINGS}
        assert sum(s.publishers for s in source.status()) == publishers
    assert all(status.problem is None for status in whole.status())
    problems = {s.topic: s.problem for s in door.status()}
    assert problems["/madrob/door/angle"] is None
    assert problems["/madrob/handle/force"] == "not in the recording"
    assert problems["/madrob/door/locked"] is None  # not every testbed has a latch sensor
    whole.close()
    whole.close()
    assert all_of(whole) == []


def test_types_come_with_the_bag_and_one_that_differs_is_a_problem_of_its_topic(
    tmp_path: Path,
) -> None:
    own, others, same = MessageTypes(), MessageTypes(), MessageTypes()
    own.register(OWN, "float64 angle\n")
    others.register(OWN, "float32 angle\n")
    data = own.encode(OWN, own.make(OWN, angle=0.5))
    message = RawMessage("/own", OWN, data, START_NS, START_NS)
    path = write(tmp_path / "own", [message], [describe_topic(own, "/own", OWN)])
    assert all_of(replay(path, types=same)) == [message]
    assert same.decode(OWN, data).angle == 0.5
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
    line = RawMessage("/madrob/referee/event", "std_msgs/msg/String", b"\xff", START_NS, START_NS)
    source = RecordedBag(write(tmp_path / "bag", [line]), TYPES)
    assert source.journal_lines == []
    assert any("/madrob/referee/event" in problem for problem in source.problems)


def test_what_is_no_bag_or_no_run_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("no bag")
    refused = {
        tmp_path / "notes.mcap": "notes.mcap",
        tmp_path / "missing": "missing",
        write(tmp_path / "empty", []): "holds no messages",
        doors(tmp_path / "odd", 0, START_NS): "19676 days apart",
    }
    for path, words in refused.items():
        with pytest.raises(MadrobError, match=words) as told:
            RecordedBag(path, MessageTypes())
        assert "\n" not in str(told.value)


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
