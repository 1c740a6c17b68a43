"""What several commands take."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NoReturn, TypeAlias

from scoring.protocol import BenchmarkType, Side

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


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line."""

    def error(self, message: str) -> NoReturn:
        """End with the exit code of bad input."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see `{self.prog} --help`\n")


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def command(commands: Commands, name: str, text: str, more: str = "") -> argparse.ArgumentParser:
    """The parser of one command.

    Args:
        commands: all of them; it is added to them.
        name: the command.
        text: what it does, as the list of commands says it.
        more: what its own help says beyond that.
    """
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}. {more}".rstrip(),
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.set_defaults(module=name)
    return parser


def add_testbed_options(parser: argparse.ArgumentParser) -> None:
    """Where the data come from and the results go."""
    parser.add_argument(
        "--testbed",
        nargs="+",
        metavar=("ros|simulated|replay", "PATH"),
        default=None,
        help="where the data come from: `ros`, `simulated`, or `replay` and the path of a bag",
    )
    add_scenario_options(parser)
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="of a simulation or replay: 1 = real time, 0 = as fast as possible",
    )
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")
    parser.add_argument("--results", type=Path, default=None, help="results folder")
    add_settings_option(parser)


def add_settings_option(parser: argparse.ArgumentParser) -> None:
    """The settings file."""
    parser.add_argument("--settings", type=Path, default=None, help="settings file (TOML)")


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """What the simulated robot does."""
    parser.add_argument(
        "--scenario",
        choices=SCENARIOS,
        default="nominal",
        help="what the simulated robot does",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")


def add_condition_options(parser: argparse.ArgumentParser) -> None:
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
