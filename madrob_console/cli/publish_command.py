"""`madrob publish`: a competition's pages, for a web server and every phone."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import chosen_runs, option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints, complain, name_some
from madrob_console.cli.parsing import as_path
from madrob_console.cli.progress import progress
from madrob_console.common.names import is_rehearsal, terminal_safe

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.pages.site_content import SiteContent


@command(
    "publish",
    "a competition's pages in a folder, for a web server",
    "Overview, teams, conditions, runs, tables. The pages open from a file and from any web "
    "server, run no script and load nothing from elsewhere. Only what has changed is written, "
    "each file whole; only files that this command wrote are removed. With setting "
    "`results.publish` the engine does this after each result. Exit code 2 when a run cannot be "
    f"read (the rest is there), {os.EX_TEMPFAIL} when the disk refuses or another writes there. A "
    "screen in a hall shows `madrob watch --big`.",
    options=(
        Argument(
            "site",
            type=as_path,
            metavar="FOLDER",
            help="an empty or new folder, or one published before",
        ),
        *chosen_runs.WHICH_RUNS,
        options.TEAMS,
        options.PLAN,
        *options.COLLECTION,
        options.SETTINGS,
    ),
    examples=(
        "madrob publish ~/site",
        "madrob publish /var/www/html/doors hall_a hall_b    # one competition in two halls",
    ),
)
def publish(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.folders import INDEX_PAGE, rehearsal_folder
    from madrob_console.pages.publish import (
        SiteNotWrittenError,
        runs_without_report,
        site_files,
        site_held,
        write_site,
    )

    settings = option_values.settings_of(arguments)
    chosen_runs.demand_results(arguments, settings)
    site: Path = arguments.site
    if is_rehearsal(settings.competition.name):
        site = rehearsal_folder(site)
    try:
        with site_held(site):  # before the runs are read: nobody's older pages come after newer
            listed_runs = option_values.collection(arguments, settings)
            content = _content(arguments, settings, listed_runs, site)
            with progress("files") as tell:
                written = write_site(site, site_files(content), tell)
    except SiteNotWrittenError as error:
        complain(error)
        return os.EX_TEMPFAIL
    missing = "no report of its result to show; `madrob report` makes it"
    without = [run.folder for run in runs_without_report(content)]
    name_some([f"{folder}: {missing}" for folder in without], "runs without a report")
    chosen_runs.name_practice_alone(content.standings, listed_runs)
    with Complaints() as complaints:
        complaints.add_each(listed_runs.unlisted)
        complaints.add_each((run.folder, run.problem) for run in content.runs if run.problem)
        for problem in written.unread:
            complaints.add_complaint(problem, problem.partition(":")[0])
    print(f"{written.files} files, {written.written} written, {written.removed} removed")
    print(terminal_safe(str(site / INDEX_PAGE)))
    return BAD_INPUT if complaints.count else 0


def _content(
    arguments: argparse.Namespace, settings: Settings, listed_runs: Collection, site: Path
) -> SiteContent:
    from madrob_console.common.version import software_version
    from madrob_console.pages.competition import entering_runs
    from madrob_console.pages.site_content import SiteContent, zip_place
    from madrob_console.referee.competition_plan import plan_progress

    official = not arguments.practice
    title, runs = entering_runs(listed_runs.runs, arguments.competition, official=official)
    plan = option_values.plan_list(arguments, settings)
    teams = option_values.team_names(arguments, settings, listed_runs)
    name = title if runs else settings.competition.name
    return SiteContent(
        root=listed_runs.root,
        runs=[run for run in runs if not run.twin and not run.never_ran],
        standings=chosen_runs.standings(arguments, settings, listed_runs, teams),
        plan=plan_progress(plan, listed_runs.runs, name) if plan.lines else None,
        names=teams,
        software=software_version(),
        zips=frozenset(run.subject for run in runs if (site / zip_place(run.subject)).is_file()),
    )
