from __future__ import annotations

from itertools import pairwise
from random import Random
from statistics import mean, stdev

import pytest

from madrob_console.common.clock import NS, Clock, VirtualClock, nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import Decoder
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.simulated import (
    DoorGeometry,
    Scenario,
    SensorSettings,
    SimulatedTestbed,
)
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import RawMessage
from scoring.events import EventDetector
from scoring.procedure import follow_procedure
from scoring.protocol import (
    Condition,
    Event,
    EventName,
    LockDetection,
    Outcome,
    Signal,
    StartPose,
    Thresholds,
)
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample
from tests.madrob_console import said
from tests.madrob_console.robots import Played, Robot, any_testbed, is_clear_cut
from tests.madrob_console.testbeds.truth import STEP, Truth, truth_of_testbed

TYPES = MessageTypes()
START_NS = 1_700_000_000_000_000_000
CONDITION = Condition.from_number(1)
NOISELESS = DoorGeometry(thresholds=Thresholds(encoder_noise=0.0))
"""Its encoder's noise would move the edge of a slow panel by some milliseconds."""


def simulated(
    scenario: Played = Scenario.NOMINAL,
    seed: int = 0,
    clock: Clock | None = None,
    sensors: SensorSettings | None = None,
    geometry: DoorGeometry | None = None,
) -> SimulatedSource:
    testbed = any_testbed(scenario, seed, geometry, sensors)
    source = SimulatedSource(testbed, clock or VirtualClock(START_NS), TYPES)
    source.open()
    return source


def state(phase: str, start: float | None = None, condition: Condition = CONDITION) -> RawMessage:
    return said.state(phase, start, condition)


def test_every_topic_comes_at_its_rate_in_the_order_of_reception() -> None:
    clock = VirtualClock(START_NS)
    source = simulated(clock=clock, sensors=SensorSettings(latch=True))
    taken = [source.take_messages(0.05) for _ in range(200)]
    assert clock.now_ns() == START_NS + 10 * NS
    messages = [message for batch in taken for message in batch]
    received = [message.receive_ns for message in messages]
    assert received == sorted(received)
    for i, batch in enumerate(taken):
        edge = START_NS + i * nanoseconds(0.05)
        assert all(edge < m.receive_ns <= edge + nanoseconds(0.05) for m in batch)
    for topic in {mapping.topic for mapping in DEFAULT_MAPPINGS}:
        stamps = [m.publish_ns for m in messages if m.topic == topic]
        assert len(stamps) == pytest.approx(500, abs=1)
        intervals = [(b - a) / NS for a, b in pairwise(stamps)]
        assert sum(intervals) / len(intervals) == pytest.approx(0.02, abs=1e-4)
        spread = (sum((i - 0.02) ** 2 for i in intervals) / len(intervals)) ** 0.5
        assert spread == pytest.approx(0.0008 * 2**0.5, rel=0.15)
    assert all(0 < m.receive_ns - m.publish_ns < 0.005 * NS for m in messages)


def test_the_same_seed_gives_the_same_bytes_however_they_are_taken() -> None:
    def record(periods: list[float]) -> list[RawMessage]:
        source = simulated(Robot.RANDOM, seed=11)
        source.publish(state("countdown", seconds(START_NS) + 1.0))
        return [message for period in periods for message in source.take_messages(period)]

    once = record([16.0])
    assert record([0.05] * 320) == once
    assert record([0.5, 7.25, 0.25, 8.0]) == once
    other = simulated(Robot.RANDOM, seed=12)
    assert other.take_messages(0.1)[0].data != once[0].data


DOOR_TOPIC = "/madrob/door/angle"


