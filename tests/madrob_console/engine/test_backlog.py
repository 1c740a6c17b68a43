from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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


class Looking:
    """Who looks at messages, and a monotonic clock that each of them moves on by what it takes."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now = 100.0
        self.cost = cost
        self.seen: list[tuple[int, bool, bool]] = []
        self.backlog = Backlog(self.observe, lambda: self.now)

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        self.now += self.cost
        self.seen.append((message.receive_ns, recorded, shown))

    def add(self, count: int, first: int = 0, size: int = 1, *, recorded: bool = False) -> None:
        numbers = range(first, first + count)
        messages = [RawMessage("/t", "t", bytes(size), n, n) for n in numbers]
        self.backlog.add_messages(messages, recorded=recorded)


@pytest.mark.parametrize(
    ("cost", "waits", "seen"),
    [(0.0, True, 1), (0.0, False, 9), (0.015, False, 2)],
    ids=[
        "its owner has a turn when it wants one",
        "else it goes on",
        "but for no longer than this",
    ],
)
def test_between_two_messages_its_owner_may_have_a_turn(
    cost: float, waits: bool, seen: int
) -> None:
    looking = Looking(cost)
    looking.add(9, recorded=True)
    looking.backlog.work_off(lambda: waits)
    assert looking.seen == [(number, True, True) for number in range(seen)]
    assert len(looking.backlog) == looking.backlog.recorded == 9 - seen


def test_what_is_late_is_judged_but_not_shown_and_that_is_said_for_a_while() -> None:
    looking = Looking(cost=0.1)
    backlog = looking.backlog
    looking.add(10, recorded=True)
    while len(backlog):
        backlog.work_off(lambda: False)
    assert looking.seen == [(number, True, number < 6) for number in range(10)]
    assert "4 messages are recorded but not shown" in str(backlog.problem)
    looking.now += 2.1
    assert backlog.problem is None
    looking.cost = 1.0
    looking.add(5)
    backlog.work_off()
    assert [shown for *_, shown in looking.seen[10:]] == [True] * 5  # to the end nothing is late


def test_who_is_behind_says_how_far_and_up_to_when_all_was_seen() -> None:
    looking = Looking()
    backlog = looking.backlog
    assert (backlog.behind, backlog.seen(50.0), backlog.problem) == (0.0, 50.0, None)
    looking.add(2, first=20 * NS)
    looking.now += LATEST + 0.3
    assert backlog.seen(50.0) == 20.0
    assert backlog.behind == pytest.approx(0.8)
    assert str(backlog.problem).startswith("the engine is 0.8 s behind")


def test_what_waits_is_bounded_in_bytes() -> None:
    looking = Looking()
    looking.add(8, size=CAPACITY // 8)
    assert looking.backlog.full
    looking.backlog.work_off(lambda: True)
    assert not looking.backlog.full


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


class Wire(ros_source.RosSource):
    """The live source, with a simulated testbed in the place of DDS."""

    def __init__(self, machine: Machine, clock: SystemClock, types: MessageTypes) -> None:
        super().__init__(MAPPINGS, types, clock, domain=0)
        self._machine = machine
        self._steady = SystemClock()
        self._steady.hold_steady()
        self._testbed = SimulatedSource(None, self._steady, types, MAPPINGS)
        self._arrived: dict[str, list[Received]] = {}
        self._intakes = tuple(self._intake(m, types) for m in MAPPINGS if not m.signal.optional)
        self.step: Callable[[], tuple[float, float, float]] = lambda: (0.0, 0.0, 0.0)

    def _intake(self, mapping: TopicMapping, types: MessageTypes) -> Any:  # noqa: ANN401  stands in
        """A topic: what came, when by the machine's wall clock."""
        name, kind = mapping.topic, mapping.type
        self._arrived[name] = []

        def take_messages() -> list[Received]:
            taken, self._arrived[name] = self._arrived[name], []
            return taken

        return SimpleNamespace(
            name=name,
            type=kind,
            found_type=kind,
            publishers=1,
            lost=None,
            problem=None,
            topic=describe_topic(types, name, kind),
            take_messages=take_messages,
        )

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
            self._arrived[m.topic].append(received)


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


@pytest.mark.parametrize(
    ("jump", "before", "after"),
    [
        pytest.param(1.36, 0.0, 0.0, id="while it is idle"),
        pytest.param(0.3, BUSY, 0.0, id="while it is busy"),
        pytest.param(1.36, BUSY, 0.0, id="far, while it is busy", marks=pytest.mark.slow),
        pytest.param(0.3, BUSY / 2, BUSY / 2, id="in the midst of what it takes"),
    ],
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
    deck = Deck(drive.folder, speed=0.0)
    deck.to_the_end()
    assert deck.at.agrees
