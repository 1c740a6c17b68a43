"""`madrob watch`: the referee's screens for spectators."""

from __future__ import annotations

import argparse

from madrob_console.cli import options
from madrob_console.cli.console_command import add_look_options, show


def add_command(commands: options.Commands) -> None:
    parser = options.command(
        commands,
        "watch",
        main,
        "the same screens for spectators: they show everything and can do nothing",
        "Attaches to the engine of the testbed that is named, or without arguments to the only one "
        "that runs; where several run it says what to type.",
        examples=("madrob watch", "madrob watch --testbed ros --domain 41", "madrob watch --big"),
    )
    options.add_testbed(parser)
    parser.add_argument(
        "--big", action="store_true", help="a wall display: clock, state and team over the screen"
    )
    add_look_options(parser)


def main(arguments: argparse.Namespace) -> int:
    from madrob_console.engine.requests import Role

    return show(arguments, Role.WATCH, wall=arguments.big)