def run(
    source: SimulatedSource, clock: Clock, timeout: float
) -> tuple[tuple[Event, ...], Outcome, int]:
    """A run as the engine makes it: the events and the steps that the detector finds."""
    start = seconds(clock.now_ns()) + 1.5
    source.publish(state("countdown", start, _condition(source)))
    decoder, zero = Decoder(DEFAULT_MAPPINGS, TYPES), source.testbed.sensors.handle_rest[0]
    detector = EventDetector(_condition(source), start, Thresholds(), handle_zero=zero)
    settle, stop, outcome = Thresholds().settle_time, start + timeout, Outcome.TIMEOUT
    while seconds(clock.now_ns()) < start + timeout + settle + 0.2:
        _feed(detector, decoder, source.take_messages(0.05))
        live = follow_procedure(
            detector.evidence(), lock_detection=LockDetection.AUTO, settle_time=settle
        )
        if live.completed is not None and live.completed <= start + timeout:
            stop, outcome = live.completed, Outcome.COMPLETED
            break
    _feed(detector, decoder, source.take_messages(1.0))
    steps = follow_procedure(
        detector.evidence(stop), lock_detection=LockDetection.AUTO, settle_time=settle
    )
    return detector.events(stop), outcome, steps.level


def _condition(source: SimulatedSource) -> Condition:
    return source.testbed.condition or CONDITION


def _feed(detector: EventDetector, decoder: Decoder, messages: list[RawMessage]) -> None:
    for message in messages:
        sample = decoder.decode(message)
        assert sample is not None
        detector.feed(sample)


def check_run(source: SimulatedSource, clock: Clock, timeout: float) -> Truth:
    """The detector finds what truly happens, within a sample."""
    events, outcome, level = run(source, clock, timeout)
    truth = truth_of_testbed(source.testbed, timeout)
    assert truth is not None
    assert outcome is truth.outcome
    assert level == truth.capability_level
    found = sorted(events, key=lambda e: (e.name, e.time))
    true = sorted(truth.events, key=lambda e: (e.name, e.time))
    assert [e.name for e in found] == [e.name for e in true]
    for event, really in zip(found, true, strict=True):
        # one period and its jitter; the noise of the force may bring the touch forward
        assert -0.002 - STEP < event.time - really.time < 0.026, event.name
    return truth


THROUGH = "touch open approach arrive close"
STORIES = {
    Scenario.NOMINAL: (6, THROUGH),
    Robot.JERKY: (6, THROUGH),
    Scenario.SLAM: (6, THROUGH),
    Scenario.SLOW: (6, THROUGH),
    Scenario.NO_TOUCH: (0, THROUGH.removeprefix("touch ")),
    Scenario.TOUCH_ONLY: (1, "touch"),
    Robot.OPEN_ONLY: (3, "touch open"),
    Robot.NO_CLOSE: (4, THROUGH.removesuffix(" close")),
    Robot.TURNS_BACK: (3, "touch open approach return"),
    Robot.CLOSES_UNDER_SENSORS: (6, "touch open approach close arrive"),
    Robot.BOUNCES: (6, f"{THROUGH} open close"),
    Scenario.WORN: (6, THROUGH),
}
"""How many steps are done, and what happens; the door behind who turns back is a pulled one."""


@pytest.mark.parametrize("scenario", STORIES)
def test_a_scenario_gets_as_far_as_its_name_says_and_a_detector_finds_it(
    scenario: Played,
) -> None:
    level, story = STORIES[scenario]
    # pulled and pushed, open to either side
    condition = Condition.from_number((2, 8, 19, 13)[list(STORIES).index(scenario) % 4])
    words = {
        EventName.HANDLE_IS_TOUCHED: "touch",
        EventName.DOOR_OPENS: "open",
        EventName.DOOR_CLOSES: "close",
        EventName.approaches(condition.starting_side): "approach",
        EventName.moves_to(condition.destination_side): "arrive",
        EventName.moves_to(condition.starting_side): "return",
    }
    clock = VirtualClock(START_NS)
    source = simulated(scenario, condition.number, clock, geometry=NOISELESS)
    truth = check_run(source, clock, timeout_after(source, condition))
    assert truth.capability_level == level
    told = " ".join(words[event.name] for event in truth.events[1:-1])
    assert told == story


def timeout_after(source: SimulatedSource, condition: Condition, seed: int | None = None) -> float:
    """Of a run that is announced now: when nothing moves any more, or at random within it, s."""
    source.configure(condition)
    source.publish(state("countdown", seconds(START_NS) + 1.5, condition))
    assert source.testbed.plan is not None
    end = source.testbed.plan.end
    return end + 2.0 if seed is None else Random(seed).uniform(2.0, end)


def test_a_detector_finds_the_truth_of_every_robot() -> None:
    check_robots(range(1, 3))


