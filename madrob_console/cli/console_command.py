"""`madrob console`: the referee's screens."""

from __future__ import annotations

import argparse
import os
import sys
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, ThemeName, terminal_safe

if TYPE_CHECKING:
    from madrob_console.config import Settings
    from madrob_console.config.tables import ConsoleSettings
    from madrob_console.engine.ipc.engine_interface import EngineClient
    from madrob_console.engine.requests import Role
    from madrob_console.ui.link import ConsoleDefaults

_KEYS = "F1 lists the keys, ^P finds every command."
_REPLAY = "A replay: nothing is recorded. Space pauses, j jumps to a time. F1 lists the keys."
_FIRST_TIME = "No run yet. To practise: `madrob console --testbed simulated`. F1 lists the keys."


class Shown(Enum):
    """How a run is shown."""

    SCREENS = auto()
    WALL = auto()
    PLAIN = auto()
    JSON = auto()


_LINES = (Shown.PLAIN, Shown.JSON)
"""They need no terminal."""


LOOK = (
    options.choice("--theme", ThemeName, "colours; else setting `console.theme`"),
    Argument("--no-bell", action="store_true", help="be silent"),
    Argument("--no-mouse", action="store_true", help="leave the mouse to the terminal"),
)


@command(
    "console",
    "the referee's screens: set up, start, watch and score runs",
    "Without arguments it comes back to the engine of the settings' results folder. Where only "
    "others run it says what to type; where none runs it takes the live testbed if one is found.",
    options=(
        *options.TESTBED,
        Argument(
            "--at",
            metavar="INSTANT",
            help=f"show a replay at this instant, paused: {options.INSTANT}",
        ),
        options.IDLE_TIME,
        options.TEAMS,
        options.PLAN,
        *LOOK,
    ),
    examples=(
        "madrob console                      # at the testbed, and to come back",
        "madrob console --testbed simulated  # to practise",
        "madrob console --testbed replay my_run",
        "madrob console --testbed replay my_run --at door_opens",
    ),
)
def console(arguments: argparse.Namespace) -> int:
    from madrob_console.engine.requests import Role

    if arguments.at is not None and not _replays(arguments):
        raise MadrobError("--at: give it with `--testbed replay PATH` only")
    return show(arguments, Role.REFEREE)


def _replays(arguments: argparse.Namespace) -> bool:
    return arguments.testbed is not None and arguments.testbed[0] == SourceKind.REPLAY


def show(arguments: argparse.Namespace, role: Role, shown: Shown = Shown.SCREENS) -> int:
    """Show a run to a referee or to a spectator."""
    from madrob_console.cli.attaching import attach, demand_engine, owned_testbed
    from madrob_console.cli.running_engines import ask_which, engines_meant, mean
    from madrob_console.engine.requests import Role
    from madrob_console.ui.terminal import check_terminal, run_console

    if shown not in _LINES:
        instead = "run" if role is Role.REFEREE else "watch --plain"
        check_terminal(os.environ, (sys.__stdin__, sys.__stdout__), instead)
    own = option_values.results_folder(arguments, option_values.settings_of(arguments)).resolve()
    engines = engines_meant(arguments, own)
    elsewhere = role is Role.REFEREE and any(engine.results != own for engine in engines)
    if len(engines) > 1 or elsewhere:
        return ask_which(engines, "console" if role is Role.REFEREE else "watch", own)
    if engines:
        mean(arguments, engines[0])
    settings = option_values.settings_of(arguments)
    results = option_values.results_folder(arguments, settings)
    owned_testbed(arguments, settings)  # what cannot be is said before anything is painted
    at = _check_replay(arguments) if _replays(arguments) else None
    if role is Role.WATCH:
        demand_engine(arguments, settings)
    else:
        _read_lists(arguments, settings)

    def open_client(may_start: bool) -> EngineClient:
        client = attach(arguments, settings, role, may_start=may_start)
        if role is Role.REFEREE:
            check_lists(client, arguments, settings)
        if role is Role.REFEREE and may_start:
            _move(client, None if engines else arguments.speed, at)
        return client

    def open_replay(folder: Path, instant: float | None) -> EngineClient:
        replayed = argparse.Namespace(**vars(arguments))
        replayed.testbed = [str(SourceKind.REPLAY), str(folder)]
        replayed.at = None if instant is None else f"{instant:.3f}"
        replayed.speed = 1.0
        beginning = _check_replay(replayed)
        client = attach(replayed, settings, role)
        _move(client, 1.0, beginning)
        return client

    if shown in _LINES:
        from madrob_console.cli.spectator_lines import follow_engine, json_lines, plain_lines

        return follow_engine(open_client, plain_lines if shown is Shown.PLAIN else json_lines)

    return run_console(
        open_client,
        _defaults(arguments, settings, results),
        _look(arguments, settings),
        wall=shown is Shown.WALL,
        open_replay=open_replay if role is Role.REFEREE else None,
    )


