"""An engine on its testbed, from command line and settings; runs without screens."""

from __future__ import annotations

import argparse
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from socket import gethostname
from types import FrameType
from typing import TypeAlias, assert_never

from madrob_console.cli import chore_worker, options
from madrob_console.cli.batch import named_places, site_arguments
from madrob_console.cli.output import StoppedError
from madrob_console.cli.score_output import result_lines
from madrob_console.common.clock import Clock, SimulationClock, SystemClock, VirtualClock
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.config import Settings
from madrob_console.engine.core.engine_config import EngineConfig, EvidencePlan
from madrob_console.engine.core.event_log import EventLog
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.evidence_client import EvidenceClient
from madrob_console.engine.runtime.replay import Replay
from madrob_console.engine.runtime.reports import Reporting, WantedPages
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.codec import ROBOT_TYPES, referee_topics
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    ConfirmPose,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.checks import CheckState, blocking, causes
from madrob_console.referee.records import CheckName, RunSetup
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import INFO_TOPIC, Source
from scoring.protocol import Outcome

_SEARCH_TIME = 3.0


def open_engine(
    arguments: argparse.Namespace,
    settings: Settings,
    scorer: Scorer | None = None,
) -> Engine:
    """Make the engine that the command line asks for, without opening it.

    `scorer` makes the results of runs in real time; all others, and without it, are made at once.
    """
    kind, replayed = _testbed(arguments, settings)
    types = MessageTypes()
    config = EngineConfig(
        results=options.results_folder(arguments, settings),
        mappings=settings.mappings(),
        thresholds=settings.scoring_thresholds(),
        limits=settings.sensor_limits(),
        competition=settings.competition.name,
        testbed=settings.testbed_name(gethostname()),
        disk_needed=settings.checks.disk_space,
        usual_setup=settings.usual_setup,
        evidence=_evidence_plan(settings),
        lossless=arguments.speed == 0,
    )
    match kind:
        case SourceKind.REPLAY:
            assert replayed is not None
            replay = Replay(replayed, types, arguments.speed)
            config = replace(config, competition=replay.recorded.record.competition)
            return Engine.of_recording(replay, config, types)
        case SourceKind.SIMULATED:
            clock: Clock = VirtualClock(time.time_ns())
            if arguments.speed > 0:
                clock = SystemClock(arguments.speed)
            testbed = simulated_testbed(arguments, settings)
            simulated = SimulatedSource(testbed, clock, types, config.mappings)
            if arguments.speed == 0:
                return Engine(simulated, clock, config, types)
            return Engine(
                simulated, clock, config, types, disk=DiskThreads.threads(), scorer=scorer
            )
        case SourceKind.ROS:
            clock = SimulationClock() if _follows(arguments, settings) else SystemClock()
            source = _ros_source(arguments, settings, types, clock)
            return Engine(
                source,
                clock,
                config,
                types,
                disk=DiskThreads.threads(),
                scorer=scorer,
                evidence_client=_evidence_client(arguments, settings, types),
            )
        case _:
            assert_never(kind)


def _follows(arguments: argparse.Namespace, settings: Settings) -> bool:
    """Whether the engine follows the time of a simulation, `/clock`."""
    from madrob_console.testbeds.ros import asks_for_sim_time

    if arguments.use_sim_time or settings.testbed.use_sim_time:
        return True
    domain = domain_id(options.ros_domain(arguments, settings), os.environ)
    return asks_for_sim_time(domain, arguments.ros_args)


def reporting_of(
    arguments: argparse.Namespace,
    settings: Settings,
    engine: Engine,
    *,
    reports: bool,
) -> Reporting:
    """What makes reports, pages and zips of an engine's runs."""
    wanted = WantedPages(
        reports,
        site_arguments(arguments, settings),
        named_places(arguments, settings),
        settings.results.command_words,
    )
    return Reporting(chore_worker.COMMAND, engine.config.results, wanted)


def _evidence_plan(settings: Settings) -> EvidencePlan | None:
    recording = settings.recording
    if not recording.topics:
        return None
    return EvidencePlan(recording.budget_bytes, 60 * recording.least_room)


