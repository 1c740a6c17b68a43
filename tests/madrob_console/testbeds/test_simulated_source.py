from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from math import pi, sqrt
from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from madrob_console.common.clock import NS, Clock, SystemClock, VirtualClock, nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS, Decoder, TopicMapping
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.testbeds.evidence_choice import FlowMeter, RateLimit, SilenceWatch
from madrob_console.testbeds.simulated import (
    DoorGeometry,
    Network,
    RobotBody,
    RobotSettings,
    Scenario,
    SensorSettings,
    SimulatedTestbed,
)
from madrob_console.testbeds.simulated.simulated_source import FRAMES_TOPIC, SimulatedSource
from recorder.bag import Durability, RawMessage
from recorder.reader import read_bag
from scoring.events import EventDetector
from scoring.procedure import follow_procedure
from scoring.protocol import (
    Condition,
    Event,
    LockDetection,
    Outcome,
    Signal,
    StartPose,
    Strip,
    Thresholds,
)
from scoring.signals import DoorSample, HandleSample, LatchSample, PassageSample
from tests.madrob_console import said
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.testbeds.truth import truth_of_testbed

TYPES = MessageTypes()
START_NS = 1_700_000_000_000_000_000
CONDITION = Condition.from_number(1)


def simulated(
    scenario: Scenario = Scenario.NOMINAL,
    seed: int = 0,
    clock: Clock | None = None,
    sensors: SensorSettings | None = None,
    network: Network | None = None,
) -> SimulatedSource:
    testbed = SimulatedTestbed(scenario, seed, sensors=sensors, network=network)
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


def test_its_bytes_decode_to_the_samples_of_a_testbed_at_rest() -> None:
    source = simulated(sensors=SensorSettings(latch=True))
    decoder = Decoder(DEFAULT_MAPPINGS, TYPES)
    kinds = set()
    for message in source.take_messages(1.0):
        sample = decoder.decode(message)
        assert sample is not None
        kinds.add(sample.signal)
        assert sample.log_time == seconds(message.receive_ns)
        assert abs(sample.log_time - sample.time) < 0.005
        match sample:
            case DoorSample():
                assert sample.angle == 0.0
            case HandleSample():
                assert abs(sample.force - 5.9) < 0.3
            case PassageSample():
                assert all(abs(r - 2.0) < 0.02 for r in sample.ranges)
                assert sample.range_min < 0.05
                assert sample.range_max > 2.1
            case LatchSample():
                assert sample.engaged
    assert kinds == set(Signal)


def test_the_same_seed_gives_the_same_bytes_however_they_are_taken() -> None:
    def record(periods: list[float]) -> list[RawMessage]:
        source = simulated(Scenario.RANDOM, seed=11)
        source.publish(state("countdown", seconds(START_NS) + 1.0))
        return [message for period in periods for message in source.take_messages(period)]

    once = record([16.0])
    assert record([0.05] * 320) == once
    assert record([0.5, 7.25, 0.25, 8.0]) == once
    other = simulated(Scenario.RANDOM, seed=12)
    assert other.take_messages(0.1)[0].data != once[0].data


DOOR_TOPIC = "/madrob/door/angle"


def by_topic(network: Network | None) -> dict[str, list[RawMessage]]:
    """The messages of 12 s with a run, taken often; each comes once its time of arrival is over."""
    clock = VirtualClock(START_NS)
    source = simulated(Scenario.RANDOM, 11, clock, network=network)
    source.publish(state("countdown", seconds(START_NS) + 1.0))
    found = defaultdict(list)
    before = START_NS
    while clock.now_ns() < START_NS + nanoseconds(12.0):
        batch = source.take_messages(0.013)
        received = [message.receive_ns for message in batch]
        assert received == sorted(received)
        assert all(before < ns <= clock.now_ns() for ns in received)
        before = clock.now_ns()
        for message in batch:
            found[message.topic].append(message)
    return found