def _look(arguments: argparse.Namespace, settings: Settings) -> ConsoleSettings:
    from msgspec.structs import replace

    return replace(
        settings.console,
        theme=arguments.theme or settings.console.theme,
        bell=settings.console.bell and not arguments.no_bell,
        mouse=settings.console.mouse and not arguments.no_mouse,
    )


def _check_replay(arguments: argparse.Namespace) -> float | None:
    """Check that a run can be replayed; returns where, s from its start; None = from its begin."""
    from madrob_console.archive.run_record import RECORD_NAME
    from recorder.reader import Bag

    path = Path(arguments.testbed[1])
    named: str | None = getattr(arguments, "at", None)  # a spectator sees what the referee does
    if named is None and RECORD_NAME in Bag(path).records:
        return None
    from madrob_console.engine.playback import JumpTo
    from madrob_console.engine.runtime.replay import Replay
    from madrob_console.messages.types import MessageTypes

    replay = Replay(path, MessageTypes())
    if named is None:
        return None
    try:
        at = replay.instant(named)
    except MadrobError as error:
        raise MadrobError(f"--at: {error}") from None
    if (refused := replay.control(JumpTo(at))) is not None:
        raise MadrobError(f"--at {terminal_safe(named)}: {refused}")
    return at


def _read_lists(arguments: argparse.Namespace, settings: Settings) -> None:
    """Refuse lists that are given and cannot be read, before anything is painted."""
    if arguments.teams is not None:
        option_values.team_list(arguments, settings)
    if arguments.plan is not None:
        option_values.plan_list(arguments, settings)


def check_lists(client: EngineClient, arguments: argparse.Namespace, settings: Settings) -> None:
    """Refuse lists of teams or a plan other than the engine's, which are named when it starts."""
    snapshot = client.snapshot()
    if snapshot.playback is not None:
        return
    teams, plan = snapshot.teams.file, snapshot.plan.file
    for option, what, there, source in (
        ("teams", "teams file", teams, option_values.team_source(arguments, settings)),
        ("plan", "plan's file", plan, option_values.plan_source(arguments, settings)),
    ):
        if getattr(arguments, option) is None or there == source.file_words:
            continue
        client.close()
        raise MadrobError(
            f"--{option} {source.file_words}: the engine that runs has {there or f'no {what}'}; "
            "leave the option out, or end the engine first with `madrob engine stop`"
        )


def _move(client: EngineClient, speed: float | None, at: float | None) -> None:
    """Set the speed of a replay, which may already play, or stop it at an instant.

    `at` is in s from the start of its run; None keeps the speed or the place.
    """
    from madrob_console.engine.playback import JumpTo, SetSpeed, Skip

    playback = client.snapshot().playback
    if playback is None:
        return
    if speed is not None and playback.speed != speed:
        client.send_request(SetSpeed(speed))  # refused where another console has the right to act
    if at is None:
        return
    client.send_request(Skip(0.0))  # stands still, also while it jumps
    if (refused := client.send_request(JumpTo(at))) is not None:
        client.close()
        raise MadrobError(f"--at: {refused}")


def _defaults(arguments: argparse.Namespace, settings: Settings, results: Path) -> ConsoleDefaults:
    import socket

    from madrob_console.config.tables import DEFAULT_START_POSES
    from madrob_console.ui.keys.key_table import A_RUN
    from madrob_console.ui.link import ConsoleDefaults

    competition = settings.competition
    first_time = not _any_run(results)
    kind = None if arguments.testbed is None else arguments.testbed[0]
    hint = _FIRST_TIME if first_time else _KEYS
    if kind == SourceKind.REPLAY:
        hint = _REPLAY
    elif kind == SourceKind.SIMULATED and first_time:
        hint = f"Practice: {A_RUN}"
    return ConsoleDefaults(
        results=results,
        host=socket.gethostname(),
        best_runs=competition.best_runs,
        hint=hint,
        referee=competition.referee,
        poses=settings.start_poses or DEFAULT_START_POSES,
        run=settings.run,
    )


def _any_run(results: Path) -> bool:
    from madrob_console.archive.folders import run_folder_names

    try:
        return bool(run_folder_names(results))
    except MadrobError:
        return False
