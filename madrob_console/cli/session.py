"""An engine on its testbed, from command line and settings."""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from socket import gethostname
from typing import assert_never

from madrob_console.cli import chore_worker, option_values
from madrob_console.cli.chosen_runs import named_places, site_arguments
from madrob_console.common.clock import Clock, SystemClock, VirtualClock
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.config import Settings
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.evidence_process import EvidenceProcess
from madrob_console.engine.runtime.replay import Replay
from madrob_console.engine.runtime.reports import Reporting, WantedPages
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import Source

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
        results=option_values.results_folder(arguments, settings),
        mappings=settings.mappings(),
        thresholds=settings.scoring_thresholds(),
        limits=settings.sensor_limits(),
        competition=settings.competition.name,
        testbed=settings.testbed_name(gethostname()),
        disk_needed=settings.checks.disk_space,
        usual_setup=settings.usual_setup,
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
            clock = SystemClock()
            source = _ros_source(arguments, settings, types, clock)
            return Engine(
                source,
                clock,
                config,
                types,
                disk=DiskThreads.threads(),
                scorer=scorer,
                evidence=_evidence_process(arguments, settings),
            )
        case _:
            assert_never(kind)


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
    )
    return Reporting(chore_worker.COMMAND, engine.config.results, wanted)


def _evidence_process(arguments: argparse.Namespace, settings: Settings) -> EvidenceProcess | None:
    topics = settings.evidence.topics
    if not topics:
        return None
    domain = domain_id(option_values.ros_domain(arguments, settings), os.environ)
    return EvidenceProcess(domain, topics, settings.checks.disk_space)


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

    domain = option_values.ros_domain(arguments, settings)
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
