"""`madrob watch`: the referee's screens for spectators."""

from __future__ import annotations

import argparse

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument, OneOf, command
from madrob_console.cli.console_command import LOOK, Shown, show


def _shown(flag: str, shown: Shown, text: str) -> Argument:
    return Argument(
        flag, dest="shown", action="store_const", const=shown, default=Shown.SCREENS, help=text
    )


@command(
    "watch",
    "the same screens for spectators, who can do nothing",
    "Attaches to the engine of the testbed that is named, or without arguments to the only one "
    "that runs; where several run it says what to type.",
    options=(
        *options.TESTBED,
        OneOf(
            _shown("--big", Shown.WALL, "a wall display: clock, state, team and steps"),
            _shown("--plain", Shown.PLAIN, "the lines of the event log, without screens"),
            _shown(
                "--json", Shown.JSON, "a JSON object for each change of the state, for programs"
            ),
        ),
        *LOOK,
    ),
    examples=(
        "madrob watch",
        "madrob watch --testbed ros --domain 41",
        "madrob watch --big    # a wall display",
        "madrob watch --plain  # for a screen reader, a log, a chat",
        "madrob watch --json   # for a program; `madrob guide robots` says what it reads",
    ),
)
def watch(arguments: argparse.Namespace) -> int:
    from madrob_console.engine.requests import Role

    return show(arguments, Role.WATCH, arguments.shown)
