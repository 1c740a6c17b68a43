"""The options that several commands have, and what they come to with the settings."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli.command_line import Argument, WordsAction
from madrob_console.cli.output import complain
from madrob_console.cli.parsing import (
    as_path,
    number_within,
    one_of,
    whole_number,
    whole_within,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import (
    LONGEST_NAME,
    REHEARSAL,
    Scenario,
    SourceKind,
    is_rehearsal,
)
from madrob_console.testbeds.ros_domain import domain_number
from scoring.protocol import BenchmarkType, Condition, Side

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.referee.competition_plan import Plan, PlanSource
    from madrob_console.referee.lists import TeamList, TeamSource

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


# Which settings, which runs, which lists.

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

# Which run, and what of it.

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


# Which testbed.


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
    help="at the end, as of any ROS node: `-r __ns:=/hall2`, `-r FROM:=TO`, "
    "`-p use_sim_time:=true`",
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
    Argument(
        "--use-sim-time",
        action="store_true",
        help="follow `/clock` of a simulation over ROS, every run is practice; else setting "
        "`testbed.use_sim_time`",
    ),
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

# What they come to with the settings.


def settings_of(arguments: argparse.Namespace) -> Settings:
    """The settings; those of the rehearsal where that is meant (protocol section 2).

    A rehearsal has a name, a results folder and pages of its own, so that nothing mixes.
    """
    from msgspec.structs import replace

    from madrob_console.archive.folders import holds_rehearsals, rehearsal_folder
    from madrob_console.config import load_settings

    settings = load_settings(getattr(arguments, "settings", None))
    competition, results = settings.competition, settings.results
    named: Path | None = getattr(arguments, "results", None)
    read = getattr(arguments, "paths", None) or [named or results.root]
    meant = getattr(arguments, "rehearsal", False) or is_rehearsal(competition.name)
    if not (meant or any(map(holds_rehearsals, read))):
        return settings
    if named is not None:
        arguments.results = rehearsal_folder(named)
    name = competition.name if is_rehearsal(competition.name) else f"{REHEARSAL} {competition.name}"
    site = results.publish and str(rehearsal_folder(Path(results.publish).expanduser()))
    return replace(
        settings,
        competition=replace(competition, name=name[:LONGEST_NAME].rstrip()),
        results=replace(results, folder=str(rehearsal_folder(results.root)), publish=site),
    )


def ros_domain(arguments: argparse.Namespace, settings: Settings) -> int | None:
    """The ROS domain; None = `ROS_DOMAIN_ID`, or 0."""
    chosen: int | None = arguments.domain
    return settings.testbed.domain if chosen is None else chosen


def results_folder(arguments: argparse.Namespace, settings: Settings) -> Path:
    chosen: Path = getattr(arguments, "results", None) or settings.results.root  # not all take it
    return chosen.absolute()


def collection(arguments: argparse.Namespace, settings: Settings) -> Collection:
    """The named runs, without duplicates, of all competitions."""
    from madrob_console.archive.collection import collected, collected_in, demand_competition

    paths = run_paths(arguments, settings)
    if arguments.paths:
        listed_runs = collected(paths, arguments.testbed_name)
    else:
        listed_runs = collected_in(paths[0], arguments.testbed_name)
    if arguments.competition not in (None, settings.competition.name):
        demand_competition(arguments.competition, listed_runs.competitions)
    return listed_runs


def run_paths(arguments: argparse.Namespace, settings: Settings) -> list[Path]:
    paths: list[Path] = arguments.paths
    if paths and arguments.results is not None:
        raise MadrobError("PATH and --results: give one of the two")
    return paths or [results_folder(arguments, settings)]


def team_source(arguments: argparse.Namespace, settings: Settings) -> TeamSource:
    from madrob_console.referee.lists import TeamSource

    named: Path | None = arguments.teams
    if named is None:
        return TeamSource(settings.team_names(), settings.competition.teams_path)
    return TeamSource(settings.team_names(), named.absolute(), "correct --teams")


def team_list(arguments: argparse.Namespace, settings: Settings) -> TeamList:
    """The list of teams, its bad lines named; a file that only the settings name may be missing."""
    from madrob_console.referee.lists import read_teams

    source = team_source(arguments, settings)
    if arguments.teams is not None and source.file is not None:
        read_teams(source.file, source.remedy)
    listed = source.read()
    tell_problems(listed)
    return listed


def plan_list(arguments: argparse.Namespace, settings: Settings) -> Plan:
    """The plan, its bad lines named; a file that only the settings name may be missing."""
    from madrob_console.referee.competition_plan import read_plan

    source = plan_source(arguments, settings)
    if arguments.plan is not None and source.file is not None:
        read_plan(source.file, source.remedy)
    plan = source.read()
    tell_problems(plan)
    return plan


def tell_problems(listed: TeamList | Plan) -> None:
    """Name the bad and odd lines of a list."""
    for problem in listed.notes:
        complain(problem)


def team_names(
    arguments: argparse.Namespace, settings: Settings, listed_runs: Collection
) -> Mapping[int, str]:
    """The list of teams for these runs; that of the settings holds for their competition only."""
    own, chosen = settings.competition.name, arguments.competition
    of = listed_runs.competitions if chosen is None else {chosen}
    if arguments.teams is None and own and of and own not in of:
        return {}
    return team_list(arguments, settings).names


def plan_source(arguments: argparse.Namespace, settings: Settings) -> PlanSource:
    from madrob_console.referee.competition_plan import PlanSource

    named: Path | None = arguments.plan
    if named is None:
        return settings.plan.source
    return PlanSource((), named.absolute(), "correct --plan")


def condition_of(arguments: argparse.Namespace) -> Condition:
    return Condition(arguments.benchmark_type, arguments.opening_side, arguments.starting_side)
