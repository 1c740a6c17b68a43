"""`madrob run`: one run without screens, a plain line per event."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.kinds import SourceKind
from madrob_console.names import clean_name
from scoring.imports import imports_kept
from scoring.protocol import LockDetection, Outcome, StartPose
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.config import Settings
    from madrob_console.engine.live.core import Engine
    from madrob_console.referee.run import RunSetup

EXIT_CODES = {
    Outcome.COMPLETED: 0,
    Outcome.TIMEOUT: 3,
    Outcome.ABORTED: 4,
    Outcome.INTERRUPTED: 5,
}


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "run",
        main,
        "one run without screens, a line per event",
        "Waits for the testbed, zeroes the handle, starts, records, scores. The last line is "
        "`run folder: PATH`. Exit code 0 completed, 3 timeout, 4 aborted or invalid, "
        "5 interrupted, 2 bad input or a refusal.",
    )
    options.add_testbed(parser)
    parser.add_argument("--subject", type=int, default=1, help="the robot's number")
    parser.add_argument("--team", default="", help="the team's name")
    parser.add_argument("--referee", default=None, help="the referee's name; else the settings'")
    parser.add_argument(
        "--run", type=int, default=None, help="run number; the next free one if not given"
    )
    options.add_condition(parser)
    parser.add_argument(
        "--start-pose",
        type=_pose,
        default=None,
        metavar="X,Y,YAW",
        help="m, m, degrees in the frame madrob_door; the settings' pose of the side if not given",
    )
    parser.add_argument("--timeout", type=float, default=None, help="s; else the settings'")
    parser.add_argument("--countdown", type=float, default=None, help="s; else the settings'")
    parser.add_argument("--ruleset", type=RulesetName, choices=list(RulesetName), default=None)
    parser.add_argument(
        "--lock-detection", type=LockDetection, choices=list(LockDetection), default=None
    )
    parser.add_argument(
        "--wait", type=float, default=20.0, help="s to wait for the pre-start checks"
    )
    parser.add_argument(
        "--waive", metavar="REASON", default=None, help="let failing pre-start checks pass"
    )
    parser.add_argument("--no-report", action="store_true", help="make no report.html")


def _pose(text: str) -> tuple[float, float, float]:
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no pose: give x,y,yaw in m, m and degrees, as in 1.5,0,180"
        ) from None
    return x, y, yaw


def main(arguments: argparse.Namespace) -> int:
    """One run from the set-up to its result."""
    with imports_kept():
        from madrob_console.cli import aside
        from madrob_console.cli.attaching import engine_place
        from madrob_console.cli.session import open_engine
        from madrob_console.cli.unattended import UnattendedRun, print_replay
        from madrob_console.config import load_settings
        from madrob_console.engine.process.reporting import Reporting

    settings = load_settings(arguments.settings)
    engine = open_engine(arguments, settings)
    if engine.replay is not None:
        return EXIT_CODES[print_replay(engine, engine.replay)]
    live = engine.source.kind is SourceKind.ROS
    reports = settings.results.reports and not arguments.no_report
    reporting = Reporting(aside.COMMAND, lambda: engine.busy) if reports else None
    run = UnattendedRun(engine, reporting)
    alone = engine_place(arguments, settings).taken() if live else nullcontext()
    with alone, run.stopping_on_signals():
        setup = partial(_setup, arguments, settings, engine)
        return EXIT_CODES[run.go(setup, arguments.wait, arguments.waive)]


def _setup(arguments: argparse.Namespace, settings: Settings, engine: Engine) -> RunSetup:
    from madrob_console.referee.run import RunSetup

    condition = options.condition_of(arguments)
    number = arguments.run
    if number is None:
        number = engine.next_run_number(arguments.subject, condition.number)
    referee = arguments.referee
    if referee is None:
        referee = settings.competition.referee
    defaults = settings.run
    pose = arguments.start_pose
    start_pose = StartPose(*pose) if pose else settings.start_pose(condition.starting_side)
    return RunSetup(
        subject=arguments.subject,
        team=clean_name(arguments.team, "--team"),
        run_number=number,
        condition=condition,
        start_pose=start_pose,
        referee=clean_name(referee, "--referee"),
        timeout=defaults.timeout if arguments.timeout is None else arguments.timeout,
        countdown=defaults.countdown if arguments.countdown is None else arguments.countdown,
        ruleset=arguments.ruleset or defaults.ruleset,
        lock_detection=arguments.lock_detection or defaults.lock_detection,
    )
