from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.common.clock import NS, SystemClock
from madrob_console.engine.core import Engine
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.engine.observation import CAPACITY, LATEST, Backlog
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping, describe_topic
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Abort, DeclareTimeout, Start
from madrob_console.referee.run import Phase
from madrob_console.testbeds.ros import ros_source
from madrob_console.testbeds.ros.intake import Received
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import RawMessage
from scoring.protocol import Outcome, Signal
from scoring.result import Result
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.engine.faulty_source import TIMEOUT, FaultyDrive
from tests.madrob_console.engine.machine_time import Machine


class HandClock:
    """A monotonic clock that each message moves on by what it takes to look at it."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now = 100.0
        self.cost = cost
        self.seen: list[tuple[int, bool, bool]] = []

    def __call__(self) -> float:
        return self.now

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        self.now += self.cost
        self.seen.append((message.receive_ns, recorded, shown))


def messages(count: int, first: int = 0, size: int = 1) -> list[RawMessage]:
    return [RawMessage("/t", "t", bytes(size), n, n) for n in range(first, first + count)]


def never() -> bool:
    return False


def test_between_two_messages_its_owner_may_have_a_turn() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    backlog.add_messages(messages(3), recorded=True)
    backlog.work_off(lambda: True)
    assert clock.seen == [(0, True, True)]
    assert len(backlog) == backlog.recorded == 2
    backlog.work_off(never)
    assert [number for number, *_ in clock.seen] == [0, 1, 2]
    assert len(backlog) == backlog.recorded == 0


def test_its_owner_has_a_turn_anyway_when_messages_take_long() -> None:
    clock = HandClock(cost=0.015)
    backlog = Backlog(clock.observe, clock)
    backlog.add_messages(messages(9), recorded=False)
    backlog.work_off(never)
    assert len(clock.seen) == 2


def test_what_is_late_is_judged_but_not_shown_and_that_is_said_for_a_while() -> None:
    clock = HandClock(cost=0.1)
    backlog = Backlog(clock.observe, clock)
    backlog.add_messages(messages(10), recorded=True)
    while len(backlog):
        backlog.work_off(never)
    shown = [shown for _, _, shown in clock.seen]
    assert [recorded for _, recorded, _ in clock.seen] == [True] * 10
    assert shown == [True] * 6 + [False] * 4
    assert backlog.problem is not None
    assert "4 messages are recorded but not shown" in backlog.problem
    clock.now += 2.1
    assert backlog.problem is None


def test_who_is_behind_says_how_far_and_up_to_when_all_was_seen() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    assert (backlog.behind, backlog.seen(50.0), backlog.problem) == (0.0, 50.0, None)
    backlog.add_messages(messages(2, first=20 * NS), recorded=False)
    clock.now += LATEST + 0.3
    assert backlog.seen(50.0) == 20.0
    assert backlog.behind == pytest.approx(0.8)
    assert str(backlog.problem).startswith("the engine is 0.8 s behind")


def test_to_the_end_nothing_is_late() -> None:
    clock = HandClock(cost=1.0)
    backlog = Backlog(clock.observe, clock)
    backlog.add_messages(messages(5), recorded=True)
    backlog.work_off()
    assert [shown for _, _, shown in clock.seen] == [True] * 5


def test_what_waits_is_bounded_in_bytes() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    backlog.add_messages(messages(8, size=CAPACITY // 8), recorded=False)
    assert backlog.full
    backlog.work_off(lambda: True)
    assert not backlog.full


# ---------------------------------------------------------------------- the engine


class HeldUp(FaultyDrive):
    """An engine that somebody wants something of after each message, from `hold_up` on."""

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        config = self.engine.config
        real = type(config)(results, config.mappings, config.disk_needed)
        self.engine = Engine(self.faulty, self.clock, real, MessageTypes())
        self.engine.open()

    def hold_up(self, duration: float) -> None:
        """Six messages come in a step, one is looked at."""
        end = self.engine.now() + duration
        while self.engine.now() < end:
            self.engine.step(STEP, lambda: True)
            self.clock.sleep(STEP)


def test_an_abort_takes_effect_though_hundreds_of_messages_wait_and_all_are_judged(
    tmp_path: Path,
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(4.0)
    drive.hold_up(3.0)
    said = drive.engine.now()
    drive.act(Abort("enough"))
    assert (drive.engine.run.phase, drive.engine.run.stop) == (Phase.STOPPED, said)
    drive.hold_up(1.5)  # the post-roll is over, and what it recorded waits
    assert drive.engine.scored is None
    result = drive.result()
    assert drive.rescored() == result


@pytest.mark.parametrize("declared", [False, True])
def test_a_timeout_is_judged_by_all_that_was_measured_before_it(
    declared: bool, tmp_path: Path
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(13.5)  # the robot is done 13.85 s after the start, which is 1 s after that
    drive.hold_up(1.6 if declared else TIMEOUT - 12.5)
    if declared:
        drive.act(DeclareTimeout("it was done, was it not?"))
    drive.hold_up(0.5)
    run = drive.engine.run
    assert (run.phase, run.timeout_at is not None) == (Phase.RUNNING, True)
    result = drive.result()
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert drive.rescored() == result
    for topic in drive.topics():
        assert drive.recorded(topic) == drive.handed(topic)[: len(drive.recorded(topic))]


SAMPLE = 0.025
STEPS_AT = (1.0, 2.5, 4.0)
"""s after the start."""
BUSY = 0.24
"""So long nothing is taken by a busy machine, s: twelve samples."""
HEADERLESS = (Signal.DOOR, Signal.HANDLE)
MAPPINGS = tuple(
    TopicMapping(m.signal, m.topic, "std_msgs/msg/Float64", "data") if m.signal in HEADERLESS else m
    for m in DEFAULT_MAPPINGS
)


class Topic:
    """A topic on the wire, as an intake has it: what came, when by the machine's wall clock."""

    def __init__(self, mapping: TopicMapping, types: MessageTypes) -> None:
        self.name, self.type = mapping.topic, mapping.type
        self.found_type, self.publishers, self.lost, self.problem = self.type, 1, 0, None
        self.topic = describe_topic(types, mapping.topic, mapping.type)
        self.arrived: list[Received] = []

    def take_messages(self) -> Sequence[Received]:
        taken, self.arrived = self.arrived, []
        return taken


