"""When messages were received: by a clock that is stepped, and before the recording began."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.clock import SystemClock
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    MessageTypes,
    TopicMapping,
    describe_topic,
)
from madrob_console.referee.acts import Start
from madrob_console.testbeds.ros import ros_source
from madrob_console.testbeds.ros.inbox import Received
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import TopicStatus
from recorder.message import RawMessage
from scoring.protocol import Outcome, Signal
from scoring.result import Result
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.machine_time import Machine

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
        self.topic = describe_topic(types, mapping.topic, mapping.type)
        self.arrived: list[Received] = []

    def take(self) -> Sequence[Received]:
        taken, self.arrived = self.arrived, []
        return taken

    def status(self, dropped: int) -> TopicStatus:
        return TopicStatus(self.name, self.type, 1, dropped)


class Wire(ros_source.RosSource):
    """The live source, with a simulated testbed in the place of DDS."""

    def __init__(self, machine: Machine, clock: SystemClock, types: MessageTypes) -> None:
        super().__init__(MAPPINGS, types, clock, domain=0)
        self._machine = machine
        self._steady = SystemClock()
        self._steady.hold()
        self._testbed = SimulatedSource(None, self._steady, types, MAPPINGS)
        self._wired = {m.topic: Topic(m, types) for m in MAPPINGS if not m.signal.optional}
        self._intakes = tuple(self._wired.values())  # type: ignore[arg-type]
        self.step: Callable[[], tuple[float, float, float]] = lambda: (0.0, 0.0, 0.0)

    def open(self) -> None:
        self._testbed.open()

    def publish(self, message: RawMessage) -> None:
        self._testbed.publish(message)

    def take(self, timeout: float) -> list[RawMessage]:
        """As the thread does it; the clock may be stepped before what came is taken."""
        before, jump, after = self.step()
        self.receive(max(timeout, before))
        self._machine.step(jump)
        self.receive(after)
        return self._take()

    def receive(self, duration: float) -> None:
        """Messages arrive and wait to be taken."""
        messages = self._testbed.take(duration)
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
    patched.setattr("madrob_console.clock.time", machine)
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
