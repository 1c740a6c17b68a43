"""What the commands take that run the benchmark."""

from __future__ import annotations

import argparse
from pathlib import Path

from madrob_console.cli.arguments_common import (
    Commands,
    add_condition_options,
    add_scenario_options,
    add_settings_option,
    add_testbed_options,
    command,
)
from madrob_console.kinds import ThemeName
from scoring.protocol import LockDetection
from scoring.rulesets import RulesetName


def add_console(commands: Commands) -> None:
    """`madrob console`."""
    parser = command(
        commands,
        "console",
        "the referee's screens: set up, start, watch and score runs",
        "Without --testbed it takes the live testbed if one is found.",
    )
    add_testbed_options(parser)
    parser.add_argument(
        "--from",
        dest="begin_at",
        type=float,
        default=None,
        metavar="SECONDS",
        help="where a replay begins, from the start of its run",
    )
    _add_idle_time(parser)
    _add_look(parser)


def add_watch(commands: Commands) -> None:
    """`madrob watch`."""
    parser = command(
        commands,
        "watch",
        "the same screens for spectators: they show everything and can do nothing",
        "Attaches to the engine of the testbed that is named, or to the only one that runs.",
    )
    add_testbed_options(parser)
    _add_look(parser)


def add_engine(commands: Commands) -> None:
    """`madrob engine`."""
    parser = command(
        commands,
        "engine",
        "the process behind the screens: `status`, `stop`, `serve`",
        "`madrob console` starts it by itself. `serve` runs it in the foreground, for systemd.",
    )
    parser.add_argument("action", choices=("status", "stop", "serve"))
    parser.add_argument("--force", action="store_true", help="stop: even while a run goes on")
    add_testbed_options(parser)
    _add_idle_time(parser)


def _add_idle_time(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--idle-time",
        type=float,
        default=None,
        help="s without a screen and without a run after which the engine ends",
    )


def _add_look(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--teams", type=Path, default=None, help="teams file: csv lines of subject,team"
    )
    parser.add_argument("--theme", type=ThemeName, choices=list(ThemeName), default=None)
    parser.add_argument(
        "--ascii", action="store_true", default=None, help="draw with ASCII characters only"
    )
    parser.add_argument("--no-bell", action="store_true", help="be silent")
    parser.add_argument("--no-mouse", action="store_true", help="leave the mouse to the terminal")


def add_run(commands: Commands) -> None:
    """`madrob run`."""
    parser = command(
        commands,
        "run",
        "one run without screens, a line per event",
        "Waits for the testbed, zeroes the handle, starts, records, scores. The last line is "
        "`run folder: PATH`. Exit code 0 completed, 3 timeout, 4 aborted or invalid, "
        "5 interrupted, 2 bad input or a refusal.",
    )
    add_testbed_options(parser)
    parser.add_argument("--subject", type=int, default=1, help="the robot's number")
    parser.add_argument("--team", default="", help="the team's name")
    parser.add_argument("--referee", default=None, help="the referee's name; else the settings'")
    parser.add_argument(
        "--run", type=int, default=None, help="run number; the next free one if not given"
    )
    add_condition_options(parser)
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


def add_testbed(commands: Commands) -> None:
    """`madrob testbed`."""
    parser = command(
        commands,
        "testbed",
        "the simulated testbed as a ROS 2 node",
        "The robot sets out when /madrob/referee/state says that the run is running.",
    )
    add_scenario_options(parser)
    add_condition_options(parser)
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")
    parser.add_argument("--repeat", type=int, default=1, help="runs before it ends; 0 = no end")
    add_settings_option(parser)
