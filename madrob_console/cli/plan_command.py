"""`madrob plan`: the competition's plan, and how much of it is done."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints, complain
from madrob_console.cli.safe_stream import put_bytes
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe


@command(
    "plan",
    "the competition's plan: what is done, next and left",
    "The plan is a csv file with lines `subject,condition,attempts,time` in the order of the "
    "competition (setting `plan.file`). Exit code 2 when a line of it cannot be used or has a "
    "subject that is not in the list of teams, or a run cannot be read; the others count.",
    options=(
        Argument(
            "--conditions", action="store_true", help="the twenty conditions and their numbers"
        ),
        options.PLAN,
        options.JSON,
        options.TEAMS,
        *options.COLLECTION,
        options.SETTINGS,
    ),
    examples=(
        "madrob plan",
        "madrob plan --plan tomorrow.csv --teams teams.csv",
        "madrob plan --json hall_a hall_b > plan.json",
        "madrob plan --conditions",
    ),
)
def plan(arguments: argparse.Namespace) -> int:
    from madrob_console.common.version import software_version
    from madrob_console.pages.plan_text import condition_lines, plan_json, plan_lines
    from madrob_console.referee.competition_plan import plan_progress, plan_remarks

    if arguments.conditions:
        print("\n".join(condition_lines()))
        return 0
    settings = option_values.settings_of(arguments)
    listed = option_values.plan_list(arguments, settings)
    if not listed.lines and (listed.problems or not listed.file):
        raise MadrobError("no plan: name a file in [plan] of the settings, or with --plan")
    teams = option_values.team_list(arguments, settings).names
    remarks = [*plan_remarks(listed.lines, teams, settings.run.timeout)]
    bad = bool(listed.notes or remarks)
    listed = replace(listed, remarks=(*listed.remarks, *remarks))
    chosen: str | None = arguments.competition
    competition = settings.competition.name if chosen is None else chosen
    collection = option_values.collection(arguments, settings)
    if arguments.results is not None and not arguments.results.is_dir():
        complain(f"note: {arguments.results}: no such results folder, so no attempt is there")
    progress = plan_progress(listed, collection.runs, competition)
    if arguments.json:
        put_bytes(plan_json(progress, competition, teams, software_version()))
    else:
        for line in plan_lines(progress, competition, teams, time.time()):
            print(terminal_safe(line))
    for remark in collection.twins:
        complain(f"note: {remark}")
    for problem in remarks:
        complain(problem)
    with Complaints() as complaints:
        complaints.add_each(collection.unlisted)
        complaints.add_each((run.folder, run.problem) for run in collection.runs if run.problem)
    return BAD_INPUT if bad or complaints.count else 0
