"""The real engine, inline and in virtual time, on a testbed whose signals a test sets by hand.

As a program it is a console on a run that goes on, for tests with a terminal.
"""

from __future__ import annotations

import math
import shutil
import sys
import time
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from copy import copy
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp
from typing import Any, TypeVar

from madrob_console.archive.folders import RunName
from madrob_console.archive.history import History
from madrob_console.common.clock import NS, Clock, VirtualClock, nanoseconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.run_tracker import IN_FLIGHT
from madrob_console.engine.playback import PlaybackCommand
from madrob_console.engine.requests import (
    GiveFrames,
    NextRunNumber,
    OpenRun,
    Perform,
    Request,
    T,
    TakeOver,
)
from madrob_console.engine.runtime.engine_thread import LocalEngine, QueuedRequest
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import RightToAct, Snapshot
from madrob_console.messages.codec import describe_topic, referee_topics
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    SetUp,
    Start,
    act_named,
)
from madrob_console.referee.run import Run
from madrob_console.referee.run_summary import RunSummary
from madrob_console.referee.topic_health import SensorLimits
from madrob_console.testbeds.announcement import SILENT, Announcement
from madrob_console.testbeds.simulated.encoder import Encoder
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import Source, TopicStatus
from recorder.bag import RawMessage, Topic
from scoring.indicator_table import IndicatorName
from scoring.protocol import (
    PASSAGE_SENSORS,
    Outcome,
    Side,
    Signal,
    Step,
    Thresholds,
)
from scoring.result import Indicator
from scoring.stamps import REORDERED
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.robots import any_testbed
from tests.madrob_console.ui.prepared import PreparedScorer, a_setup

EPOCH = 1_700_000_000.0
RATE = 10.0
"""Of each topic, Hz."""
_SHOWN = {field.name for field in fields(Snapshot)} - {"right"}
FIRST = 1.04
"""So long has the testbed been on, s."""
_SIGNALS = [mapping for mapping in DEFAULT_MAPPINGS if not mapping.signal.optional]


class HandSource(Source):
    """A testbed that says what a test sets.

    Attributes:
        angle, force: rad and N; `occupied`: what is under the sensors.
        silent: signals of which nothing comes.
        stamp: of the newest messages, ns; `late` are those that come beside the others.
    """

    kind = SourceKind.SIMULATED
    label = "SIMULATED nominal"
    sides_problem: str | None = None
    simulated: str | None = None

    def __init__(self, clock: Clock, types: MessageTypes) -> None:
        self.angle, self.force = 0.0, 0.4
        self.occupied: set[tuple[Side, int]] = set()
        self.silent: Collection[Signal] = ()
        self.stamp = 0
        self.late: list[RawMessage] = []
        self._clock = clock
        self._due = clock.now_ns() - nanoseconds(FIRST)
        self._encoders = {m: Encoder(m, types) for m in _SIGNALS}
        self._topics = (
            *(describe_topic(types, m.topic, m.type) for m in _SIGNALS),
            *referee_topics(types),
        )

    def open(self) -> None:
        """There is nothing to open."""

    def take_messages(self, timeout: float) -> list[RawMessage]:
        self._clock.sleep(timeout)
        now = self._clock.now_ns()
        messages, self.late = self.late, []
        while self._due <= now:
            messages += self.messages(self._due, self._due)
            self._due += nanoseconds(1 / RATE)
        return messages

    def messages(self, stamp: int, now: int) -> list[RawMessage]:
        """One of each topic."""
        self.stamp = stamp
        return [
            RawMessage(m.topic, m.type, encoder.encode(stamp, self._read(m.signal)), stamp, now)
            for m, encoder in self._encoders.items()
            if m.signal not in self.silent
        ]

    def _read(self, signal: Signal) -> float | tuple[float, ...]:
        if signal is Signal.DOOR:
            return self.angle
        if signal is Signal.HANDLE:
            return self.force
        ranges = [Thresholds().lintel_height] * 4
        for one in PASSAGE_SENSORS:
            if Signal.of_strip(one.strip) is signal and (one.side, one.index) in self.occupied:
                ranges[one.element] = 1.0
        return tuple(ranges)

    def topics(self) -> Sequence[Topic]:
        return self._topics

    def status(self) -> Sequence[TopicStatus]:
        return tuple(TopicStatus(m.topic, m.type, 1) for m in _SIGNALS)

    @property
    def announcement(self) -> Announcement:
        return SILENT if self.simulated is None else Announcement(self.simulated)

    def close(self) -> None:
        """There is nothing to close."""


