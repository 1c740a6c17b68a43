"""`madrob engine`: the process behind the screens."""

from __future__ import annotations

import argparse
import signal
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, MadrobCommand, command
from madrob_console.cli.output import BAD_INPUT, complain
from madrob_console.cli.parsing import whole_within
from madrob_console.common.names import SourceKind
from madrob_console.common.version import software_version

if TYPE_CHECKING:
    from madrob_console.config import Settings
    from madrob_console.engine.runtime.reports import Reporting
    from madrob_console.engine.runtime.testbed_engine import Engine
    from madrob_console.referee.competition_plan import PlanSource
    from madrob_console.referee.team_list import TeamSource

FAILED = 1
"""Exit code of an engine that failed: systemd starts it again."""

PRACTICE_IDLE_TIME = 20.0
"""Idle time of a simulated or replayed testbed's engine, s: it is quickly started again."""

REPAIR_AFTER = 3.0
"""Delay from an engine's start to its check of the results, s: the screens come first."""

_LISTS = (options.TEAMS, options.PLAN, options.IDLE_TIME)


@command(
    "status",
    "every engine of this user",
    "Exit code 0 an engine runs; 1 none.",
    options=(options.JSON,),
    examples=("madrob engine status", "madrob engine status --json"),
)
def _status(arguments: argparse.Namespace) -> int:
    from madrob_console.cli.running_engines import status

    return status(as_json=arguments.json)


@command(
    "stop",
    "end the engine that is named, or the only one that runs",
    "It ends the one that a console with the same --testbed, --domain and --results would show. "
    "Exit code 0 what was named has ended; 1 it goes on, or does not run.",
    options=(
        Argument(
            "--force",
            action="store_true",
            help="without a question while a run goes on, screens are attached or it hangs",
        ),
        Argument("--all", action="store_true", help="every engine of this user"),
        Argument(
            "--pid", type=whole_within(1), metavar="N", help="the engine that is this process"
        ),
        *options.TESTBED,
    ),
    examples=("madrob engine stop", "madrob engine stop --testbed simulated"),
)
def _stop(arguments: argparse.Namespace) -> int:
    from madrob_console.cli.running_engines import stop

    return stop(arguments)


@command(
    "serve",
    "run the engine in the foreground, for systemd",
    "Exit code 0 it was ended, or nobody needed it any more; 1 it failed; 2 bad input, or another "
    "engine has the results folder; 75 the testbed has an engine.",
    options=(*options.TESTBED, *_LISTS),
    examples=("madrob engine serve --testbed ros",),
)
def _serve(arguments: argparse.Namespace) -> int:
    from msgspec.structs import replace

    from madrob_console.cli.attaching import TAKEN, owned_testbed
    from madrob_console.cli.running_engines import owning
    from madrob_console.engine.ipc import wire
    from madrob_console.engine.ipc.engine_lock import HeldError
    from madrob_console.engine.ipc.service import wait_for_end

    settings = option_values.settings_of(arguments)
    owned = owned_testbed(arguments, settings)
    with ExitStack() as stack:
        try:
            owns = stack.enter_context(owning(arguments, owned, wire.VERSION))
        except HeldError as error:
            complain(error)
            return TAKEN if error.same else BAD_INPUT
        server, answer, holding = owns
        from madrob_console.cli.session import open_engine, reporting_of
        from madrob_console.engine.ipc.service import FallenThreads
        from madrob_console.engine.runtime.engine_thread import LocalEngine
        from madrob_console.engine.runtime.scoring_process import ScoringProcess
        from madrob_console.engine.runtime.supervisor import Supervisor

        fallen = FallenThreads()
        threading.excepthook = fallen.note
        engine = open_engine(arguments, settings, ScoringProcess())
        reporting = reporting_of(arguments, settings, engine, reports=settings.results.reports)
        supervisor = Supervisor(*engine.workers, *reporting.workers)
        _follow_lists(
            option_values.team_source(arguments, settings),
            option_values.plan_source(arguments, settings),
            engine,
            reporting,
            stack,
        )
        local = LocalEngine(engine, reporting, lambda: fallen.problem)
        repairing = threading.Timer(REPAIR_AFTER, local.repair)
        try:
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: server.over.put(None))
            answer = replace(answer, version=software_version(), testbed=engine.source.label)
            server.admit_screens(local, answer, _idle_time(arguments, settings, engine.source.kind))
            repairing.start()
            wait_for_end(local, server.over)
        finally:
            repairing.cancel()
            server.dismiss_screens()
            local.close()
            if engine.disk_silence:
                holding.keep()
    reporting.finish()  # another engine may begin meanwhile
    supervisor.close()
    return FAILED if local.failed else 0


engine = MadrobCommand(
    "engine",
    "the process behind the screens: is it there, stop it, run it",
    "`madrob console` starts it by itself.",
    examples=("madrob engine status", "madrob engine stop --testbed simulated"),
    parts=(_status, _stop, _serve),
)


def _follow_lists(
    teams: TeamSource, plan: PlanSource, engine: Engine, reporting: Reporting, stack: ExitStack
) -> None:
    from madrob_console.engine.runtime.list_watch import ListWatch, follow_lists

    changed = reporting.publish
    lists = (
        ListWatch(teams.file, teams.read, engine.set_teams, changed),
        ListWatch(plan.file, plan.read, engine.set_plan, changed),
    )
    stack.callback(follow_lists(lists))


def _idle_time(arguments: argparse.Namespace, settings: Settings, kind: SourceKind) -> float:
    """Time without a screen and a run after which the engine ends, s."""
    idle_time: float = arguments.idle_time or settings.engine.idle_time
    if arguments.idle_time is None and kind is not SourceKind.ROS:
        return min(idle_time, PRACTICE_IDLE_TIME)
    return idle_time