def _evidence_client(
    arguments: argparse.Namespace, settings: Settings, types: MessageTypes
) -> EvidenceClient | None:
    if not settings.recording.topics:
        return None
    from madrob_console.engine.runtime.evidence_order import EvidenceOrder
    from madrob_console.engine.runtime.evidence_process import EvidenceProcess

    order = EvidenceOrder(
        domain_id(options.ros_domain(arguments, settings), os.environ),
        settings.recording.choice,
        own_topics(settings, types),
        tuple(arguments.ros_args),
    )
    return EvidenceProcess(order)


def own_topics(settings: Settings, types: MessageTypes) -> tuple[str, ...]:
    own = {mapping.topic for mapping in settings.mappings()}
    own |= {topic.name for topic in referee_topics(types)}
    return (*sorted(own), INFO_TOPIC, *ROBOT_TYPES)


def simulated_testbed(arguments: argparse.Namespace, settings: Settings) -> SimulatedTestbed:
    return SimulatedTestbed(
        arguments.scenario,
        arguments.seed,
        settings.door_geometry(),
        settings.simulated.sensors.settings(),
    )


def _ros_source(
    arguments: argparse.Namespace,
    settings: Settings,
    types: MessageTypes,
    clock: Clock,
    *,
    speaks: bool = True,
) -> Source:
    from madrob_console.testbeds.ros import RosSource

    domain = options.ros_domain(arguments, settings)
    return RosSource(
        settings.mappings(),
        types,
        clock,
        domain,
        speaks=speaks,
        ros_args=arguments.ros_args,
    )


def _testbed(arguments: argparse.Namespace, settings: Settings) -> tuple[SourceKind, Path | None]:
    if arguments.testbed is None:
        kind = settings.testbed.kind
        return (kind, None) if kind else (_find_testbed(arguments, settings), None)
    name, *rest = arguments.testbed
    return SourceKind(name), Path(rest[0]).expanduser() if rest else None


def _find_testbed(arguments: argparse.Namespace, settings: Settings) -> SourceKind:
    """Take ROS where a testbed is alive; a simulation is never taken unasked."""
    practise = "to practise, use `--testbed simulated`"
    if find_spec("rclpy") is None:
        raise MadrobError(
            "no ROS here: source /opt/ros/jazzy/setup.bash or install the `ros` extra; " + practise
        )
    source = _ros_source(arguments, settings, MessageTypes(), SystemClock(), speaks=False)
    source.open()
    try:
        end = time.monotonic() + _SEARCH_TIME
        while time.monotonic() < end:
            source.take_messages(0.1)
            if any(status.publishers for status in source.status()):
                return SourceKind.ROS
    finally:
        source.close()
    raise MadrobError(
        f"no testbed on {source.label}: start it, check the domain, or give `--testbed ros` to "
        f"wait for it; {practise}"
    )


# A run without screens: one plain line for each event.


STEP = 0.02
"""Interval at which the engine receives messages, s of its clock."""

SetupMaker: TypeAlias = Callable[[bool], RunSetup]
"""Makes the set-up of a run, which is simulated or not."""

_LOOK_PERIOD = 0.5
_REST = 1.5


class _LogPrinter:
    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._printed = 0

    def print_new(self) -> None:
        for line in self._log.lines:
            if line.number < self._printed:
                continue
            self._printed = line.number + 1
            clock = "" if line.relative is None else f"{line.relative:+.3f} s"
            print(f"{clock:>12}  {line.origin:<8}  {line.text}", flush=True)