DISK_FREE = 41_000_000_000
FOLDER = "/results/subject_001_cond_001_run_001_20231114_221325"
_OF_TESTBED = {
    "kind",
    "label",
    "sides_problem",
    "simulated",
    "silent",
    "angle",
    "force",
    "occupied",
}
_types = cache(MessageTypes)
R = TypeVar("R", bound=Request[Any])


class _Runs(History):
    """What a test says that was run before."""

    def __init__(self) -> None:
        self.runs: list[RunSummary] = []

    def refresh(self) -> tuple[RunSummary, ...]:
        return tuple(self.runs)


class HandEngine(LocalEngine):
    """An engine without its thread on such a testbed, whose link can be lost.

    Attributes:
        shown: fields of the state that a test sets.
        right: of the screen, if it `takes_over`.
        failure: why nothing comes from it; `no_number`: why it knows of no number.
        acts: that were done; `requests`: what else was wanted.
        instead: what becomes of an act instead; it answers why that is refused.
        frames: where the cameras' frames are.
        slow: whether requests wait until `answer` is called.
        waiting: those that do, and their answers to come.
        follower: what is found after it.
    """

    LIMITS = SensorLimits(rate=RATE)

    def __init__(self, competition: str = "Autumn Cup", **values: Any) -> None:  # noqa: ANN401
        self.folder = Path(mkdtemp(prefix="madrob_ui_"))
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        self.clock, types = VirtualClock(round(EPOCH) * NS), _types()
        self.source, self.scorer = HandSource(self.clock, types), PreparedScorer()
        config = EngineConfig(
            self.folder,
            tuple(_SIGNALS),
            disk_needed=0,
            limits=self.LIMITS,
            competition=competition,
            lossless=True,
            random=Random(0).randbytes,
        )
        testbed = self._testbed(types)
        self._engine = Engine(testbed, self.clock, config, types, scorer=self.scorer)
        self._engine.open()
        self._engine.step(0.0)
        self._fallen = lambda: None
        self._reporting = no_reporting(self.folder)
        self._begun = set()
        self._history = self._runs = _Runs()
        self._failure = None
        self._writing = ("", 0.0)
        self.shown: dict[str, Any] = {"disk_free": DISK_FREE, "provisional_doubts": {}}
        self.right, self.takes_over = RightToAct(), True
        self.failure: str | None = None
        self.no_number: str | None = None
        self.acts: list[Act] = []
        self.requests: list[Request[Any]] = []
        self.instead: Callable[[Act], str | None] | None = None
        self.frames = ""
        self.slow = self.closed = False
        self.waiting: list[tuple[Request[Any], Future[Any]]] = []
        self.follower: HandEngine | MadrobError | None = None
        self.looked_for = self.started = 0
        self._look()
        self._last = self._snapshot
        self.put(**values)

    def _testbed(self, _types: MessageTypes) -> Source:
        return self.source

    @property
    def now(self) -> float:
        return self._engine.now()

    @property
    def run(self) -> Run:
        return self._engine.run

    @property
    def history(self) -> list[RunSummary]:
        """The runs that the plan knows of."""
        return self._runs.runs

    def tick(self, duration: float) -> None:
        """Let time pass."""
        end = self.now + duration
        while (left := end - self.now) > 1e-6:
            self._engine.step(min(1 / RATE, left))
        self._look()

    def snapshot(self) -> Snapshot:
        if self.failure is not None:
            raise MadrobError(self.failure)
        self._stepped = time.monotonic()
        state = super().snapshot()
        folder, recorder = state.folder, state.recorder
        if recorder.state != "closed":
            # how far its thread is depends on the moment
            recorder = replace(recorder, messages=12345, size=3_400_000)
        if folder is not None:
            folder = str(Path("/results") / Path(folder).name)
        fields = {"folder": folder, "recorder": recorder, "right": self.right}
        state = replace(state, **{**fields, **self.shown})
        if state != self._last:
            self._last = state
        return self._last

    def begin_request(self, request: Request[T], *args: Any, **named: Any) -> Future[T]:  # noqa: ANN401
        answer: Future[Any] = Future()
        if self.slow:
            self.waiting.append((request, answer))
            return answer
        try:
            value = self._answer(request)
        except MadrobError as error:
            answer.set_exception(error)
        else:
            if value is ...:
                return super().begin_request(request, *args, **named)
            answer.set_result(value)
        return answer

    def _answer(self, request: Request[Any]) -> object:
        """What is not left to the engine itself, which is then `...`."""
        if self.failure is not None:
            raise MadrobError(self.failure)
        if not isinstance(request, Perform):
            self.requests.append(request)
        match request:
            case Perform(name, details):
                act = act_named(name, details)
                refused = (self.instead or self._engine.perform)(act)
                self.acts += [act] * (refused is None)
                self._look()
                return refused
            case TakeOver() if self.takes_over:
                self.right = RightToAct()
            case TakeOver():
                return "this screen only watches"
            case NextRunNumber() if self.no_number is not None:
                raise MadrobError(self.no_number)
            case GiveFrames() if not self.frames:
                raise MadrobError("it holds no evidence")
            case GiveFrames():
                return self.frames
            case OpenRun() | PlaybackCommand():
                return None  # there is no such run
        return ...

    def sent(self, *kinds: type[R]) -> list[R]:
        """The requests of such kinds."""
        return [request for request in self.requests if isinstance(request, kinds)]

    def _put(self, turn: QueuedRequest, *, urgent: bool = False) -> Future[Any]:
        self._take(turn)
        return turn.answer

    def answer(self) -> None:
        """Carry out and answer what waits and was not given up; it is slow no more."""
        self.slow = False
        waiting, self.waiting = self.waiting, []
        for request, answer in waiting:
            if answer.set_running_or_notify_cancel():
                answer.set_result(self.send_request(request))

    def act(self, act: Act) -> str | None:
        return self.send_request(Perform.of(act))

    def put(self, **values: Any) -> None:  # noqa: ANN401
        """Set what the testbed says, lists, what is prepared, or fields of state and engine."""
        for name, value in values.items():
            if name in _OF_TESTBED:
                setattr(self.source, name, copy(value))
            elif name in {"teams", "plan"}:
                getattr(self._engine, f"set_{name}")(value)
            elif name == "indicators":
                self.scorer.indicators = value
            elif name == "history":
                self._runs.runs = copy(value)
            elif name == "used_numbers":
                for (subject, condition), number in value.items():
                    folder = RunName(subject, condition, number).folder_name(EPOCH)
                    (self.folder / folder).mkdir()
            elif name in _SHOWN:
                self.shown[name] = value
            else:
                assert hasattr(self, name), name
                setattr(self, name, copy(value))
        if values.keys() & {"angle", "force", "occupied"}:
            self.hear()
        self._look()

    def would_refuse(self, act: Act) -> str | None:
        return act.refusal(self._engine.situation())

    def close(self) -> None:
        """The engine goes on."""
        self.closed = True

    def find(self, may_start: bool) -> HandEngine:
        """What is found in its place; itself, started again, unless something follows."""
        self.looked_for += 1
        self.started += may_start
        if isinstance(self.follower, MadrobError):
            raise self.follower
        if self.follower is None and not may_start:
            raise MadrobError("no engine runs here")
        return self.follower or self

    # what a test does

    def hear(self, before: float = 0.0) -> None:
        """The testbed says how it is now; or how it was `before`, s, as it comes late."""
        now = self.clock.now_ns()
        if before == 0.0 and self.source.stamp >= now:
            now = self.source.stamp + nanoseconds(0.001)
            self.clock.advance_to(now)
        self.source.late += self.source.messages(now - nanoseconds(before), now)
        self._engine.step(0.0)
        self._look()

    def do_step(self, step: Step) -> None:
        """The sensors see the steps up to this one that they have not seen."""
        for record in self.snapshot().steps[:step]:
            if record.sensors is None and self.run.active:
                self._see(record.step)

    def _see(self, step: Step) -> None:
        setup = self.run.setup
        assert setup is not None
        match step:
            case Step.TOUCH:
                self.touch()
            case Step.OPEN:
                self.put(angle=1.2 * setup.condition.opening_side.sign)  # it hides no sensor
            case Step.CROSS:
                self.put(occupied={(setup.condition.destination_side, 1)})
                self.put(occupied=set())
            case Step.CLOSE:
                self.put(angle=0.0)
            case Step.LOCK:
                self.tick(Thresholds().settle_time + 0.1)
                self.tick(REORDERED)  # the last sample has waited for others

    def move(
        self, duration: float, angle: Callable[[float], float], force: Callable[[float], float]
    ) -> None:
        """Let time pass, in which panel and force are such functions of it."""
        for number in range(1, round(duration * RATE) + 1):
            self.source.angle, self.source.force = angle(number / RATE), force(number / RATE)
            self.tick(1 / RATE)

    def touch(self, before: float = 0.0) -> None:
        """Somebody touches the handle, or did `before`, s."""
        for force in (12.0, self.source.force):
            self.source.force = force
            self.hear(before)
            before = max(0.0, before - 0.001)

    def stop(self, outcome: Outcome = Outcome.COMPLETED, reason: str = "gave up") -> None:
        """The run ends; a completed one has done its steps."""
        if outcome is Outcome.COMPLETED:
            self.do_step(Step.LOCK)
        else:
            ends = Abort if outcome is Outcome.ABORTED else DeclareTimeout
            assert self.act(ends(reason)) is None
            self.tick(IN_FLIGHT + 0.1)  # it stops when all until then is judged

    def finish(self, outcome: Outcome = Outcome.COMPLETED, reason: str = "gave up") -> None:
        """The run ends and is scored."""
        self.stop(outcome, reason)
        self.score()

    def score(self) -> None:
        """The result of the stopped run is written."""
        assert not self.run.active
        while self._engine.scored is None:
            self.tick(0.1)
        self.rest()

    def rest(self) -> None:
        """What an earlier run has left to do is done."""
        while self._engine.busy:
            self.tick(0.1)

    def end(self) -> None:
        """Nobody uses it any more."""
        self._engine.close()


