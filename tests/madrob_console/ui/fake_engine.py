"""A scripted engine: real acts on a real run, a testbed that the test sets by hand.

As a program it moves with the clock, for tests with a terminal.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any, cast

from madrob_console.archive.run_journal import Unfinished
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.sensors import RecentReadings
from madrob_console.engine.core.state_view import NO_STEPS, elapsed, remaining
from madrob_console.engine.requests import (
    Curve,
    Curves,
    ExportDossier,
    ExportTeam,
    GiveCurves,
    GiveFrames,
    GivePlan,
    NextRunNumber,
    OpenRun,
    Perform,
    PlaybackCommand,
    PlaybackView,
    Request,
    T,
    TakeOver,
)
from madrob_console.engine.snapshot import (
    DoorView,
    ExportView,
    HandleView,
    LatchView,
    LogLine,
    Pulse,
    RecorderView,
    RightToAct,
    SensorView,
    Snapshot,
    TopicView,
    Weight,
)
from madrob_console.referee.acts import (
    Act,
    ConfirmPose,
    SetUp,
    Situation,
    Start,
    act_named,
    refusals,
)
from madrob_console.referee.checks import Check, Freshness, Readings, preflight
from madrob_console.referee.competition_plan import NO_PLAN, Plan, plan_progress
from madrob_console.referee.journal import Origin
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.records import FalseStart, RunSetup
from madrob_console.referee.run import Phase, Run, begin_run, stop
from madrob_console.referee.run_summary import RunSummary
from scoring.figure_table import Quantity
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import (
    PASSAGE_SENSORS,
    BenchmarkType,
    Condition,
    Event,
    EventName,
    LockDetection,
    Outcome,
    Side,
    Signal,
    StartPose,
    Step,
    Thresholds,
)
from scoring.quality import Quality, SignalQuality
from scoring.rest import HandleRest
from scoring.result import Indicator, Result
from scoring.rulesets import RulesetName
from tests.scoring.runs import resting

EPOCH = 1_700_000_000.0
TOPICS = (
    "/madrob/door/angle",
    "/madrob/handle/force",
    "/madrob/passage/cw_left",
    "/madrob/passage/cw_right",
    "/madrob/passage/ccw_left",
    "/madrob/passage/ccw_right",
)
MARKED = {
    Step.TOUCH: EventName.HANDLE_IS_TOUCHED,
    Step.OPEN: EventName.DOOR_OPENS,
    Step.CROSS: EventName.MOVES_TO_CW,
    Step.CLOSE: EventName.DOOR_CLOSES,
}
SAMPLING, GAP = 0.02, 0.5  # s
DISK_FREE = 41_000_000_000
FOLDER = "/results/subject_001_cond_001_run_001_20231114_221320"


@dataclass
class FakeEngine:
    """An `EngineClient` whose clock and testbed stand still until a test moves them."""

    now: float = EPOCH
    run: Run = field(default_factory=Run)
    kind: SourceKind = SourceKind.SIMULATED
    label: str = "SIMULATED nominal"
    simulated: str | None = None
    angle: float | None = 0.0
    force: float | None = 0.4
    maximum: float | None = None
    angles: RecentReadings = field(default_factory=RecentReadings)
    forces: RecentReadings = field(default_factory=RecentReadings)
    events: tuple[Event, ...] = ()
    freshness: Freshness = Freshness.FRESH
    occupied: set[tuple[Side, int]] = field(default_factory=set)
    steps: tuple[StepRecord, ...] = NO_STEPS
    result: Result | None = None
    sides_problem: str | None = None
    faults: tuple[str, ...] = ()
    ask_referee: str | None = None
    recorder: RecorderView = field(default_factory=lambda: RecorderView("closed"))
    log: tuple[LogLine, ...] = ()
    acts: list[Act] = field(default_factory=list)
    used_numbers: dict[tuple[int, int], int] = field(default_factory=dict)
    no_number: str | None = None
    failure: str | None = None
    closed: bool = False
    unfinished: tuple[Unfinished, ...] = ()
    opened: list[str] = field(default_factory=list)
    exported: list[int] = field(default_factory=list)
    """Subjects; below 0 where practice runs were asked for."""
    exported_of: list[str | None] = field(default_factory=list)
    """Their competitions."""
    dossiers: list[str] = field(default_factory=list)
    """Folders of the runs."""
    export: ExportView | None = None
    playback: PlaybackView | None = None
    commands: list[PlaybackCommand | GiveFrames] = field(default_factory=list)
    frames: str = ""
    """The folder of what the cameras saw; empty = they saw nothing."""
    provisional: dict[str, float] = field(default_factory=dict)
    provisional_doubts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    right: RightToAct = field(default_factory=RightToAct)
    takes_over: bool = True
    pulse: Pulse = field(default_factory=Pulse)
    teams: TeamList = NO_TEAMS
    plan: Plan = NO_PLAN
    competition: str = "Autumn Cup"
    history: list[RunSummary] = field(default_factory=list)
    follower: FakeEngine | MadrobError | None = None
    """What is found after it."""
    looked_for: int = 0
    started: int = 0
    slow: bool = False
    """Whether requests wait until `answer` is called."""
    waiting: list[tuple[Request[Any], Future[Any]]] = field(default_factory=list)
    """Those that do, and their answers to come."""

    def __post_init__(self) -> None:
        self._made = self._snapshot_now()

    # what a client does

    def snapshot(self) -> Snapshot:
        self._answer()
        if (made := self._snapshot_now()) != self._made:
            self._made = made
        return self._made

    def _snapshot_now(self) -> Snapshot:
        situation = self._situation()
        return Snapshot(
            time=self.now,
            source_kind=self.kind,
            source_label=self.label,
            simulated=self.simulated,
            sides_problem=self.sides_problem,
            run=self.run,
            elapsed=elapsed(self.run, self.now),
            remaining=remaining(self.run, self.now),
            settling=False,
            checks=situation.checks,
            refusals=refusals(situation),
            steps=self.steps,
            ask_referee=self.ask_referee,
            door=self._door(),
            handle=self._handle(),
            latch=LatchView(None, Freshness.NEVER),
            passage=tuple(self._sensor(s.side, s.index) for s in PASSAGE_SENSORS),
            topics=tuple(
                TopicView(t, "t", 1, self.freshness, 0.01, 50.0, 100, 0, 0, False, None)
                for t in TOPICS
            ),
            recorder=self.recorder,
            disk_free=DISK_FREE,
            faults=self.faults,
            log=self.log,
            events=self.events,
            provisional=self.provisional,
            provisional_doubts=self.provisional_doubts,
            result=self.result,
            unfinished=self.unfinished,
            result_source=None if self.result is None else self.kind,
            folder=None if self.result is None else FOLDER,
            playback=self.playback,
            export=self.export,
            right=self.right,
            pulse=self.pulse,
            teams=self.teams,
            plan=self.plan,
            competition=self.competition,
        )

    def act(self, act: Act) -> str | None:
        situation = self._situation()
        if (refused := act.refusal(situation)) is not None:
            return refused
        self.run = act.settled(situation).apply(situation, self.now)
        self.acts.append(act)
        if isinstance(act, Start):
            self._use_number()
            self.recorder = RecorderView("recording", 12, 4_000)
        if self.run.phase is Phase.READY:
            self.result, self.steps = None, NO_STEPS
        return None

    def begin_request(self, request: Request[T]) -> Future[T]:
        answer: Future[T] = Future()
        if self.slow:
            self.waiting.append((request, answer))
            return answer
        try:
            self._answer()
            answer.set_result(cast("T", self._carry_out(request)))
        except MadrobError as error:
            answer.set_exception(error)
        return answer

    def send_request(self, request: Request[T]) -> T:
        return self.begin_request(request).result()

    def _carry_out(self, request: Request[Any]) -> object:  # noqa: C901, PLR0912  one case a request
        match request:
            case Perform(name, details):
                return self.act(act_named(name, details))
            case NextRunNumber(subject, condition, practice):
                if self.no_number is not None:
                    raise MadrobError(self.no_number)
                return 1 if practice else self.used_numbers.get((subject, condition), 0) + 1
            case OpenRun(folder, invalid):
                self.opened.append(f"{folder} invalid" if invalid else folder)
            case ExportTeam(subject, practice, competition):
                self.exported.append(-subject if practice else subject)
                self.exported_of.append(competition)
                self.export = ExportView(subject)
            case ExportDossier(folder):
                self.dossiers.append(folder)
                self.export = ExportView(0, dossier=folder)
            case PlaybackCommand():
                self.commands.append(request)
            case GiveCurves():
                return None
            case GiveFrames():
                self.commands.append(request)
                if not self.frames:
                    raise MadrobError("it holds no evidence")
                return self.frames
            case GivePlan():
                return plan_progress(self.plan, self.history, "Autumn Cup")
            case TakeOver() if not self.takes_over:
                return "this screen only watches"
            case TakeOver():
                self.right = RightToAct()
        return None

    def find(self, may_start: bool) -> FakeEngine:
        """What is found in its place; itself, started again, unless something follows."""
        self.looked_for += 1
        self.started += may_start
        if isinstance(self.follower, MadrobError):
            raise self.follower
        if self.follower is None and not may_start:
            raise MadrobError("no engine runs here")
        return self.follower or self

    def close(self) -> None:
        self.closed = True

    # what a test does

    def answer(self) -> None:
        """Carry out and answer what waits and was not given up; it is slow no more."""
        self.slow = False
        waiting, self.waiting = self.waiting, []
        for request, answer in waiting:
            if answer.set_running_or_notify_cancel():
                answer.set_result(self.send_request(request))

    def tick(self, duration: float) -> None:
        """Let time pass; a countdown becomes a run."""
        self.now += duration
        counts = self.run.phase is Phase.COUNTDOWN and self.run.held is None
        if counts and self.now >= (self.run.start or 0.0):
            self.run = begin_run(self.run)
            self.recorder = RecorderView("recording", 12345, 3_400_000)

    def move(
        self, duration: float, angle: Callable[[float], float], force: Callable[[float], float]
    ) -> None:
        """Let time pass, in which panel and force are such functions of it."""
        for number in range(1, round(duration / SAMPLING) + 1):
            self.tick(SAMPLING)
            self.angle, self.force = angle(number * SAMPLING), force(number * SAMPLING)
            self._door(), self._handle()

    def do_step(self, step: Step) -> None:
        """A step is done now."""
        if step in MARKED:
            self.events = (*self.events, Event(self.now, MARKED[step]))
        done = StepRecord(step, step.text, self.now, None, self.now)
        self.steps = tuple(done if record.step is step else record for record in self.steps)

    def false_start(self, event: EventName = EventName.HANDLE_IS_TOUCHED) -> None:
        """Somebody touches the handle in the countdown, which is held, or just before its end."""
        found = FalseStart(self.now, event)
        held = self.now if self.run.phase is Phase.COUNTDOWN else None
        self.run = replace(self.run, false_starts=(*self.run.false_starts, found), held=held)

    def say(self, text: str, origin: Origin = Origin.SENSOR, weight: Weight = Weight.PLAIN) -> None:
        """One more line in the log."""
        at = None if self.run.start is None else self.now - self.run.start
        self.log = (*self.log, LogLine(len(self.log), self.now, at, origin, text, weight))

    def finish(self, outcome: Outcome = Outcome.COMPLETED, reason: str = "step 6 is done") -> None:
        """The run ends by itself and is scored; a completed one has its steps."""
        if outcome is Outcome.COMPLETED and self.steps == NO_STEPS:
            for step in Step:
                self.do_step(step)
        self.run = stop(self.run, outcome, self.now, reason)
        self.score()

    def score(self) -> None:
        """The result of the stopped run is written."""
        setup, start = self.run.setup, self.run.start
        assert setup is not None
        assert start is not None
        self.run = replace(self.run, issue=self.run.issue + 1)
        self.result = Result(
            handle_zero=self.run.handle_zero,
            ruleset=setup.ruleset,
            outcome=self.run.outcome or Outcome.COMPLETED,
            outcome_reason=self.run.outcome_reason,
            start=start,
            stop=self.now,
            indicators=indicators(missing=self.run.outcome is not Outcome.COMPLETED),
            steps=self.steps,
            lock_detection=LockDetection.SETTLE,
            events=(),
            quality=Quality(tuple(quality(s) for s in list(Signal)[:-1]), ()),
        )

    # details

    def _use_number(self) -> None:
        setup = self.run.setup
        assert setup is not None
        key = (setup.subject, setup.condition.number)
        self.used_numbers[key] = max(self.used_numbers.get(key, 0), setup.run_number)

    def _answer(self) -> None:
        if self.failure is not None:
            raise MadrobError(self.failure)

    def _situation(self) -> Situation:
        return Situation(
            self.run,
            self.result is not None,
            self._checks,
            self._rest,
            teams=self.teams,
            steps=self.steps if self.result is None else self.result.steps,
            simulated=self.simulated,
            competition=self.competition,
            indicators={} if self.result is None else self.result.indicators,
        )

    def _rest(self) -> HandleRest | None:
        return None if self.force is None else resting(self.force, self.now)

    def _checks(self) -> tuple[Check, ...]:
        force = None if self.force is None else self.force - self.run.handle_zero
        readings = Readings(
            plan=self.plan,
            topic_faults=self.faults[:1] if self.freshness is Freshness.LOST else (),
            angle=self.angle,
            closed_angle=0.03,
            near_zero=Thresholds().near_zero,
            force=force,
            rest_force=0.98,
            zero=self.run.zero_samples,
            drift=None,
            occupied=tuple(f"{side} {index}" for side, index in sorted(self.occupied)),
            skew=0.004,
            largest_skew=0.1,
            disk_free=DISK_FREE,
            disk_needed=1_000_000_000,
            recorder_problem=self.recorder.problem or "",
            other_referee=None,
            teams=self.teams,
        )
        return preflight(readings, self.run)

    def _door(self) -> DoorView:
        is_open = None if self.angle is None else abs(self.angle) >= 0.03
        if self.angle is not None and self.freshness is Freshness.FRESH:
            self.angles.add(self.now, self.angle)
        recent = self.angles.stretches(self.now, GAP)
        return DoorView(self.angle, is_open, self.freshness, 0.03, recent)

    def _handle(self) -> HandleView:
        if self.force is not None and self.freshness is Freshness.FRESH:
            self.forces.add(self.now, self.force)
        recent, zero = self.forces.stretches(self.now, GAP), self.run.handle_zero
        return HandleView(self.force, zero, 1.96133, self.maximum, self.freshness, recent)

    def _sensor(self, side: Side, index: int) -> SensorView:
        masked = self.angle is not None and Thresholds().masked(side, index, self.angle)
        return SensorView(side, index, (side, index) in self.occupied, masked, None, self.freshness)


class MovingEngine(FakeEngine):
    """Panel and force swing, sensors come and go, the log grows once a second.

    A run goes on until the file `ends` is there.
    """

    def __init__(self, ends: Path) -> None:
        super().__init__()
        self._began = time.monotonic()
        self._ends = ends

    def start_run(self) -> None:
        """Skip to a running run."""
        start(self, 5.0)
        self._began -= 5.0
        self.do_step(Step.TOUCH)

    def snapshot(self) -> Snapshot:
        before, elapsed = self.now - EPOCH, time.monotonic() - self._began
        if self.run.active and self._ends.exists():
            self.finish()
        if self.run.active:
            self.move(
                elapsed - before,
                lambda since: 0.6 + 0.5 * math.sin(before + since),
                lambda since: 8 * math.sin(3 * (before + since)),
            )
            self.maximum = 9.5
            self.occupied = {(Side.CCW, int(elapsed) % 5)}
            self.recorder = RecorderView("recording", int(elapsed * 350), int(elapsed * 60_000))
            if int(elapsed) > len(self.log):
                self.say(f"event number {int(elapsed)}")
        self.now = EPOCH + elapsed
        return super().snapshot()


def indicators(*, missing: bool = False) -> dict[IndicatorName, Indicator]:
    """All indicators; without a crossing where `missing`."""
    values = chain((17.432, 3.214, 4.5, 12.25, 1.875, 0.0625, 14.75, 6), repeat(1.5))
    gone = (IndicatorName.DOOR_OCCUPATION_TIME, IndicatorName.PASSAGE_TIME)
    return {
        name: Indicator(None, name.spec.unit, "robot never reached the destination side")
        if missing and name in gone
        else Indicator(value, name.spec.unit, None)
        for name, value in zip(IndicatorName, values, strict=False)
    }


def quality(signal: Signal) -> SignalQuality:
    """A good signal."""
    return SignalQuality(signal, 1221, 50.0, 0.0213, 0, 0.0008, 0, 0, 0, 0.004)


def a_setup(run_number: int = 1) -> RunSetup:
    """Condition 1, as the screens propose it at first."""
    return RunSetup(
        subject=1,
        team="Door Bots",
        run_number=run_number,
        condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
        start_pose=StartPose(1.5, 0.0, 180.0),
        referee="Ada",
        timeout=300.0,
        countdown=5.0,
        ruleset=RulesetName.PROTOCOL,
        lock_detection=LockDetection.AUTO,
    )


DURATION = 14.0


def wave(height: float, count: int = 752) -> tuple[Curve, ...]:
    """15 s; the largest value, `height`, at 3.75 s."""
    times = [15.0 * i / count for i in range(count)]
    heights = [height * math.sin(t / 15 * math.tau) for t in times]
    return (Curve(tuple(times), tuple(heights)),)


CURVES = Curves(
    DURATION,
    stretches={
        Quantity.POSITION: wave(1.2),
        Quantity.ACCELERATION: wave(-0.68),
        Quantity.JERK: wave(12.5),
        Quantity.FORCE: wave(18.1),
    },
    events=(
        (0.0, EventName.BENCHMARK_START),
        (2.25, EventName.HANDLE_IS_TOUCHED),
        (3.22, EventName.DOOR_OPENS),
        (8.97, EventName.MOVES_TO_CW),
        (13.86, EventName.DOOR_CLOSES),
        (14.0, EventName.BENCHMARK_STOP),
    ),
)


def start(engine: FakeEngine, duration: float) -> FakeEngine:
    """A run is started, so long before, s."""
    for act in (SetUp(a_setup()), ConfirmPose(), Start()):
        assert engine.act(act) is None
    engine.tick(duration)
    return engine


def prepared() -> FakeEngine:
    """A run goes on."""
    return start(FakeEngine(), 19.0)


def finished(outcome: Outcome = Outcome.COMPLETED) -> FakeEngine:
    """A run with a result."""
    engine = prepared()
    engine.finish(outcome)
    return engine


if __name__ == "__main__":
    from madrob_console.ui.link import ConsoleDefaults
    from madrob_console.ui.terminal import run_console

    moving = MovingEngine(Path(sys.argv[2] if len(sys.argv) > 2 else "never"))
    if "--running" in sys.argv:
        moving.start_run()
    sys.exit(run_console(lambda _: moving, ConsoleDefaults()))
