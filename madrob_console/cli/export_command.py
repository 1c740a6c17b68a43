"""`madrob export`: a team's runs in one zip."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints, complain
from madrob_console.cli.parsing import as_path
from madrob_console.cli.progress import progress
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted
from madrob_console.common.names import terminal_safe

if TYPE_CHECKING:
    from madrob_console.export.pack import Export
    from madrob_console.pages.related_runs import RelatedRuns


@command(
    "export",
    "a team's runs, or all about one run, in one zip",
    "Official runs, with reports, tables, a page of them all and checksums. The last line is the "
    "path of the zip. Exit code 2 when something could not be packed: it is named, the rest is "
    "there.",
    options=(
        options.subject(),
        Argument(
            "--run",
            type=as_path,
            metavar="RUN",
            help="with --dossier one run instead: its folder, or its name in the results folder",
        ),
        Argument(
            "--dossier",
            action="store_true",
            help="with --run, all of that run that a protest is decided by: the protests and "
            "decisions, report, pictures, journal, results, samples as tables, recording",
        ),
        options.TEAMS,
        options.PRACTICE,
        *options.COLLECTION,
        Argument(
            "--output",
            type=as_path,
            metavar="FILE.zip",
            help="the zip; if not given, in the folder `exports` of the results folder, or here "
            "where several paths are given",
        ),
        Argument(
            "--without-bags",
            action="store_true",
            help="leave out the recordings, with their evidence",
        ),
        Argument(
            "--without-evidence",
            action="store_true",
            help="leave out cameras and other topics that were recorded beside what is scored, the "
            "largest files",
        ),
        options.SETTINGS,
    ),
    examples=(
        "madrob export --subject 3",
        "madrob export --subject 3 --without-bags --output /media/usb/team_3.zip",
        "madrob export --run my_run --dossier",
    ),
)
def export(arguments: argparse.Namespace) -> int:
    """Make the zip; name what could not be packed. The last line is the path of the zip."""
    check_options(arguments)
    from madrob_console.export.contents import dossier_contents, team_contents
    from madrob_console.export.pack import BagParts, pack
    from madrob_console.pages.related_runs import RelatedRuns

    notes: tuple[str, ...] = ()
    with Complaints() as complaints:
        if arguments.dossier:
            contents = dossier_contents(arguments.run.absolute())
        else:
            settings = option_values.settings_of(arguments)
            listed_runs = option_values.collection(arguments, settings)
            teams = option_values.team_names(arguments, settings, listed_runs)
            contents = team_contents(
                listed_runs,
                arguments.subject,
                time.time(),
                competition=arguments.competition,
                practice=arguments.practice,
                team=teams.get(arguments.subject, ""),
            )
            complaints.add_each(listed_runs.unlisted)
            notes = listed_runs.twins
    with progress("runs") as tell:
        packed = pack(
            contents,
            partial(rendered_report, around=RelatedRuns()),
            target=arguments.output,
            parts=BagParts(not arguments.without_bags, not arguments.without_evidence),
            tell=tell,
        )
    others = [f"another name of the team, {words}" for words in contents.other_names]
    return _tell_outcome(packed, [*others, *notes]) or (BAD_INPUT if complaints.count else 0)


def _tell_outcome(export: Export, notes: Sequence[str]) -> int:
    for problem in export.problems:
        complain(problem)
    for words in notes:
        print(f"note: {terminal_safe(words)}")
    print(f"{counted(export.runs, 'run')}, {export.files} files, {export.size / 1e6:.1f} MB")
    print(terminal_safe(str(export.path)))
    return BAD_INPUT if export.problems else 0


def check_options(arguments: argparse.Namespace) -> None:
    """Refuse options that contradict: a dossier is of one run, all else of a team."""
    of_run = arguments.run is not None
    if of_run is not arguments.dossier:
        raise MadrobError("one run is packed as a dossier: give --run RUN with --dossier")
    if not of_run and arguments.subject is None:
        raise MadrobError("whose runs? give --subject N, or --run RUN --dossier for one run")
    of_team = arguments.subject is not None or arguments.practice or arguments.paths
    if of_run and (of_team or arguments.competition is not None):
        raise MadrobError(
            "--run names the run: leave out --subject, --practice, --competition and PATH"
        )


def rendered_report(run: Path, around: RelatedRuns) -> tuple[dict[str, bytes], list[str]]:
    """Render a run's report as of now, with its pictures; returns files and problems.

    The files go into the zip only. They are named as in the run's folder.
    """
    from madrob_console.archive.folders import REPORT_FILE
    from madrob_console.archive.pictures import pictures_of
    from madrob_console.archive.scored import score_once
    from madrob_console.common.version import software_version
    from madrob_console.pages.report import report_html

    try:
        scored = score_once(run)
    except MadrobError as error:
        return {}, [f"{REPORT_FILE}: cannot be made: {error}"]
    place = around.place_of(run, scored)
    page = report_html(scored, software_version(), place, pictures_of(run, scored)).encode()
    return {REPORT_FILE: page}, []