def test_latency_delays_the_messages_of_its_signals_and_changes_nothing_else() -> None:
    usual, slow = by_topic(None), by_topic(Network({Signal.DOOR: 0.05}))
    assert usual.keys() == slow.keys()
    for topic, messages in usual.items():
        late = nanoseconds(0.05) if topic == DOOR_TOPIC else 0
        due = [m for m in messages if m.receive_ns + late <= messages[-1].receive_ns]
        assert len(due) > 590
        for there, message in zip(slow[topic], due, strict=False):
            assert (there.data, there.publish_ns) == (message.data, message.publish_ns)
            assert there.receive_ns == message.receive_ns + late
        assert len(slow[topic]) == pytest.approx(len(due), abs=1)


@pytest.mark.parametrize("deviation", [0.002, 0.06])
def test_jitter_delays_at_random_and_no_message_overtakes_one_of_its_topic(
    deviation: float,
) -> None:
    usual = by_topic(None)
    slow = by_topic(Network({Signal.HANDLE: 0.05}, dict.fromkeys(Signal, deviation)))
    for topic, messages in slow.items():
        least = nanoseconds(0.05) if topic == "/madrob/handle/force" else 0
        received = [m.receive_ns for m in messages]
        assert all(a < b for a, b in pairwise(received))
        sent = usual[topic][: len(messages)]
        assert [(m.data, m.publish_ns) for m in messages] == [(m.data, m.publish_ns) for m in sent]
        late = [m.receive_ns - s.receive_ns - least for m, s in zip(messages, sent, strict=True)]
        assert min(late) >= 0
        assert max(late) > nanoseconds(2 * deviation)
        if deviation < 0.01:  # none waits for the one before
            mean = seconds(sum(late)) / len(late)
            assert mean == pytest.approx(deviation * sqrt(2 / pi), rel=0.15)
    assert by_topic(Network({Signal.HANDLE: 0.05}, dict.fromkeys(Signal, deviation))) == slow


def run(
    source: SimulatedSource, clock: Clock, timeout: float
) -> tuple[tuple[Event, ...], Outcome, int]:
    """A run as the engine makes it: the events and the steps that the detector finds."""
    start = seconds(clock.now_ns()) + 1.5
    source.publish(state("countdown", start, _condition(source)))
    decoder, zero = Decoder(DEFAULT_MAPPINGS, TYPES), source.testbed.sensors.handle_offset
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


def check_detection(source: SimulatedSource, clock: Clock, timeout: float) -> None:
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
        assert -0.002 < event.time - really.time < 0.026, event.name


@pytest.mark.parametrize("scenario", [s for s in Scenario if s is not Scenario.RANDOM])
@pytest.mark.parametrize("number", [2, 8])
def test_a_detector_finds_the_truth_within_a_sample(scenario: Scenario, number: int) -> None:
    clock = VirtualClock(START_NS)
    source = simulated(scenario, seed=number, clock=clock)
    source.configure(Condition.from_number(number))
    check_detection(source, clock, timeout=45.0 if scenario is Scenario.SLOW else 22.0)


def test_a_detector_finds_the_truth_of_every_robot() -> None:
    check_robots(range(2))


@pytest.mark.slow
def test_a_detector_finds_the_truth_of_many_robots(request: pytest.FixtureRequest) -> None:
    """With `--runs 20` sixty."""
    check_robots(range(2, 2 + 3 * request.config.getoption("--runs")))


def check_robots(seeds: range) -> None:
    for seed in seeds:
        clock = VirtualClock(START_NS)
        sensors = SensorSettings(latch=seed % 3 == 2)
        source = simulated(Scenario.RANDOM, seed, clock, sensors)
        source.configure(Condition.from_number(1 + 7 * seed % 20))
        check_detection(source, clock, timeout=50.0)


