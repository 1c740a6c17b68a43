"""`madrob console`: the referee's screens."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind, ThemeName
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.config import Settings
    from madrob_console.engine.shown.client import EngineClient
    from madrob_console.engine.shown.requests import Role
    from madrob_console.standings.teams import TeamList
    from madrob_console.ui.defaults import ConsoleDefaults

_KEYS = "F1 lists the keys, ^P finds every command."
_PRACTICE = "Practice: Enter sets up, F7 zeroes the handle, F6 confirms the pose, F5 starts."
_REPLAY = "A replay: nothing is recorded. Space pauses, j jumps to a time. F1 lists the keys."
_FIRST_TIME = "No run yet. To practise: `madrob console --testbed simulated`. F1 lists the keys."


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "console",
        main,
        "the referee's screens: set up, start, watch and score runs",
        "Without --testbed it takes the live testbed if one is found.",
    )
    options.add_testbed(parser)
    parser.add_argument(
        "--from",
        dest="begin_at",
        type=float,
        default=None,
        metavar="SECONDS",
        help="where a replay begins, from the start of its run",
    )
    options.add_idle_time(parser)
    add_look_options(parser)


def add_look_options(parser: argparse.ArgumentParser) -> None:
    """How the screens look."""
    parser.add_argument(
        "--teams", type=Path, default=None, help="teams file: csv lines of subject,team"
    )
    parser.add_argument("--theme", type=ThemeName, choices=list(ThemeName), default=None)
    parser.add_argument(
        "--ascii", action="store_true", default=None, help="draw with ASCII characters only"
    )
    parser.add_argument("--no-bell", action="store_true", help="be silent")
    parser.add_argument("--no-mouse", action="store_true", help="leave the mouse to the terminal")


def main(arguments: argparse.Namespace) -> int:
    """Show the screens; the engine is a process behind them, started where none runs."""
    from madrob_console.engine.shown.requests import Role

    begin_at: float | None = arguments.begin_at
    replays = arguments.testbed is not None and arguments.testbed[0] == SourceKind.REPLAY
    if begin_at is not None and not (replays and math.isfinite(begin_at)):
        raise MadrobError(
            f"--from {begin_at:g}: give seconds, and with `--testbed replay PATH` only"
        )
    return show(arguments, Role.REFEREE, begin_at)


def show(arguments: argparse.Namespace, role: Role, begin_at: float | None = None) -> int:
    """Show the screens for a referee or for a spectator; a replay begins at a time of its run."""
    with imports_kept():
        from msgspec.structs import replace

        from madrob_console.cli.attaching import attach
        from madrob_console.config import load_settings
        from madrob_console.engine.shown.requests import Role
        from madrob_console.ui.terminal import check_terminal, run_console

    check_terminal(os.environ)
    settings = load_settings(arguments.settings)
    results = options.results_folder(arguments, settings)

    def open_client() -> EngineClient:
        client = attach(arguments, settings, role)
        if role is Role.REFEREE:
            _move(client, arguments.speed, begin_at)
        return client

    look = replace(
        settings.console,
        theme=arguments.theme or settings.console.theme,
        ascii=arguments.ascii or settings.console.ascii,
        bell=settings.console.bell and not arguments.no_bell,
        mouse=settings.console.mouse and not arguments.no_mouse,
    )
    return run_console(open_client, _defaults(arguments, settings, results), look)


def _move(client: EngineClient, speed: float, begin_at: float | None) -> None:
    """Let a replay, which may be going on already, go as the command line says.

    Raises:
        MadrobError: it cannot begin there.
    """
    from madrob_console.engine.shown.playback import JumpTo, SetSpeed

    playback = client.snapshot().playback
    if playback is None:
        return
    if playback.speed != speed:
        client.ask(SetSpeed(speed))  # refused where another console has the right to act
    if begin_at is not None and (refused := client.ask(JumpTo(begin_at))) is not None:
        client.close()
        raise MadrobError(f"--from {begin_at:g}: {refused}")


def _defaults(arguments: argparse.Namespace, settings: Settings, results: Path) -> ConsoleDefaults:
    import socket

    from madrob_console.config.tables import DEFAULT_START_POSES
    from madrob_console.ui.defaults import ConsoleDefaults

    competition = settings.competition
    teams = _teams(arguments.teams, settings)
    first_time = not _any_run(results)
    kind = None if arguments.testbed is None else arguments.testbed[0]
    hint = _FIRST_TIME if first_time else _KEYS
    if kind == SourceKind.REPLAY:
        hint = _REPLAY
    elif kind == SourceKind.SIMULATED and first_time:
        hint = _PRACTICE
    return ConsoleDefaults(
        competition=competition.name,
        results=results,
        host=socket.gethostname(),
        best_runs=competition.best_runs,
        hint=hint,
        problems=teams.problems,
        referee=competition.referee,
        teams=teams.names,
        poses=settings.start_poses or DEFAULT_START_POSES,
        run=settings.run,
    )


def _teams(named: Path | None, settings: Settings) -> TeamList:
    """The teams of file and settings; a file that only the settings name may be missing.

    Raises:
        MadrobError: the file named on the command line cannot be read.
    """
    from madrob_console.standings.teams import TeamList, merge_teams, read_teams

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
    from madrob_console.archive.folders import parse_folder_name

    try:
        return any(parse_folder_name(name) for name in os.listdir(results))  # noqa: PTH208
    except OSError:
        return False
