"""From the command line and the settings to an engine on its testbed."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from socket import gethostname
from typing import assert_never

from madrob_console.cli import options
from madrob_console.clock import Clock, SimulationClock, SystemClock, VirtualClock
from madrob_console.config import Settings
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.keeper import Keepers
from madrob_console.engine.live.replay import Replay
from madrob_console.engine.live.scorer import InlineScorer, Scorer
from madrob_console.engine.live.witness import EvidencePlan, Witness
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import MessageTypes, referee_topics
from madrob_console.testbeds.announcement import INFO_TOPIC
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.simulated import Network, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import Source

_SEARCH_TIME = 3.0


def open_engine(
    arguments: argparse.Namespace,
    settings: Settings,
    scorer: Callable[[], Scorer] = InlineScorer,
) -> Engine:
    """The engine that the command line asks for; not opened yet.

    Args:
        arguments: the command line.
        settings: of the testbed.
        scorer: what makes the results of runs in real time; else they are made at once.

    Raises:
        MadrobError: the testbed does not exist or cannot be used.
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
        protest_times=settings.protest_times(),
        disk_needed=settings.checks.disk_space,
        evidence=_evidence_plan(settings),
        lossless=arguments.speed == 0,
    )
    match kind:
        case SourceKind.REPLAY:
            assert replayed is not None
            return Engine.of_recording(Replay(replayed, types, arguments.speed), config, types)
        case SourceKind.SIMULATED:
            clock: Clock = VirtualClock(time.time_ns())
            if arguments.speed > 0:
                clock = SystemClock(arguments.speed)
            testbed = simulated_testbed(arguments, settings)
            simulated = SimulatedSource(testbed, clock, types, config.mappings)
            if arguments.speed == 0:
                return Engine(simulated, clock, config, types)
            return Engine(
                simulated, clock, config, types, keepers=Keepers.threads(), scorer=scorer()
            )
        case SourceKind.ROS:
            follows = arguments.use_sim_time or settings.testbed.use_sim_time
            clock = SimulationClock() if follows else SystemClock()
            source = _ros_source(arguments, settings, types, clock)
            return Engine(
                source,
                clock,
                config,
                types,
                keepers=Keepers.threads(),
                scorer=scorer(),
                witness=_witness(arguments, settings, types),
            )
        case _:
            assert_never(kind)


def _evidence_plan(settings: Settings) -> EvidencePlan | None:
    recording = settings.recording
    if not recording.topics:
        return None
    return EvidencePlan(recording.budget_bytes, 60 * recording.least_room)


def _witness(
    arguments: argparse.Namespace, settings: Settings, types: MessageTypes
) -> Witness | None:
    """What records the evidence of a ROS domain; None where none is wanted."""
    if not settings.recording.topics:
        return None
    from madrob_console.engine.process.evidence_messages import ListenFor
    from madrob_console.engine.process.evidence_process import EvidenceProcess

    observe = ListenFor(
        domain_id(options.ros_domain(arguments, settings), os.environ),
        settings.recording.choice,
        own_topics(settings, types),
        tuple(arguments.ros_args),
    )
    return EvidenceProcess(observe)


def own_topics(settings: Settings, types: MessageTypes) -> tuple[str, ...]:
    """The topics that are recorded whatever is wanted as evidence: the testbed's and our own."""
    own = {mapping.topic for mapping in settings.mappings()}
    return (*sorted(own | {topic.name for topic in referee_topics(types)}), INFO_TOPIC)


def simulated_testbed(arguments: argparse.Namespace, settings: Settings) -> SimulatedTestbed:
    """The simulated testbed of the settings, with the robot and network of the command line."""
    return SimulatedTestbed(
        arguments.scenario,
        arguments.seed,
        settings.door_geometry(),
        settings.simulated.sensors.settings(),
        settings.simulated.robot.settings(),
        Network(options.delays(arguments.latency), options.delays(arguments.jitter)),
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
            source.take(0.1)
            if any(status.publishers for status in source.status()):
                return SourceKind.ROS
    finally:
        source.close()
    raise MadrobError(
        f"no testbed on {source.label}: start it, check the domain, or give `--testbed ros` to "
        f"wait for it; {practise}"
    )
