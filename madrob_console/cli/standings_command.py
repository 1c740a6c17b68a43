"""`madrob standings`: all teams, for people, spreadsheets and programs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import batch, options
from madrob_console.cli.output import BAD_INPUT, Complaints, put_bytes
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.pages.competition import CompetitionStandings

_STDOUT = Path("-")


def add_command(commands: options.Commands) -> None:
    parser = options.command(
        commands,
        "standings",
        main,
        "the teams of each condition, the leader first: a table, csv, json, html",
        "The table has the best run of each team. Details and files have mean, median and standard "
        "deviation over the valid runs; invalid and interrupted ones are listed with their "
        "reasons. Exit code 2 when a run cannot be read; the rest is there.",
        examples=(
            "madrob standings",
            "madrob standings --details --best 3",
            "madrob standings --html hall.html",
            "madrob standings hall_a hall_b             # one competition in two halls",
        ),
    )
    for kind, text in (
        ("csv", "a row for each team, condition and indicator, with how many runs are flagged"),
        ("json", "everything, with units and reasons"),
        ("html", "a page for phone and paper"),
    ):
        parser.add_argument(
            f"--{kind}",
            type=Path,
            default=None,
            metavar="FILE",
            help=f"{text}; - = standard output",
        )
    parser.add_argument(
        "--details", action="store_true", help="all statistics, each condition and all together"
    )
    batch.add_which_runs(parser)
    options.add_teams(parser)
    options.add_run_paths(parser)
    options.add_settings(parser)


def main(arguments: argparse.Namespace) -> int:
    with imports_kept():
        from madrob_console.common.files import atomic_write
        from madrob_console.common.version import software_version
        from madrob_console.config import load_settings
        from madrob_console.pages.outputs import (
            standings_csv,
            standings_details,
            standings_html,
            standings_json,
            standings_lines,
        )

    makers: dict[str, Callable[[CompetitionStandings], bytes]] = {
        "csv": lambda found: standings_csv(found).encode(),
        "json": lambda found: standings_json(found, software_version()),
        "html": lambda found: standings_html(found, software_version()).encode(),
    }
    targets = {kind: path for kind in makers if (path := getattr(arguments, kind)) is not None}
    _refuse_sharing(targets)
    told = sys.stderr if _STDOUT in targets.values() else sys.stdout
    settings = load_settings(arguments.settings)
    batch.demand_results(arguments, settings)
    collection = options.collection(arguments, settings)
    details = arguments.details or arguments.best is not None
    if not details and not targets:
        arguments.best = 1
    teams = options.team_names(arguments, settings, collection)
    found = batch.standings(arguments, settings, collection, teams)
    for kind, path in targets.items():
        data = makers[kind](found)
        if path == _STDOUT:
            put_bytes(data)
        else:
            atomic_write(path, data)
            print(terminal_safe(str(path)), file=told)
    if not targets:
        for line in (standings_details if details else standings_lines)(found):
            print(terminal_safe(line))
    batch.name_practice_alone(found, collection)
    with Complaints() as complaints:
        complaints.add_each(collection.unlisted)
        complaints.add_each((run.folder, run.problem) for run, _ in found.left_out if run.problem)
    return BAD_INPUT if complaints.count else 0


def _refuse_sharing(targets: dict[str, Path]) -> None:
    """Two kinds in one file would leave only the last."""
    paths = [path if path == _STDOUT else path.absolute() for path in targets.values()]
    for path in paths:
        if paths.count(path) > 1:
            raise MadrobError(f"{path}: give each kind of file a path of its own")
