"""Which runs of a competition stand beside each other, as commands are asked for it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli.options import results_folder, team_names
from madrob_console.cli.parsing import whole_within
from madrob_console.cli.problems import complain
from madrob_console.errors import MadrobError

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.standings.competition import CompetitionStandings


def add_which_runs(parser: argparse.ArgumentParser) -> None:
    """Which runs stand beside each other."""
    parser.add_argument(
        "--best",
        type=whole_within(0),
        default=None,
        metavar="N",
        help="only the N best runs of each team in each condition, 0 = all; else setting "
        "`competition.best_runs`",
    )
    parser.add_argument(
        "--practice", action="store_true", help="the practice runs instead, marked as such"
    )


def standings(
    arguments: argparse.Namespace, settings: Settings, collection: Collection
) -> CompetitionStandings:
    """The standings of them."""
    from madrob_console.standings.competition import competition_standings

    chosen: int | None = arguments.best
    best = settings.competition.best_runs if chosen is None else chosen
    return competition_standings(
        collection.runs,
        made=time.time(),
        competition=arguments.competition,
        official=not arguments.practice,
        best=best,
        listed=team_names(arguments, settings, collection),
    )


def name_practice_alone(found: CompetitionStandings, collection: Collection) -> None:
    """Say so where official runs were asked for and there is practice only."""
    practice = sum(run.practice for run in collection.runs)
    if found.official and practice and not any(run.official for run in collection.runs):
        complain(f"note: no official run, {practice} of practice: --practice shows them")


def demand_results(arguments: argparse.Namespace, settings: Settings) -> None:
    """Where no paths are named there is a results folder.

    Raises:
        MadrobError: there is none.
    """
    results = results_folder(arguments, settings)
    if not arguments.paths and not results.is_dir():
        raise MadrobError(f"{results}: no such results folder; name one with --results")


def named_places(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    """The options that name the results folder, the settings and the teams to another command."""
    where = [f"--results={results_folder(arguments, settings)}"]
    if arguments.settings is not None:
        where.append(f"--settings={arguments.settings}")
    if arguments.teams is not None:
        where.append(f"--teams={arguments.teams}")
    return where


def site_arguments(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    """Those of `madrob publish` after each result; none where nobody wants it."""
    if not settings.results.publish:
        return []
    plan: Path | None = getattr(arguments, "plan", None)  # `madrob run` takes the settings'
    more = [] if plan is None else [f"--plan={plan}"]
    site = Path(settings.results.publish).expanduser()
    of = f"--competition={settings.competition.name}"
    return [str(site), *named_places(arguments, settings), *more, of]