class MovingEngine(HandEngine):
    """Panel and force swing, sensors come and go, the log grows once a second.

    A run goes on until the file `ends` is there.
    """

    def __init__(self, ends: Path) -> None:
        super().__init__()
        self._began = time.monotonic()
        self._ends = ends
        self._notes = 0

    def start_run(self) -> None:
        """Skip to a running run."""
        start(self, 5.0)
        self._began -= 5.0
        self.do_step(Step.TOUCH)

    def snapshot(self) -> Snapshot:
        elapsed = time.monotonic() - self._began
        if self.run.active and self._ends.exists():
            self.act(DeclareTimeout("the team gives up"))
        if self.run.active:
            self.source.angle = 0.6 + 0.5 * math.sin(elapsed)
            self.source.force = 8 * math.sin(3 * elapsed)
            self.source.occupied = {(Side.CCW, int(elapsed) % 5)}
            if int(elapsed) > self._notes:
                self._notes = int(elapsed)
                self.act(AddNote(f"event number {self._notes}"))
        self.tick(EPOCH + elapsed - self.now)
        return super().snapshot()


class SimulatedEngine(HandEngine):
    """The same on the simulated testbed, whose robot goes through the door by itself."""

    LIMITS = SensorLimits()

    def _testbed(self, types: MessageTypes) -> Source:
        return SimulatedSource(any_testbed(), self.clock, types, _SIGNALS)


