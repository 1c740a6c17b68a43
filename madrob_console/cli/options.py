"""The options that several commands have, and what they come to with the settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from madrob_console.cli.problems import BAD_INPUT
from madrob_console.kinds import Scenario
from scoring.protocol import BenchmarkType, Condition, Side

if TYPE_CHECKING:
    from madrob_console.config import Settings


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line."""

    def error(self, message: str) -> NoReturn:
        """End with the exit code of bad input."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see `{self.prog} --help`\n")


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"

Main: TypeAlias = Callable[[argparse.Namespace], int]
"""Carries a command out and returns its exit code."""


def command(
    commands: Commands, name: str, main: Main | None, text: str, more: str = ""
) -> argparse.ArgumentParser:
    """The parser of one command.

    Args:
        commands: all of them; it is added to them.
        name: the command.
        main: carries it out; None = its parts do.
        text: what it does, as the list of commands says it.
        more: what its own help says beyond that.
    """
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}. {more}".rstrip(),
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.set_defaults(main=main)
    return parser


def add_testbed(parser: argparse.ArgumentParser) -> None:
    """Where the data come from and the results go."""
    parser.add_argument(
        "--testbed",
        nargs="+",
        metavar=("ros|simulated|replay", "PATH"),
        default=None,
        help="where the data come from: `ros`, `simulated`, or `replay` and the path of a bag",
    )
    add_scenario(parser)
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="of a simulation or replay: 1 = real time, 0 = as fast as possible",
    )
    add_domain(parser)
    add_results(parser)
    add_settings(parser)


def add_domain(parser: argparse.ArgumentParser) -> None:
    """The ROS domain."""
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")


def ros_domain(arguments: argparse.Namespace, settings: Settings) -> int | None:
    """The ROS domain; None = `ROS_DOMAIN_ID`, or 0."""
    chosen: int | None = arguments.domain
    return settings.testbed.domain if chosen is None else chosen


def add_results(parser: argparse.ArgumentParser) -> None:
    """The results folder."""
    parser.add_argument("--results", type=Path, default=None, help="results folder")


def results_folder(arguments: argparse.Namespace, settings: Settings) -> Path:
    """Where the runs are kept."""
    chosen: Path = arguments.results or settings.results.root
    return chosen.expanduser().absolute()


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The settings file."""
    parser.add_argument("--settings", type=Path, default=None, help="settings file (TOML)")


def add_idle_time(parser: argparse.ArgumentParser) -> None:
    """How long an engine stays that nobody needs."""
    parser.add_argument(
        "--idle-time",
        type=float,
        default=None,
        help="s without a screen and without a run after which the engine ends",
    )


def add_scenario(parser: argparse.ArgumentParser) -> None:
    """What the simulated robot does."""
    parser.add_argument(
        "--scenario",
        choices=[*map(str, Scenario)],
        default=str(Scenario.NOMINAL),
        help="what the simulated robot does",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")


def add_condition(parser: argparse.ArgumentParser) -> None:
    """The condition, in its three parts (protocol section 1)."""
    sides = list(Side)
    parser.add_argument("--opening-side", type=Side, choices=sides, default=Side.CCW)
    parser.add_argument("--starting-side", type=Side, choices=sides, default=Side.CCW)
    parser.add_argument(
        "--benchmark-type",
        type=BenchmarkType,
        choices=list(BenchmarkType),
        default=BenchmarkType.NO_FORCE,
    )


def condition_of(arguments: argparse.Namespace) -> Condition:
    """The condition that was chosen."""
    return Condition(arguments.benchmark_type, arguments.opening_side, arguments.starting_side)
