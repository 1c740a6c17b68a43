"""`madrob console`: the referee's screens."""

from __future__ import annotations

import argparse
import os
import socket
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.commands.attaching import attach, results_folder
from madrob_console.config import Settings, load_settings
from madrob_console.config.tables import DEFAULT_START_POSES
from madrob_console.engine.wire import Role
from madrob_console.errors import MadrobError
from madrob_console.runs import parse_folder_name
from madrob_console.teams import TeamList, merge_teams, read_teams
from madrob_console.testbeds.source import SourceKind
from madrob_console.ui.defaults import ConsoleDefaults, Look, PosePreset
from madrob_console.ui.terminal import check_terminal, run_console

if TYPE_CHECKING:
    from madrob_console.engine.client import EngineClient

_KEYS = "F1 lists the keys, ^P finds every command."
_PRACTICE = "Practice: Enter sets up, F7 zeroes the handle, F6 confirms the pose, F5 starts."
_FIRST_TIME = "No run yet. To practise: `madrob console --testbed simulated`. F1 lists the keys."


def main(arguments: argparse.Namespace) -> int:
    """Show the screens; the engine is a process behind them, started where none runs."""
    return show(arguments, Role.REFEREE)


def show(arguments: argparse.Namespace, role: Role) -> int:
    """Show the screens for a referee or for a spectator."""
    check_terminal(os.environ)
    settings = load_settings(arguments.settings)
    results = results_folder(arguments, settings)

    def open_client() -> EngineClient:
        return attach(arguments, settings, role)

    look = Look(
        theme=arguments.theme or settings.console.theme,
        ascii=arguments.ascii or settings.console.ascii,
        bell=settings.console.bell and not arguments.no_bell,
        mouse=settings.console.mouse and not arguments.no_mouse,
    )
    return run_console(open_client, _defaults(arguments, settings, results), look)


def _defaults(arguments: argparse.Namespace, settings: Settings, results: Path) -> ConsoleDefaults:
    run, competition = settings.run, settings.competition
    poses = settings.start_poses or DEFAULT_START_POSES
    teams = _teams(arguments.teams, settings)
    first_time = not _any_run(results)
    practice = arguments.testbed is not None and arguments.testbed[0] == SourceKind.SIMULATED
    hint = _KEYS if not first_time else _PRACTICE if practice else _FIRST_TIME
    return ConsoleDefaults(
        competition=competition.name,
        results=results,
        host=socket.gethostname(),
        best_runs=competition.best_runs,
        hint=hint,
        problems=teams.problems,
        referee=competition.referee,
        teams=teams.names,
        poses=tuple(PosePreset(p.name, p.pose) for p in poses),
        timeout=run.timeout,
        countdown=run.countdown,
        ruleset=run.ruleset,
        lock_detection=run.lock_detection,
    )


def _teams(named: Path | None, settings: Settings) -> TeamList:
    """The teams of file and settings; a file that only the settings name may be missing.

    Raises:
        MadrobError: the file named on the command line cannot be read.
    """
    path = named or settings.competition.teams_path
    if path is None:
        return TeamList(settings.team_names())
    try:
        listed = read_teams(path)
    except MadrobError as error:
        if named is not None:
            raise
        listed = TeamList({}, (str(error),))
    return merge_teams(settings.team_names(), listed)


def _any_run(results: Path) -> bool:
    try:
        return any(parse_folder_name(name) for name in os.listdir(results))  # noqa: PTH208
    except OSError:
        return False