@pytest.mark.slow
def test_a_detector_finds_the_truth_of_many_robots(request: pytest.FixtureRequest) -> None:
    """With `--runs 20` forty."""
    check_robots(range(3, 3 + 2 * request.config.getoption("--runs")))


def check_robots(seeds: range) -> None:
    """After the run, and at a time within it where samples can tell what comes first."""
    checked = 0
    for seed in seeds:
        for within in (None, seed):
            clock = VirtualClock(START_NS)
            sensors = SensorSettings(latch=seed % 3 == 2)
            source = simulated(Robot.RANDOM, seed, clock, sensors, geometry=NOISELESS)
            timeout = timeout_after(source, Condition.from_number(1 + 7 * seed % 20), within)
            plan = source.testbed.plan
            assert plan is not None
            if is_clear_cut(plan, source.testbed.geometry, timeout):
                check_run(source, clock, timeout)
                checked += 1
    assert checked > len(seeds)


def test_the_robot_sets_out_when_the_run_starts_and_returns_for_the_next() -> None:
    clock = VirtualClock(START_NS)
    source = simulated(clock=clock, sensors=SensorSettings(handle_noise=0.0))
    testbed, decoder = source.testbed, Decoder(DEFAULT_MAPPINGS, TYPES)

    def angles(duration: float) -> list[float]:
        samples = [decoder.decode(message) for message in source.take_messages(duration)]
        return [s.angle for s in samples if isinstance(s, DoorSample)]

    source.publish(state("ready"))
    assert is_shut(angles(3.0))
    start = seconds(clock.now_ns()) + 5.0
    for announced in (start + 2.0, start):  # another countdown moves the start
        source.publish(state("countdown", announced))
    first = testbed.plan
    assert is_shut(angles(5.0))
    source.publish(state("running", start))
    assert max(angles(7.0)) > 1.0
    for phase, at in (("stopped", start), ("final", start), ("ready", None)):
        assert testbed.plan is first
        source.publish(state(phase, at))
    assert testbed.plan is None
    assert is_shut(angles(1.0))
    source.publish(state("countdown", start + 60.0))
    assert testbed.plan not in (None, first), "another repetition"


def is_shut(angles: list[float]) -> bool:
    """Whether no reading is off by more than a count of the encoder."""
    return max(map(abs, angles)) < 1.5 * Thresholds().encoder_count


@pytest.mark.parametrize(
    ("scenario", "rests", "zeros", "lost"),
    [
        (Scenario.NOMINAL, (5.9, 5.4), (0.0, 0.0), False),
        (Scenario.WORN, (5.9, 0.4), (-0.004, -0.0005), True),
    ],
)
def test_the_sensors_read_what_those_of_the_real_door_do(
    scenario: Played, rests: tuple[float, float], zeros: tuple[float, float], *, lost: bool
) -> None:
    """As in the published recordings of 2020 (sections 3 and 4)."""
    source = simulated(scenario)
    start = seconds(START_NS) + 2.0
    source.publish(state("countdown", start))
    assert source.testbed.plan is not None
    decoder = Decoder(DEFAULT_MAPPINGS, TYPES)
    samples = [decoder.decode(m) for m in source.take_messages(source.testbed.plan.end + 12.0)]
    forces = [(s.time, s.force) for s in samples if isinstance(s, HandleSample)]
    angles = [(s.time, s.angle) for s in samples if isinstance(s, DoorSample)]
    for rest, zero, since in zip(rests, zeros, (start - 2.0, forces[-1][0] - 2.0), strict=True):
        force, angle = ([v for t, v in of if since < t < since + 2.0] for of in (forces, angles))
        assert mean(force) == pytest.approx(rest, abs=0.02)
        assert stdev(force) == pytest.approx(0.02, rel=0.3)
        assert mean(angle) == pytest.approx(zero, abs=0.00025)
        assert 0 < stdev(angle) < 0.0006
    resolution = {round(angle * 1e3, 2) % 1 for _, angle in angles if abs(angle) < 0.1}
    assert resolution == {0}
    sizes = [abs(force - rests[1]) for _, force in forces]
    top = sizes.index(max(sizes))
    assert 55 < sizes[top] < 80
    held = [size for size in sizes[top - 5 : top + 8] if size > 0.4 * sizes[top]]
    assert 4 <= len(held) <= 6, "a knock, no spike"
    gaps = [b - a for (a, _), (b, _) in pairwise(forces + angles) if b - a > 0.03]
    assert bool(gaps) == lost
    assert all(gap < 0.05 for gap in gaps)