def test_the_robot_sets_out_when_the_run_starts_and_returns_for_the_next() -> None:
    clock = VirtualClock(START_NS)
    source = simulated(clock=clock, sensors=SensorSettings(handle_noise=0.0))
    decoder = Decoder(DEFAULT_MAPPINGS, TYPES)

    def angles(duration: float) -> list[float]:
        samples = [decoder.decode(message) for message in source.take_messages(duration)]
        return [s.angle for s in samples if isinstance(s, DoorSample)]

    assert truth_of_testbed(source.testbed) is None
    source.publish(state("ready"))
    assert set(angles(3.0)) == {0.0}
    start = seconds(clock.now_ns()) + 5.0
    source.publish(state("countdown", start))
    assert set(angles(5.0)) == {0.0}
    source.publish(state("running", start))
    assert max(angles(7.0)) > 1.0
    first = truth_of_testbed(source.testbed)
    assert first is not None
    source.publish(state("stopped", start))
    source.publish(state("final", start))
    source.publish(state("ready"))
    assert truth_of_testbed(source.testbed) is None
    assert set(angles(1.0)) == {0.0}
    source.publish(state("countdown", start + 60.0))
    second = truth_of_testbed(source.testbed)
    assert second is not None
    assert second.stop - first.stop != pytest.approx(60.0, abs=1e-6), "another repetition"


def test_a_restarted_countdown_moves_the_robot_s_start() -> None:
    source = simulated()
    start = seconds(START_NS) + 5.0
    source.publish(state("countdown", start))
    first = truth_of_testbed(source.testbed)
    source.publish(state("countdown", start + 30.0))
    moved = truth_of_testbed(source.testbed)
    assert first is not None
    assert moved is not None
    assert moved.stop - first.stop == pytest.approx(30.0, abs=1e-6)


def test_the_robot_starts_where_the_referee_sends_it() -> None:
    source = simulated()
    source.publish(said.start_pose(StartPose(2.25, 0.0, 180.0)))
    source.publish(state("countdown", seconds(START_NS)))
    assert source.testbed.plan is not None
    assert source.testbed.plan.robot.initial == 2.25
    source.publish(state("ready"))
    source.publish(said.start_pose(StartPose(0.2, 0.0, 180.0)))
    source.publish(state("countdown", seconds(START_NS)))
    assert source.testbed.plan.robot.initial > 0.45, "never under the sensors"


def test_status_tells_which_topics_speak() -> None:
    source = SimulatedSource(None, VirtualClock(START_NS), TYPES)
    assert {status.publishers for status in source.status()} == {0}
    assert source.take_messages(1.0) == []
    source.open()
    source.open()
    assert [status.topic for status in source.status()] == [
        mapping.topic for mapping in DEFAULT_MAPPINGS if mapping.signal is not Signal.LATCH
    ]
    assert {status.publishers for status in source.status()} == {1}
    source.close()
    source.close()
    assert source.take_messages(1.0) == []


def test_a_robot_that_cannot_be_played_shows_as_a_problem() -> None:
    testbed = SimulatedTestbed(robot=RobotSettings(RobotBody(height=0.51)))
    source = SimulatedSource(testbed, VirtualClock(START_NS), TYPES)
    source.open()
    source.publish(state("countdown", seconds(START_NS)))
    assert all("no clear run" in (status.problem or "") for status in source.status())
    assert len(source.take_messages(1.0)) > 250


