"""What the options of a command come to with the settings: folders, lists, a condition."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli.output import complain
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import LONGEST_NAME, REHEARSAL, is_rehearsal
from scoring.protocol import Condition

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.referee.competition_plan import Plan, PlanSource
    from madrob_console.referee.team_list import TeamList, TeamSource


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
    from madrob_console.referee.team_list import TeamSource

    named: Path | None = arguments.teams
    if named is None:
        return TeamSource(settings.team_names(), settings.competition.teams_path)
    return TeamSource(settings.team_names(), named.absolute(), "correct --teams")


def team_list(arguments: argparse.Namespace, settings: Settings) -> TeamList:
    """The list of teams, its bad lines named; a file that only the settings name may be missing."""
    from madrob_console.referee.team_list import read_teams

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
