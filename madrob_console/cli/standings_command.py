"""`madrob standings`: all teams, for people, spreadsheets and programs."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from madrob_console.cli import chosen_runs, option_values, options
from madrob_console.cli.command_line import Argument, OneOf, command
from madrob_console.cli.output import BAD_INPUT, Complaints
from madrob_console.cli.parsing import as_path
from madrob_console.cli.safe_stream import put_bytes
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

if TYPE_CHECKING:
    from madrob_console.pages.competition import CompetitionStandings


def _file(flag: str, text: str) -> Argument:
    return Argument(
        flag, dest="file", action="store_const", const=flag, help=f"{text}, to standard output"
    )


@command(
    "standings",
    "the teams of each condition, the leader first",
    "The table has the best run of each team. Details and files have mean, median and standard "
    "deviation over the valid runs; invalid and interrupted ones are listed with their reasons. "
    "Exit code 2 when a run cannot be read; the rest is there.",
    options=(
        OneOf(
            _file("--csv", "a row for each team, condition and indicator"),
            _file("--json", "everything as JSON for programs, with units and reasons"),
            _file("--html", "a page for phone and paper"),
        ),
        Argument(
            "--output", type=as_path, metavar="FILE", help="where --csv, --json or --html goes"
        ),
        Argument(
            "--details", action="store_true", help="all statistics, each condition and all together"
        ),
        *chosen_runs.WHICH_RUNS,
        options.TEAMS,
        *options.COLLECTION,
        options.SETTINGS,
    ),
    examples=(
        "madrob standings",
        "madrob standings --details --best 3",
        "madrob standings --json > standings.json",
        "madrob standings --html --output hall.html",
        "madrob standings hall_a hall_b             # one competition in two halls",
    ),
)
def standings(arguments: argparse.Namespace) -> int:
    from madrob_console.common.files import atomic_write
    from madrob_console.common.version import software_version
    from madrob_console.pages.outputs import standings_details, standings_html, standings_lines
    from madrob_console.pages.standings_files import standings_csv, standings_json

    makers: dict[str, Callable[[CompetitionStandings], bytes]] = {
        "--csv": lambda competition: standings_csv(competition).encode(),
        "--json": lambda competition: standings_json(competition, software_version()),
        "--html": lambda competition: standings_html(competition, software_version()).encode(),
    }
    file, output = arguments.file, arguments.output
    if output is not None and file is None:
        raise MadrobError("--output: say what goes there with --csv, --json or --html")
    settings = option_values.settings_of(arguments)
    chosen_runs.demand_results(arguments, settings)
    collection = option_values.collection(arguments, settings)
    details = arguments.details or arguments.best is not None
    if file is None and not details:
        arguments.best = 1
    teams = option_values.team_names(arguments, settings, collection)
    competition = chosen_runs.standings(arguments, settings, collection, teams)
    if file is None:
        for line in (standings_details if details else standings_lines)(competition):
            print(terminal_safe(line))
    elif output is None:
        put_bytes(makers[file](competition))
    else:
        atomic_write(output, makers[file](competition))
        print(terminal_safe(str(output)))
    chosen_runs.name_practice_alone(competition, collection)
    with Complaints() as complaints:
        complaints.add_each(collection.unlisted)
        complaints.add_each(
            (run.folder, run.problem) for run in competition.left_out if run.problem
        )
    return BAD_INPUT if complaints.count else 0
