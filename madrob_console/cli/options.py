"""The options that several commands have."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from enum import StrEnum

from madrob_console.cli.command_line import Argument, WordsAction
from madrob_console.cli.parsing import as_path, number_within, one_of, whole_number, whole_within
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario, SourceKind
from madrob_console.testbeds.ros_domain import domain_number
from scoring.protocol import BenchmarkType, Side

FASTEST = 1000.0
"""Highest speed of a simulation or replay, times real time."""

_SHORT = 40
"""Longer lists of words stand in the text of an option, not beside its name."""


def choice(flag: str, words: type[StrEnum], text: str, default: StrEnum | None = None) -> Argument:
    """An option that takes one of some words."""
    metavar = None
    if len(listed := ", ".join(words)) > _SHORT:
        metavar = flag.rpartition("-")[2].upper()
        text = f"{text}: {listed}"
    return Argument(
        flag, type=one_of(words), choices=list(words), default=default, metavar=metavar, help=text
    )


SETTINGS = Argument(
    "--settings",
    type=as_path,
    metavar="FILE",
    help="settings file (TOML); else ~/.config/madrob/madrob.toml",
)
RESULTS = (
    Argument(
        "--results",
        type=as_path,
        metavar="FOLDER",
        help="results folder; else setting `results.folder`",
    ),
    Argument(
        "--rehearsal",
        action="store_true",
        help="the rehearsal of the competition, in the folder of this name with `_rehearsal`",
    ),
)
PATHS = Argument(
    "paths",
    nargs="+",
    type=as_path,
    metavar="PATH",
    help="run folders, bags, or folders with runs at any depth",
)
COMPETITION = Argument(
    "--competition",
    metavar="NAME",
    help="only runs of the competition of this name; '' = of none",
)
"""Every competition has a team number 1."""

COLLECTION = (
    Argument(
        "paths",
        nargs="*",
        type=as_path,
        metavar="PATH",
        help="folders with runs, at any depth, each run once; else the results folder",
    ),
    *RESULTS,
    Argument(
        "--testbed-name",
        metavar="NAME",
        help="only runs of the testbed of this name, as its settings call it",
    ),
    COMPETITION,
)
"""What `collection` reads."""

PRACTICE = Argument(
    "--practice", action="store_true", help="the practice runs instead, marked as such"
)
TEAMS = Argument(
    "--teams",
    type=as_path,
    metavar="FILE",
    help="the list of teams, csv lines of subject,team; else the settings'",
)
PLAN = Argument(
    "--plan",
    type=as_path,
    metavar="FILE",
    help="the competition's plan, csv lines of subject,condition,attempts,time; else the settings'",
)
JSON = Argument("--json", action="store_true", help="JSON for programs")
JOBS = Argument(
    "--jobs",
    type=whole_within(1),
    metavar="N",
    help="runs at once; as many as there are cores if not given",
)

INSTANT = (
    "s from the start (12.5, 1:05), `start`, `stop`, `protest` (the instant in question), or an "
    "event, mark or protest by its name (door_opens, 'protest 1')"
)

run_number = whole_within(1, 999)
"""Argument type of a team or a run: file names have three digits for them."""

CONDITION = (
    choice("--opening-side", Side, "side towards which the door may open", Side.CCW),
    choice("--starting-side", Side, "side on which the robot starts", Side.CCW),
    choice(
        "--benchmark-type",
        BenchmarkType,
        "force with which the door is braked",
        BenchmarkType.NO_FORCE,
    ),
)
"""Protocol section 1."""


def subject(default: int | None = None) -> Argument:
    """The team, by its number (protocol section 1)."""
    return Argument(
        "--subject", type=run_number, default=default, metavar="N", help="the team's number"
    )


def _domain(text: str) -> int:
    try:
        return domain_number(text)
    except MadrobError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _testbed(words: Sequence[str]) -> Sequence[str]:
    kind = one_of(SourceKind)(words[0])
    if kind is not SourceKind.REPLAY and len(words) > 1:
        raise argparse.ArgumentTypeError(f"{kind} takes nothing more, not '{words[1]}'")
    if kind is SourceKind.REPLAY and len(words) != 2:
        raise argparse.ArgumentTypeError(f"{kind} needs the path of one bag")
    return words


SIMULATION = ("scenario", "seed", "speed")
"""Options that tell one simulated testbed from another."""

SIMULATED = (
    choice("--scenario", Scenario, "what the simulated robot does", Scenario.NOMINAL),
    Argument("--seed", type=whole_number, default=0, metavar="N", help="of the simulation"),
)
DOMAIN = Argument(
    "--domain",
    type=_domain,
    metavar="N",
    help="ROS domain; else that of the settings, else ROS_DOMAIN_ID, else 0",
)
ROS_ARGS = Argument(
    "--ros-args",
    nargs=argparse.REMAINDER,
    default=[],
    metavar="...",
    help="at the end, as of any ROS node: `-r __ns:=/hall2`, `-r FROM:=TO`",
)
TESTBED = (
    Argument(
        "--testbed",
        action=WordsAction,
        const=_testbed,
        nargs="+",
        metavar=("ros|simulated|replay", "PATH"),
        help="where the data come from: `ros`, `simulated`, or `replay` and the path of a bag",
    ),
    *SIMULATED,
    Argument(
        "--speed",
        type=number_within(0, FASTEST),
        default=1.0,
        metavar="FACTOR",
        help="of a simulation or replay: 1 = real time, 0 = as fast as possible",
    ),
    DOMAIN,
    *RESULTS,
    SETTINGS,
    ROS_ARGS,
)
IDLE_TIME = Argument(
    "--idle-time",
    type=number_within(0),
    metavar="S",
    help="s without a screen and without a run after which the engine ends; else setting "
    "`engine.idle_time`, at most 20 where simulated",
)