class UnattendedRun:
    """Drives an engine as a referee would, and prints what happens.

    The engine must not be open yet. Without `reporting` there is no report.
    """

    def __init__(self, engine: Engine, reporting: Reporting | None) -> None:
        self._engine = engine
        self._reporting = reporting
        if reporting is not None:
            engine.make_reports = reporting.report
        self._log = _LogPrinter(engine.log)
        self._signal: int | None = None

    def go(
        self, setup: SetupMaker, wait: float, waive: str | None, accept: str | None = None
    ) -> Outcome:
        """Do the run, to its report; returns how it ended.

        `setup` is called when the engine is open. `wait` is for the pre-start checks, s. `waive` is
        the reason to start despite failing checks; None = they must pass. `accept` is the
        reason to accept false starts; None = one aborts the run.

        Raises:
            MadrobError: it did not start; nothing was recorded.
        """
        engine = self._engine
        if self._reporting is not None:
            self._reporting.hold(held=True)
        engine.open()
        # the robot is getting ready: nobody should wait for imports when it is through the door
        engine.warm()
        try:
            self._prepare(setup, wait, waive)
            while engine.scored is None:
                self._step()
                self._decide_false_start(accept)
                self._heed_signal()
        finally:
            engine.close()
            self._log.print_new()
            if self._reporting is not None:
                self._reporting.hold(held=False)
        return self._report()

    def _prepare(self, setup: SetupMaker, wait: float, waive: str | None) -> None:
        engine = self._engine
        simulated = self._set_up(setup)
        self._wait_for_checks(wait)
        if engine.source.announcement.simulated is not None and not simulated:
            self._set_up(setup)  # it is heard only now
        if problem := engine.source.sides_problem:
            print(f"note: {terminal_safe(problem)}", flush=True)
        for check in engine.situation().checks:
            if check.state is CheckState.WARNING:
                print(terminal_safe(f"note: {check.name}: {check.reason}"), flush=True)
        self._do(ZeroHandle())
        self._do(ConfirmPose())
        if waive is not None:
            for check in blocking(engine.situation().checks):
                self._do(Waive(check.name, waive))
        for check in causes(engine.situation().checks):  # a program has no screen to look at
            print(terminal_safe(f"note: {check.name}: {check.reason}"), flush=True)
        self._do(Start())

    def _set_up(self, setup: SetupMaker) -> bool:
        """Set the run up and print the testbed; returns whether it is known to be simulated."""
        simulated = self._engine.source.announcement.simulated is not None
        self._do(SetUp(setup(simulated)))
        print(f"testbed: {self._engine.snapshot().label}", flush=True)
        return simulated

    def _wait_for_checks(self, wait: float) -> None:
        lists = (CheckName.TEAM, CheckName.PLAN)
        by_hand = (*lists, CheckName.POSE, CheckName.HANDLE, CheckName.HANDLE_ZERO)
        begin = looked = self._engine.now()
        while (now := self._engine.now()) < begin + wait:
            self._step()
            if self._signal is not None:
                raise StoppedError("stopped before the start; nothing was recorded", self._signal)
            if now < begin:
                begin = looked = now  # the clock was set back: to that of a simulation, say
            if now < max(begin + _REST, looked + _LOOK_PERIOD):
                continue
            looked = now
            if all(c.name in by_hand for c in blocking(self._engine.situation().checks)):
                return

    def _do(self, act: Act) -> None:
        refused = self._engine.perform(act)
        self._log.print_new()
        if refused is not None:
            raise MadrobError(f"{act.name} refused: {refused}")

    def _step(self) -> None:
        self._engine.step(STEP, lambda: self._signal is not None)
        self._log.print_new()

    def _decide_false_start(self, accept: str | None) -> None:
        if self._engine.run.held is None:
            return
        if accept:
            self._do(AcceptFalseStart(accept))
            return
        print("note: --accept-false-start WHY lets a false start pass", flush=True)
        self._do(Abort("false start, and no referee to accept it"))

    def _heed_signal(self) -> None:
        if self._signal is None:
            return
        if self._engine.run.active:
            self._engine.perform(Abort(f"madrob run was ended by {self._name_of_signal()}"))
        self._signal = None

    def _name_of_signal(self) -> str:
        return signal.Signals(self._signal or 0).name

    @contextmanager
    def stopping_on_signals(self) -> Iterator[None]:
        """Let SIGINT, SIGTERM and SIGHUP abort the run while inside; it is kept as invalid."""

        def note(number: int, _frame: FrameType | None) -> None:
            self._signal = number

        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = {number: signal.signal(number, note) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _report(self) -> Outcome:
        scored = self._engine.scored
        assert scored is not None
        for line in result_lines(scored.result, scored.flags):
            print(line)
        if self._engine.refused:
            print(self._engine.refused)
        if self._reporting is not None:
            self._wait_for_report(self._reporting)
        print(f"run folder: {self._engine.folder}", flush=True)
        return scored.result.outcome

    def _wait_for_report(self, reporting: Reporting) -> None:
        self._signal = None
        while not reporting.wait(_LOOK_PERIOD) and self._signal is None:
            pass
        if reporting.problem is not None:
            print(reporting.problem)
