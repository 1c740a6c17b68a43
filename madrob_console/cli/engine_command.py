"""`madrob engine`: the process behind the screens."""

from __future__ import annotations

import argparse
import signal
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.problems import complain
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from pathlib import Path

    from madrob_console.engine.process.place import Place
    from madrob_console.engine.process.remote import RemoteEngine
    from madrob_console.engine.process.server import EngineServer
    from madrob_console.engine.shown.requests import Role

PRACTICE_IDLE_TIME = 20.0
"""A simulated or replayed testbed is soon there again: its engine waits no longer, s."""


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "engine",
        main,
        "the process behind the screens: `status`, `stop`, `serve`",
        "`madrob console` starts it by itself. `serve` runs it in the foreground, for systemd.",
    )
    parser.add_argument("action", choices=("status", "stop", "serve"))
    parser.add_argument("--force", action="store_true", help="stop: even while a run goes on")
    options.add_testbed(parser)
    options.add_idle_time(parser)


def main(arguments: argparse.Namespace) -> int:
    """Serve, or look after engines that run."""
    match arguments.action:
        case "serve":
            return serve(arguments)
        case "status":
            return status()
        case _:
            return stop(force=arguments.force)


def serve(arguments: argparse.Namespace) -> int:
    """Be the engine of a testbed until nobody needs it."""
    from madrob_console.cli.attaching import TAKEN, engine_place
    from madrob_console.config import load_settings

    settings = load_settings(arguments.settings)
    place = engine_place(arguments, settings)
    with ExitStack() as stack:
        try:
            stack.enter_context(place.taken())
        except MadrobError as error:
            complain(error)
            return TAKEN
        with imports_kept():
            import asyncio

            from madrob_console.cli import aside
            from madrob_console.cli.session import open_engine
            from madrob_console.engine.process.local import LocalEngine
            from madrob_console.engine.process.reporting import Reporting
            from madrob_console.engine.process.server import EngineServer

        engine = open_engine(arguments, settings)
        where = [f"--results={options.results_folder(arguments, settings)}"]
        if arguments.settings is not None:
            where.append(f"--settings={arguments.settings}")
        reporting = Reporting(
            aside.COMMAND, lambda: engine.busy, where, reports=settings.results.reports
        )
        local = LocalEngine(engine, reporting)
        try:
            idle_time = arguments.idle_time or settings.engine.idle_time
            if arguments.idle_time is None and engine.source.kind is not SourceKind.ROS:
                idle_time = min(idle_time, PRACTICE_IDLE_TIME)
            server = EngineServer(local, engine.source.label, idle_time, time.monotonic)
            asyncio.run(_serve(server, place.socket))
        finally:
            local.close()
    reporting.close()  # another engine may begin meanwhile
    return 0


async def _serve(server: EngineServer, path: Path) -> None:
    import asyncio

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, server.stop)
    await server.serve(path)


def status() -> int:
    """One line for each engine that runs; exit code 1 if there is none."""
    from madrob_console.engine.process.place import known_places
    from madrob_console.engine.shown.requests import Role
    from madrob_console.ui.look.words import PHASES

    found = 0
    for place in known_places():
        engine = _attached(place, Role.WATCH)
        if engine is None:
            continue
        found += 1
        snapshot = engine.snapshot()
        run = snapshot.run
        words = PHASES[run.phase]
        if run.setup is not None:
            words += f", run {run.setup.run_number} of subject {run.setup.subject}"
        print(f"{snapshot.source_label}: pid {engine.pid}, {words}, runs in {engine.results}")
        engine.close()
    if not found:
        print("no engine runs")
    return 0 if found else 1


def stop(*, force: bool) -> int:
    """End every engine; one with a run only by force."""
    from madrob_console.engine.process.place import known_places
    from madrob_console.engine.shown.requests import Role, StopEngine, TakeOver

    code = 0
    for place in known_places():
        engine = _attached(place, Role.REFEREE)
        if engine is None:
            continue
        label = engine.snapshot().source_label
        engine.ask(TakeOver())
        refused = engine.ask(StopEngine(force))
        if refused is None:
            _wait_for_end(place)
            print(f"{label}: ended")
        else:
            print(f"{label}: goes on, {refused}; --force cuts it off and keeps it as interrupted")
            code = 1
        engine.close()
    return code


def _attached(place: Place, role: Role) -> RemoteEngine | None:
    from madrob_console.cli.attaching import who_am_i
    from madrob_console.engine.process.remote import RemoteEngine

    try:
        return RemoteEngine(place.socket, role, who_am_i())
    except (MadrobError, OSError):
        return None  # it was killed, or is just ending


def _wait_for_end(place: Place, patience: float = 10.0) -> None:
    """Until a new engine could take the place."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        try:
            with place.taken():
                return
        except MadrobError:
            time.sleep(0.05)