def test_a_testbed_configured_otherwise_is_simulated_as_configured() -> None:
    TYPES.register("sim_msgs/msg/Raw", "int32 grams\nfloat32[4] heights\nbool open\n")
    mappings = (
        TopicMapping(Signal.DOOR, "/d", "std_msgs/msg/Float64", "data", scale=0.5),
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


@pytest.mark.machine
def test_in_real_time_messages_come_as_time_passes() -> None:
    clock = SystemClock()
    clock.hold_steady()
    began = time.monotonic()
    messages = simulated(clock=clock).take_messages(0.2)
    took = time.monotonic() - began
    assert 0.2 <= took < 2.0
    passed = seconds(messages[-1].receive_ns - messages[0].receive_ns)
    assert 0.15 < passed <= took
    assert len(messages) == pytest.approx(6 + passed * 300, rel=0.1, abs=6)
    assert all(m.receive_ns <= clock.now_ns() for m in messages)


class Stepped(VirtualClock):
    offset = 0

    def now_ns(self) -> int:
        return super().now_ns() + self.offset


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
@pytest.mark.parametrize("network", [Network(), Network(dict.fromkeys(Signal, 0.02))])
def test_a_stepped_clock_neither_floods_nor_silences(step: float, network: Network) -> None:
    clock = Stepped(START_NS)
    source = simulated(clock=clock, network=network)
    source.take_messages(1.0)
    clock.offset = nanoseconds(step)
    source.take_messages(0.02)
    messages = source.take_messages(1.0)
    assert len(messages) == pytest.approx(300, abs=12)
    assert abs(seconds(messages[-1].receive_ns - clock.now_ns())) < 0.1


def test_what_was_under_way_when_the_clock_was_put_back_never_arrives() -> None:
    clock = Stepped(START_NS)
    source = simulated(clock=clock, network=Network({Signal.DOOR: 0.5}))
    source.take_messages(1.0)
    clock.offset = nanoseconds(-5.0)
    source.take_messages(0.02)
    stamps = [m.publish_ns for m in source.take_messages(8.0) if m.topic == DOOR_TOPIC]
    assert len(stamps) > 300
    assert all(b - a > nanoseconds(0.01) for a, b in pairwise(stamps)), "once each"


STRIPS = {m.topic: strip for strip in Strip for m in DEFAULT_MAPPINGS
          if m.signal is Signal.of_strip(strip)}  # fmt: skip
Vector = NDArray[np.float64]


def turned(rotation: Message, vector: Vector) -> Vector:
    """A vector turned by a quaternion."""
    axis = np.array([rotation.x, rotation.y, rotation.z])
    twice = 2 * np.cross(axis, vector)
    return np.asarray(vector + rotation.w * twice + np.cross(axis, twice), float)


def transforms(messages: list[Message]) -> dict[str, Message]:
    """The transforms of the only message of them, by frame."""
    (message,) = messages
    return {stamped.child_frame_id: stamped for stamped in message.transforms}


@pytest.mark.parametrize("hinge_left", [True, False])
def test_each_ray_of_a_scan_meets_the_ground_below_its_sensor(hinge_left: bool) -> None:
    geometry = DoorGeometry(hinge_left=hinge_left)
    source = SimulatedSource(SimulatedTestbed(geometry=geometry), VirtualClock(START_NS), TYPES)
    source.open()
    found = transforms([TYPES.decode(m.type, m.data) for m in source.announcement.messages])
    scans = {
        m.topic: TYPES.decode(m.type, m.data)
        for m in source.take_messages(0.1)
        if m.topic in STRIPS
    }
    assert set(scans) == set(STRIPS)
    for topic, scan in scans.items():
        stamped = found[scan.header.frame_id]
        assert stamped.header.frame_id == "madrob_door"
        assert scan.angle_max == pytest.approx(scan.angle_min + 3 * scan.angle_increment)
        place = stamped.transform.translation
        origin = np.array([place.x, place.y, place.z])
        for mount in (m for m in geometry.mounts if m.strip is STRIPS[topic]):
            angle = scan.angle_min + mount.element * scan.angle_increment
            ray = turned(
                stamped.transform.rotation, np.array([math.cos(angle), math.sin(angle), 0.0])
            )
            ground = origin + ray * (geometry.lintel_height / -ray[2])
            y = geometry.doorway_width / 2 - mount.reach
            expected = [mount.x, y if hinge_left else -y, 0.0]
            assert ground == pytest.approx(expected, abs=0.002)


def test_a_recording_has_a_frame_in_every_message_and_all_of_them_hang_on_the_door() -> None:
    bag = read_bag(completed())
    messages = [(m.topic, m.receive_ns, TYPES.decode(m.type, m.data)) for m in bag.messages()]
    found = transforms([message for topic, _, message in messages if topic == FRAMES_TOPIC])
    assert {stamped.header.frame_id for stamped in found.values()} == {"madrob_door"}
    named = {message.header.frame_id for _, _, message in messages if hasattr(message, "header")}
    assert named == {"madrob_door", *found}
    (topic,) = (topic for topic in bag.topics() if topic.name == FRAMES_TOPIC)
    assert topic.qos.durability is Durability.TRANSIENT_LOCAL
    assert topic.type_hash.startswith("RIHS01_")
    begin = min(received for _, received, _ in messages)
    told = next(received for topic, received, _ in messages if topic == FRAMES_TOPIC)
    assert seconds(told - begin) < 0.1


@pytest.mark.parametrize(("sent", "most"), [(30.0, 10.0), (30.0, 20.0), (1000.0, 15.0), (16, 15)])
def test_a_faster_topic_is_thinned_to_the_rate_of_the_settings(sent: float, most: float) -> None:
    rate_limit = RateLimit(most)
    passed = [rate_limit.passes(round(number / sent * NS)) for number in range(round(sent * 60))]
    assert sum(passed) / 60 == pytest.approx(most, rel=0.04)
    later = passed[round(sent * 30) :]
    assert sum(later) / 30 == pytest.approx(most, rel=0.025)


def test_a_camera_of_15_hz_with_jitter_loses_nothing_by_a_limit_of_15() -> None:
    random = Random(7)
    rate_limit = RateLimit(15.0)
    came = sorted(number / 15.01 + random.gauss(0, 0.01) for number in range(15 * 3600))
    assert all(rate_limit.passes(round((1 + at) * NS)) for at in came)


def test_without_a_rate_everything_passes_and_a_clock_that_goes_back_stops_nothing() -> None:
    assert all(RateLimit(None).passes(at) for at in (5, 5, 4, 9))
    rate_limit = RateLimit(1.0)
    passed = [at for at in range(100, 110) for _ in range(3) if rate_limit.passes(at * NS)]
    assert len(passed) == 11
    passed = [at for at in range(7, 17) for _ in range(3) if rate_limit.passes(at * NS)]
    assert len(passed) == 11


def test_rates_are_those_of_the_last_seconds() -> None:
    meter = FlowMeter(0.0)
    for number in range(300):
        meter.count([RawMessage("/a", "a/msg/B", bytes(1000), 0, 0)], number / 30)
    rate, byte_rate = meter.rates(10.0)
    assert rate == pytest.approx(30, rel=0.05)
    assert byte_rate == pytest.approx(30_000, rel=0.05)
    assert meter.rates(12.5)[0] == pytest.approx(15, rel=0.05)
    assert meter.rates(20.0) == (0.0, 0.0)


STEADY = [number / 10 for number in range(50)]  # until 4.9 s


@pytest.mark.parametrize(
    ("came", "now", "since"),
    [
        (STEADY, 6.8, None),
        (STEADY, 7.0, 4.9),
        ([*STEADY, *(9 + at for at in STEADY)], 14.0, None),
        ([*STEADY, 9.0], 12.0, 9.0),
        ([], 1000.0, None),
        ([0.0], 1000.0, None),
        ([0.1 * n for n in range(15)], 1000.0, None),
        ([0.0, 30.0, 60.0, 90.0], 1000.0, None),
    ],
)
def test_a_camera_that_stops_is_silent_and_what_comes_now_and_then_is_not(
    came: Sequence[float], now: float, since: float | None
) -> None:
    watch = SilenceWatch()
    for at in came:
        watch.came(round(at * NS))
    assert watch.silent_since(round(now * NS)) == since


def test_what_the_settings_name_may_not_be_silent_from_the_first() -> None:
    for named, problem in ((True, "nothing has come"), (False, "")):
        watch = SilenceWatch(named=named)
        assert watch.problem(9 * NS) == ""  # nobody listens yet
        for at in range(4, 9):
            watch.listen(at * NS)
        assert watch.problem(6 * NS) == ""
        assert watch.problem(7 * NS) == problem
        watch.came(7 * NS)
        assert watch.problem(100 * NS) == ""
