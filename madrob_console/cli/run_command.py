"""`madrob run`: one run without screens, a plain line per event."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.parsing import as_setting, number, number_within
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, clean_name, is_rehearsal, terminal_safe
from scoring.indicator_table import RulesetName
from scoring.protocol import LockDetection, Outcome, StartPose

if TYPE_CHECKING:
    from madrob_console.config import Settings
    from madrob_console.engine.runtime.testbed_engine import Engine
    from madrob_console.referee.competition_plan import Plan, Task
    from madrob_console.referee.run_setup import RunSetup
    from madrob_console.referee.team_list import TeamList

EXIT_CODES = {
    Outcome.COMPLETED: 0,
    Outcome.TIMEOUT: 3,
    Outcome.ABORTED: 4,
    Outcome.INTERRUPTED: 5,
}
_CODES = ", ".join(f"{code} {outcome}" for outcome, code in EXIT_CODES.items())


def _pose(text: str) -> tuple[float, float, float]:
    try:
        x, y, yaw = (number(part) for part in text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no pose: give x,y,yaw in m, m and degrees, as in 1.5,0,180"
        ) from None
    return x, y, yaw


def _as_setting(key: str, text: str) -> Argument:
    return Argument(f"--{key}", type=as_setting("run", key), metavar="S", help=text)


@command(
    "run",
    "one run without screens, a line per event",
    "Waits for the testbed, zeroes the handle, starts, records, scores. The last line is "
    f"`run folder: PATH`. Exit code {_CODES}, {BAD_INPUT} bad input or a refusal.",
    options=(
        *options.TESTBED,
        options.subject(default=1),
        Argument("--team-name", metavar="NAME", help="the team's name; else the list's"),
        Argument(
            "--team-reason", default="", metavar="WHY", help="why another name than the list's"
        ),
        options.TEAMS,
        options.PLAN,
        Argument(
            "--referee",
            metavar="NAME",
            help="the referee's name; else that of the settings",
        ),
        Argument(
            "--run-number",
            type=options.run_number,
            metavar="N",
            help="the next free one if not given",
        ),
        *options.CONDITION,
        Argument(
            "--practice",
            action="store_true",
            help="a practice run, which never counts; on a simulated testbed every run is one",
        ),
        Argument(
            "--start-pose",
            type=_pose,
            metavar="X,Y,YAW",
            help="m, m, degrees in the frame madrob_door; the settings' pose of the side if not "
            "given",
        ),
        _as_setting("timeout", "s from the start; else setting `run.timeout`"),
        _as_setting("countdown", "s before the start; else setting `run.countdown`"),
        options.choice(
            "--ruleset", RulesetName, "the rules of the result; else setting `run.ruleset`"
        ),
        options.choice(
            "--lock-detection",
            LockDetection,
            "what decides step 6; else setting `run.lock_detection`",
        ),
        Argument(
            "--wait",
            type=number_within(0),
            default=20.0,
            metavar="S",
            help="s to wait for the pre-start checks; `inf`: without an end",
        ),
        Argument("--waive", metavar="REASON", help="let failing pre-start checks pass"),
        Argument(
            "--accept-false-start",
            metavar="WHY",
            help="let false starts pass; without it one aborts the run",
        ),
        Argument("--no-report", action="store_true", help="make no report.html"),
    ),
    examples=(
        "madrob run --testbed simulated --speed 0  # to try it",
        "madrob run --testbed ros --subject 3 --opening-side cw --starting-side ccw",
    ),
)
def run(arguments: argparse.Namespace) -> int:
    from msgspec.structs import replace

    from madrob_console.cli.attaching import owned_testbed
    from madrob_console.cli.running_engines import owning
    from madrob_console.cli.session import open_engine, reporting_of
    from madrob_console.cli.unattended_run import UnattendedRun
    from madrob_console.common.version import software_version
    from madrob_console.engine.runtime.supervisor import Supervisor
    from madrob_console.engine.snapshot import label_of

    settings = option_values.settings_of(arguments)
    owned = owned_testbed(arguments, settings)
    if owned.kind is SourceKind.REPLAY:
        raise MadrobError(
            "a recorded run is not made again: `madrob score --check RUN` compares its result, "
            "`madrob console --testbed replay RUN` shows it"
        )
    engine = open_engine(arguments, settings)
    teams = option_values.team_list(arguments, settings)
    plan = option_values.plan_list(arguments, settings)
    engine.set_teams(teams)
    engine.set_plan(plan)
    reports = settings.results.reports and not arguments.no_report
    reporting = None
    if reports or settings.results.publish:
        reporting = reporting_of(arguments, settings, engine, reports=reports)
    rehearsal = is_rehearsal(settings.competition.name)
    unattended = UnattendedRun(engine, reporting)
    with ExitStack() as stack:
        more = () if reporting is None else reporting.workers
        stack.callback(Supervisor(*engine.workers, *more).close)
        server, answer, _ = stack.enter_context(owning(arguments, owned))
        answer = replace(answer, version=software_version())
        server.describe = lambda: replace(
            answer.with_run(engine.run, busy=engine.busy),
            testbed=label_of(
                engine.source.label, practice=engine.run.practice, rehearsal=rehearsal
            ),
        )
        stack.enter_context(unattended.stopping_on_signals())

        def setup(simulated: bool) -> RunSetup:
            practice = (simulated and not rehearsal) or arguments.practice
            return _setup(arguments, settings, engine, teams, plan, practice=practice)

        outcome = unattended.go(
            setup, arguments.wait, arguments.waive, arguments.accept_false_start
        )
        return EXIT_CODES[outcome]


def _setup(
    arguments: argparse.Namespace,
    settings: Settings,
    engine: Engine,
    teams: TeamList,
    plan: Plan,
    *,
    practice: bool,
) -> RunSetup:
    from madrob_console.referee.competition_plan import Task
    from madrob_console.referee.run_setup import RunSetup

    condition = option_values.condition_of(arguments)
    number = arguments.run_number
    if number is None:
        proposal = engine.next_run_number(arguments.subject, condition.number, practice=practice)
        number = proposal.result()
    referee = arguments.referee
    if referee is None:
        referee = settings.competition.referee
    listed = teams.names.get(arguments.subject, "")
    named: str | None = arguments.team_name
    team = listed if named is None else clean_name(named, "--team-name")
    defaults = settings.run
    pose = arguments.start_pose
    start_pose = StartPose(*pose) if pose else settings.start_pose(condition.starting_side)
    task = Task(arguments.subject, condition.number)
    beyond = not practice and bool(plan.lines) and _out_of_plan(task, plan, settings, engine)
    return RunSetup(
        subject=arguments.subject,
        team=team,
        run_number=number,
        condition=condition,
        start_pose=start_pose,
        referee=clean_name(referee, "--referee"),
        timeout=defaults.timeout if arguments.timeout is None else arguments.timeout,
        countdown=defaults.countdown if arguments.countdown is None else arguments.countdown,
        ruleset=arguments.ruleset or defaults.ruleset,
        lock_detection=arguments.lock_detection or defaults.lock_detection,
        team_reason=terminal_safe(arguments.team_reason)
        if teams.differs(arguments.subject, team)
        else "",
        practice=practice,
        out_of_plan=beyond,
    )


def _out_of_plan(task: Task, plan: Plan, settings: Settings, engine: Engine) -> bool:
    from madrob_console.archive.history import History
    from madrob_console.referee.competition_plan import plan_progress

    runs = History(engine.config.results).refresh()
    return plan_progress(plan, runs, settings.competition.name).out_of_plan(task)
