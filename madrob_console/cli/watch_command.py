"""`madrob watch`: the referee's screens for spectators."""

from __future__ import annotations

import argparse

from madrob_console.cli import options
from madrob_console.cli.console_command import Shown, add_look_options, show


def add_command(commands: options.Commands) -> None:
    parser = options.command(
        commands,
        "watch",
        main,
        "the same screens for spectators: they show everything and can do nothing",
        "Attaches to the engine of the testbed that is named, or without arguments to the only one "
        "that runs; where several run it says what to type.",
        examples=(
            "madrob watch",
            "madrob watch --testbed ros --domain 41",
            "madrob watch --big    # a wall display",
            "madrob watch --plain  # for a screen reader, a log, a chat",
            "madrob watch --json   # for a program; `madrob schema watch` says what it reads",
        ),
    )
    options.add_testbed(parser)
    shown = parser.add_mutually_exclusive_group()
    for option, value, text in (
        ("--big", Shown.WALL, "a wall display: clock, state, team and steps over the screen"),
        ("--plain", Shown.PLAIN, "an English sentence for each event, without screens"),
        ("--json", Shown.JSON, "a JSON object for each change of the state, without screens"),
    ):
        shown.add_argument(option, dest="shown", action="store_const", const=value, help=text)
    parser.set_defaults(shown=Shown.SCREENS)
    add_look_options(parser)


def main(arguments: argparse.Namespace) -> int:
    from madrob_console.engine.requests import Role

    return show(arguments, Role.WATCH, shown=arguments.shown)
