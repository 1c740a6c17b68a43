"""`madrob console`: the referee's screens."""

from __future__ import annotations

import argparse
import os

from madrob_console.commands.session import open_engine, settings_of
from madrob_console.config import Settings
from madrob_console.config.tables import DEFAULT_START_POSES
from madrob_console.engine.local import LocalEngine
from madrob_console.ui.defaults import ConsoleDefaults, PosePreset
from madrob_console.ui.terminal import check_terminal, run_console


def main(arguments: argparse.Namespace) -> int:
    """Start the engine, show the screens, end the engine."""
    check_terminal(os.environ)
    settings = settings_of(arguments)
    engine = open_engine(arguments, settings)
    client = LocalEngine(engine)
    try:
        defaults = _defaults(settings, str(engine.config.results))
        return run_console(client, defaults, mouse=not arguments.no_mouse)
    finally:
        client.close()


def _defaults(settings: Settings, results: str) -> ConsoleDefaults:
    run, competition = settings.run, settings.competition
    poses = settings.start_poses or DEFAULT_START_POSES
    return ConsoleDefaults(
        competition=competition.name,
        results=results,
        referee=competition.referee,
        teams=settings.team_names(),
        poses=tuple(PosePreset(p.name, p.pose) for p in poses),
        timeout=run.timeout,
        countdown=run.countdown,
        ruleset=run.ruleset,
        lock_detection=run.lock_detection,
    )
