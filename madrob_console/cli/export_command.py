"""`madrob export`: a team's runs in one zip."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.problems import BAD_INPUT, Complaints, complain
from madrob_console.cli.progress import progress
from madrob_console.names import terminal_safe
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.export.pack import Export


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "export",
        main,
        "a team's official runs, or all about one run, in one zip with checksums",
        "The last line is the path of the zip. Exit code 2 when something could not be packed: it "
        "is named, the rest is there.",
        examples=(
            "madrob export --subject 3",
            "madrob export --subject 3 --without-bags --output /media/usb/team_3.zip",
            "madrob export --run my_run --dossier",
        ),
    )
    options.add_subject(parser, needed=False)
    parser.add_argument(
        "--run",
        type=Path,
        default=None,
        metavar="RUN",
        help="with --dossier one run instead: its folder, or its name in the results folder",
    )
    parser.add_argument(
        "--dossier",
        action="store_true",
        help="with --run, all of that run that a protest is decided by: the protests and "
        "decisions, report, pictures, journal, results, samples as tables, recording",
    )
    options.add_teams(parser)
    parser.add_argument(
        "--practice", action="store_true", help="the practice runs instead, marked as such"
    )
    options.add_run_paths(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=None,
        metavar="FILE.zip",
        help="the zip; if not given, in the folder `exports` of the results folder, or here where "
        "several paths are given",
    )
    parser.add_argument(
        "--without-bags", action="store_true", help="leave out the recordings, with their evidence"
    )
    parser.add_argument(
        "--without-evidence",
        action="store_true",
        help="leave out cameras and other topics that were recorded beside what is scored, the "
        "largest files",
    )
    options.add_settings(parser)


def main(arguments: argparse.Namespace) -> int:
    """Make the zip; what could not be packed is named. The last line is the path of the zip."""
    from madrob_console.cli.run_dossier import check_options, make_dossier, rendered_report

    check_options(arguments)
    with imports_kept():
        from madrob_console.config import load_settings
        from madrob_console.export.pack import export_team
        from madrob_console.export.packed_bag import BagParts
        from madrob_console.report.surroundings import Surroundings

    if arguments.dossier:
        return _told(make_dossier(arguments, _tell_size))
    settings = load_settings(arguments.settings)
    found = options.collection(arguments, settings)
    teams = options.team_names(arguments, settings, found)
    with progress("runs") as tell:
        export = export_team(
            found,
            arguments.subject,
            settings.mappings(),
            time.time(),
            competition=arguments.competition,
            practice=arguments.practice,
            target=arguments.output,
            parts=BagParts(not arguments.without_bags, not arguments.without_evidence),
            team=teams.get(arguments.subject, ""),
            thresholds=settings.scoring_thresholds(),
            report=partial(rendered_report, around=Surroundings()),
            tell=tell,
            tell_size=_tell_size,
        )
    with Complaints() as complaints:
        complaints.add_each(found.unlisted)
    return _told(export, found.twins) or (BAD_INPUT if complaints.count else 0)


def _told(export: Export, notes: Sequence[str] = ()) -> int:
    """Say what was packed, and what could not be; returns the exit code."""
    for problem in export.problems:
        complain(problem)
    others = (f"another name of the team, {words}" for words in export.other_names)
    for words in (*export.renamed, *others, *notes):
        print(f"note: {terminal_safe(words)}")
    plural = "" if export.runs == 1 else "s"
    print(f"{export.runs} run{plural}, {export.files} files, {export.size / 1e6:.1f} MB")
    print(terminal_safe(str(export.path)))
    return BAD_INPUT if export.problems else 0


def _tell_size(size: int, evidence: int) -> None:
    """Say what is packed before hours are spent on it, where it is much."""
    if evidence:
        words = f"{evidence / 1e6:.1f} MB of it evidence (--without-evidence leaves that out)"
        complain(f"note: packing {size / 1e6:.1f} MB, {words}")