class Wire(ros_source.RosSource):
    """The live source, with a simulated testbed in the place of DDS."""

    def __init__(self, machine: Machine, clock: SystemClock, types: MessageTypes) -> None:
        super().__init__(MAPPINGS, types, clock, domain=0)
        self._machine = machine
        self._steady = SystemClock()
        self._steady.hold_steady()
        self._testbed = SimulatedSource(None, self._steady, types, MAPPINGS)
        self._wired = {m.topic: Topic(m, types) for m in MAPPINGS if not m.signal.optional}
        self._intakes = tuple(self._wired.values())  # type: ignore[arg-type]
        self.step: Callable[[], tuple[float, float, float]] = lambda: (0.0, 0.0, 0.0)

    def open(self) -> None:
        self._testbed.open()

    def publish(self, message: RawMessage) -> None:
        self._testbed.publish(message)

    def take_messages(self, timeout: float) -> list[RawMessage]:
        """As the thread does it; the clock may be stepped before what came is taken."""
        before, jump, after = self.step()
        self.receive(max(timeout, before))
        self._machine.step(jump)
        self.receive(after)
        return self._take()

    def receive(self, duration: float) -> None:
        """Messages arrive and wait to be taken."""
        messages = self._testbed.take_messages(duration)
        ahead = self._machine.time_ns() - self._steady.now_ns()
        for m in messages:
            received = Received(m.data, m.publish_ns, m.receive_ns + ahead, None)
            self._wired[m.topic].arrived.append(received)


class WiredDrive(Drive):
    def __init__(self, results: Path, machine: Machine) -> None:
        types, clock = MessageTypes(), SystemClock()
        self.wire = Wire(machine, clock, types)
        config = EngineConfig(results, MAPPINGS, lossless=True, disk_needed=0)
        self.engine = Engine(self.wire, clock, config, types)
        self.engine.open()


def machine_in(patched: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    patched.setattr("madrob_console.common.clock.time", machine)
    patched.setattr(ros_source, "time", machine)
    return machine


def run_on(machine: Machine, results: Path, *steps: tuple[float, float, float]) -> WiredDrive:
    """A whole run; a step is how long nothing is taken before it, the jump, how long after it."""
    drive = WiredDrive(results, machine)
    due = [*zip(STEPS_AT, steps, strict=False)]

    def step() -> tuple[float, float, float]:
        start = drive.engine.run.start
        if start is None or not due or drive.engine.now() < start + due[0][0]:
            return (0.0, 0.0, 0.0)
        return due.pop(0)[1]

    drive.wire.step = step
    drive.whole_run(make_setup())
    assert not due
    return drive


def durations(result: Result) -> dict[str, float]:
    found = {f"{n} {e.event}": e.since_start for n, e in enumerate(result.events)}
    indicators = result.indicators.items()
    return found | {name: i.value for name, i in indicators if i.unit == "s" and i.value}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Result:
    with pytest.MonkeyPatch.context() as patched:
        drive = run_on(machine_in(patched), tmp_path_factory.mktemp("undisturbed"))
    return drive.scored().result


@pytest.mark.parametrize("jump", [0.3, 1.36])
@pytest.mark.parametrize(
    ("before", "after"),
    [(0.0, 0.0), (BUSY, 0.0), (BUSY / 2, BUSY / 2)],
    ids=["while it is idle", "while it is busy", "in the midst of what it takes"],
)
def test_a_stepped_clock_costs_no_sample_of_a_topic_without_a_header(
    jump: float,
    before: float,
    after: float,
    undisturbed: Result,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    steps = [(before, each, after) for each in (jump, -jump, -jump)]
    drive = run_on(machine_in(monkeypatch), tmp_path, *steps)
    result = drive.scored().result
    assert result.outcome is Outcome.COMPLETED
    assert {(s.dropped, s.shifted) for s in result.quality.signals} == {(0, 0)}
    assert durations(result) == pytest.approx(durations(undisturbed), abs=SAMPLE)
    assert next(score(drive.folder)).result == result


def test_what_waited_when_the_recording_began_is_judged_in_a_replay_too(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drive = WiredDrive(tmp_path, machine_in(monkeypatch))
    drive.prepare(make_setup())
    drive.wire.receive(BUSY)
    drive.act(Start())
    drive.finish()
    engine = Deck(drive.folder, speed=0.0).engine
    while engine.scored is None:
        engine.step(0.02)
    assert engine.replay is not None
    assert engine.replay.view(engine.scored.result).agrees