@pytest.mark.parametrize(("x", "initial"), [(2.25, 2.25), (0.2, 0.545)], ids=["far", "near"])
def test_the_robot_starts_where_the_referee_sends_it_and_never_under_the_sensors(
    x: float, initial: float
) -> None:
    source = simulated()
    source.publish(said.start_pose(StartPose(x, 0.0, 180.0)))
    source.publish(state("countdown", seconds(START_NS)))
    assert source.testbed.plan is not None
    assert source.testbed.plan.robot.initial == initial


@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("std_msgs/msg/Float64", "data"),
        ("sensor_msgs/msg/JointState", "position[2]"),
        ("sensor_msgs/msg/JointState", "position[name=hinge]"),
    ],
)
def test_a_testbed_configured_otherwise_is_simulated_as_configured(
    type_name: str, field: str
) -> None:
    TYPES.register("sim_msgs/msg/Raw", "int32 grams\nfloat32[4] heights\nbool open\n")
    mappings = (
        TopicMapping(Signal.DOOR, "/d", type_name, field, scale=0.5),
        TopicMapping(Signal.HANDLE, "/h", "sim_msgs/msg/Raw", "grams", scale=0.00980665),
        TopicMapping(Signal.CW_LEFT, "/s", "sim_msgs/msg/Raw", "heights", scale=-1.0, offset=2.0),
        TopicMapping(Signal.CCW_LEFT, "/l", "sensor_msgs/msg/LaserScan", "ranges", scale=0.001),
        TopicMapping(Signal.LATCH, "/o", "sim_msgs/msg/Raw", "open", scale=-1.0, offset=1.0),
    )
    testbed = SimulatedTestbed(sensors=SensorSettings(latch=True))
    source = SimulatedSource(testbed, VirtualClock(START_NS), TYPES, mappings)
    source.open()
    source.publish(state("countdown", seconds(START_NS)))
    decoder = Decoder(mappings, TYPES)
    samples = [decoder.decode(message) for message in source.take_messages(6.0)]
    assert max(s.angle for s in samples if isinstance(s, DoorSample)) > 1.0
    assert abs(next(s.force for s in samples if isinstance(s, HandleSample)) - 5.9) < 0.3
    assert {s.engaged for s in samples if isinstance(s, LatchSample)} == {True, False}
    for sample in samples:
        if isinstance(sample, PassageSample):
            assert all(sample.range_min < r < sample.range_max for r in sample.ranges)


@pytest.mark.parametrize(
    ("type_name", "field", "words"),
    [
        ("sensor_msgs/msg/JointState", "position", "position of .* is not one number; correct"),
        ("sensor_msgs/msg/MultiDOFJointState", "wrench[0].force.x", "/d cannot be simulated"),
    ],
)
def test_what_cannot_be_simulated_is_refused(type_name: str, field: str, words: str) -> None:
    mapping = TopicMapping(Signal.DOOR, "/d", type_name, field)
    with pytest.raises(MadrobError, match=words):
        SimulatedSource(None, VirtualClock(START_NS), TYPES, [mapping])


class Stepped(VirtualClock):
    offset = 0

    def now_ns(self) -> int:
        return super().now_ns() + self.offset


@pytest.mark.parametrize("step", [-3600.0, 3600.0, -5.0])
def test_a_stepped_clock_neither_floods_nor_silences_and_sends_nothing_twice(step: float) -> None:
    clock = Stepped(START_NS)
    source = simulated(clock=clock)
    source.take_messages(1.0)
    clock.offset = nanoseconds(step)
    source.take_messages(0.02)
    source.take_messages(1.0)
    messages = source.take_messages(6.0)
    assert len(messages) == pytest.approx(6 * 300, abs=40)
    assert abs(seconds(messages[-1].receive_ns - clock.now_ns())) < 0.1
    stamps = [m.publish_ns for m in messages if m.topic == DOOR_TOPIC]
    assert all(b - a > nanoseconds(0.01) for a, b in pairwise(stamps)), "once each"
