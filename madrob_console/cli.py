"""The `madrob` command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NoReturn, TypeAlias

from madrob_console.errors import MadrobError
from madrob_console.report import PictureFormat
from madrob_console.theme_name import ThemeName
from recorder.errors import RecorderError
from scoring.errors import ScoringError
from scoring.protocol import BenchmarkType, LockDetection, Side
from scoring.rulesets import RulesetName

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""

SCENARIOS = (
    "nominal",
    "jerky",
    "slam",
    "slow",
    "no-touch",
    "touch-only",
    "open-only",
    "no-close",
    "turns-back",
    "closes-under-sensors",
    "bounces",
    "random",
)

_EXIT_CODES = """\
exit codes of `madrob run`: 0 completed, 3 timeout, 4 aborted or invalid, 5 interrupted,
2 bad input or a refusal. Settings: `madrob settings` prints the file with every default."""


def software_version() -> str:
    """The installed version of the console."""
    try:
        return version("madrob-console")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "0+unknown"


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see `{self.prog} --help`\n")


def build_parser() -> argparse.ArgumentParser:
    """The command line, complete with help texts."""
    parser = _Parser(
        prog="madrob",
        description="Referee console for the MADROB robot-door benchmark.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"madrob {software_version()}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_console(commands)
    _add_watch(commands)
    _add_engine(commands)
    _add_run(commands)
    _add_testbed(commands)
    _add_score(commands)
    _add_report(commands)
    _add_recover(commands)
    _add_doctor(commands)
    _add_settings(commands)
    return parser


_Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"


def _command(commands: _Commands, name: str, text: str, more: str = "") -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}. {more}".rstrip(),
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.set_defaults(module=name)
    return parser


def _add_console(commands: _Commands) -> None:
    parser = _command(
        commands,
        "console",
        "the referee's screens: set up, start, watch and score runs",
        "Without --testbed it takes the live testbed if one is found.",
    )
    _add_testbed_options(parser)
    _add_idle_time(parser)
    _add_look(parser)


def _add_watch(commands: _Commands) -> None:
    parser = _command(
        commands,
        "watch",
        "the same screens for spectators: they show everything and can do nothing",
        "Attaches to the engine of the testbed that is named, or to the only one that runs.",
    )
    _add_testbed_options(parser)
    _add_look(parser)


def _add_engine(commands: _Commands) -> None:
    parser = _command(
        commands,
        "engine",
        "the process behind the screens: `status`, `stop`, `serve`",
        "`madrob console` starts it by itself. `serve` runs it in the foreground, for systemd.",
    )
    parser.add_argument("action", choices=("status", "stop", "serve"))
    parser.add_argument("--force", action="store_true", help="stop: even while a run goes on")
    _add_testbed_options(parser)
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


def _add_run(commands: _Commands) -> None:
    parser = _command(
        commands,
        "run",
        "one run without screens, a line per event",
        "Waits for the testbed, zeroes the handle, starts, records, scores. The last line is "
        "`run folder: PATH`. Exit code 0 completed, 3 timeout, 4 aborted or invalid, "
        "5 interrupted, 2 bad input or a refusal.",
    )
    _add_testbed_options(parser)
    parser.add_argument("--subject", type=int, default=1, help="the robot's number")
    parser.add_argument("--team", default="", help="the team's name")
    parser.add_argument("--referee", default=None, help="the referee's name; else the settings'")
    parser.add_argument(
        "--run", type=int, default=None, help="run number; the next free one if not given"
    )
    _add_condition_options(parser)
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


def _add_testbed(commands: _Commands) -> None:
    parser = _command(
        commands,
        "testbed",
        "the simulated testbed as a ROS 2 node",
        "The robot sets out when /madrob/referee/state says that the run is running.",
    )
    _add_scenario_options(parser)
    _add_condition_options(parser)
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")
    parser.add_argument("--repeat", type=int, default=1, help="runs before it ends; 0 = no end")
    _add_settings_option(parser)


def _add_score(commands: _Commands) -> None:
    parser = _command(
        commands,
        "score",
        "score recorded runs",
        "PATH is a bag, a run folder or a folder of EUROBENCH csv files.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument(
        "--ruleset",
        type=RulesetName,
        choices=list(RulesetName),
        default=None,
        help="the rules; those of the run if not given",
    )
    parser.add_argument("--json", action="store_true", help="JSON for programs")


def _add_report(commands: _Commands) -> None:
    parser = _command(
        commands,
        "report",
        "a page for the team: report.html in the run folder, or the figures alone",
        "PATH is a run folder, a results folder or a bag; of EUROBENCH folders the figures only.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument(
        "--figures",
        type=PictureFormat,
        choices=list(PictureFormat),
        default=None,
        help="figures of this format instead of the page",
    )
    parser.add_argument(
        "--output", type=Path, default=None, help="folder for all pages, <run>_report.html each"
    )


def _add_recover(commands: _Commands) -> None:
    parser = _command(
        commands,
        "recover",
        "repair recordings that were cut off",
        "Writes a whole bag beside the torn one, which is kept. PATH is a run folder or a bag.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")


def _add_doctor(commands: _Commands) -> None:
    parser = _command(commands, "doctor", "what is installed, found and missing")
    _add_settings_option(parser)
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")


def _add_settings(commands: _Commands) -> None:
    parser = _command(
        commands,
        "settings",
        "check the settings file; print one with every default",
    )
    _add_settings_option(parser)


def _add_testbed_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--testbed",
        nargs="+",
        metavar=("ros|simulated|replay", "PATH"),
        default=None,
        help="where the data come from: `ros`, `simulated`, or `replay` and the path of a bag",
    )
    _add_scenario_options(parser)
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="of a simulation or replay: 1 = real time, 0 = as fast as possible",
    )
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")
    parser.add_argument("--results", type=Path, default=None, help="results folder")
    _add_settings_option(parser)


def _add_settings_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--settings", type=Path, default=None, help="settings file (TOML)")


def _add_scenario_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scenario",
        choices=SCENARIOS,
        default="nominal",
        help="what the simulated robot does",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")


def _add_condition_options(parser: argparse.ArgumentParser) -> None:
    sides = list(Side)
    parser.add_argument("--opening-side", type=Side, choices=sides, default=Side.CCW)
    parser.add_argument("--starting-side", type=Side, choices=sides, default=Side.CCW)
    parser.add_argument(
        "--benchmark-type",
        type=BenchmarkType,
        choices=list(BenchmarkType),
        default=BenchmarkType.NO_FORCE,
    )


def _pose(text: str) -> tuple[float, float, float]:
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no pose: give x,y,yaw in m, m and degrees, as in 1.5,0,180"
        ) from None
    return x, y, yaw


def _with_pose(argv: Sequence[str]) -> list[str]:
    """Tie a pose to its flag: argparse takes `-1.5,0,0` for a flag of its own."""
    tied: list[str] = []
    for argument in argv:
        if tied and tied[-1] == "--start-pose":
            tied[-1] += f"={argument}"
        else:
            tied.append(argument)
    return tied


def main(argv: Sequence[str] | None = None) -> int:
    """Run `madrob`; returns the exit code."""
    arguments = build_parser().parse_args(_with_pose(sys.argv[1:] if argv is None else argv))
    command: Callable[[argparse.Namespace], int] = import_module(
        f"madrob_console.commands.{arguments.module}"
    ).main
    try:
        return command(arguments)
    except (MadrobError, RecorderError, ScoringError) as error:
        print(f"madrob: {error}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:  # `madrob score ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