def start(engine: HandEngine, duration: float, **setup: Any) -> HandEngine:  # noqa: ANN401
    """A run is started, so long before, s."""
    for act in (SetUp(replace(a_setup(), **setup)), ConfirmPose(), Start()):
        assert engine.act(act) is None
    engine.tick(duration)
    return engine


@cache
def at_rest() -> Snapshot:
    """Nothing is set up."""
    return HandEngine().snapshot()


@cache
def running() -> Snapshot:
    """A run goes on for 14 s."""
    engine = start(HandEngine(), 19.0)
    state = engine.snapshot()
    engine.end()
    return state


@cache
def finished(outcome: Outcome = Outcome.COMPLETED) -> Snapshot:
    """A run with a result."""
    engine = start(HandEngine(), 19.0)
    engine.finish(outcome)
    engine.end()
    return engine.snapshot()


def measured_as(found: Mapping[IndicatorName, Indicator]) -> Snapshot:
    """A run with a result that has these indicators."""
    state = finished()
    assert state.result is not None
    result = replace(state.result, indicators={**state.result.indicators, **found})
    return replace(state, result=result)


if __name__ == "__main__":
    from madrob_console.ui.link import ConsoleDefaults
    from madrob_console.ui.terminal import run_console

    moving = MovingEngine(Path(sys.argv[2] if len(sys.argv) > 2 else "never"))
    if "--running" in sys.argv:
        moving.start_run()
    sys.exit(run_console(lambda _: moving, ConsoleDefaults()))
